"""The simulated GigE camera: sockets, threads, faults; see ``docs/practice-bench.md``."""

import ipaddress
import socket
from contextlib import ExitStack, suppress
from select import select
from threading import Event, RLock, Thread
from types import TracebackType
from typing import Self

from acquisition.errors import DeviceError
from hil_mocks.gige.acquisition import Acquisition
from hil_mocks.gige.bootstrap import BootstrapAddress, Capability, Identity
from hil_mocks.gige.control import ControlChannel
from hil_mocks.gige.events import DeviceEvent, EventId, MessageChannel, MessageTarget
from hil_mocks.gige.faults import GigeFaults
from hil_mocks.gige.features import features_of
from hil_mocks.gige.frame_source import FrameRequest, FrameSource
from hil_mocks.gige.gvcp import GVCP_PORT, ResendRequest, encode_pending, is_discovery
from hil_mocks.gige.gvsp import PAYLOAD_TYPE_CHUNKS
from hil_mocks.gige.pixels import BAYER_ORDERS
from hil_mocks.gige.registers import CAPABILITIES, RegisterMap
from hil_mocks.gige.settings import CameraState
from hil_mocks.gige.stream import StreamSender

ETHERNET_MTU_BYTES = 1500
LARGEST_DATAGRAM = 65536
BROADCAST_ADDRESS = "255.255.255.255"
PATIENCE_MS = 100
LONGEST_PENDING_MS = 65535
STREAM_BUFFER_BYTES = 4 << 20


class GigeDevice:
    """A GigE Vision camera on a loopback address, which any GigE Vision client can open.

    It opens with `open` or as a context manager, in its own threads; only an open one has
    acquisitions, can be restarted or lose its client. It sends only to loopback addresses, and
    answers discovery at its own address and, from this computer, by broadcast.

    Parameters
    ----------
    source
        Makes its frames.
    address
        Address in 127.0.0.0/8; several cameras can run side by side on different addresses.
    identity
        Its names, and whose cameras it is like in the names, types and units of its features.
    bayer_order
        ``RG``, ``GR``, ``GB`` or ``BG`` for the colour model; must match that of the source.
    black_level_dn
        Black level at power-up, in DN at 12 bits.
    link_mtu_bytes
        Largest packet, IP header included, that the link to the client carries.

    Raises
    ------
    ValueError
        If the address is not one of the loopback network.
    """

    def __init__(
        self,
        source: FrameSource,
        *,
        address: str = "127.0.0.1",
        identity: Identity | None = None,
        bayer_order: str | None = None,
        black_level_dn: float = 64.0,
        link_mtu_bytes: int = ETHERNET_MTU_BYTES,
    ) -> None:
        self._address = checked_loopback_address(address)
        if bayer_order is not None and bayer_order not in BAYER_ORDERS:
            raise ValueError(
                f"a Bayer order must be one of {', '.join(BAYER_ORDERS)}, got {bayer_order}"
            )
        self._source = source
        self._bayer_order = bayer_order
        self._identity = identity or Identity()
        self._link_mtu_bytes = link_mtu_bytes
        self._faults = GigeFaults()
        self._lock = RLock()
        features = features_of(bayer_order, has_temperature=True, maker=self._identity.maker)
        self._features = features
        self._state = CameraState(features, shape=source.shape, black_level_dn=black_level_dn)
        self._registers = RegisterMap(
            self._identity,
            address,
            features,
            self._state,
            commands={
                "AcquisitionStart": lambda: self._acquisition.start(),
                "AcquisitionStop": lambda: self._acquisition.stop(),
                "TriggerSoftware": lambda: self._acquisition.trigger(),
                "TestEventGenerate": self._tell_test,
            },
            fire_test_packet=lambda: self._sender.send_test_packet(self._registers.stream_target),
        )
        self._describe()
        self._control = ControlChannel(
            self._registers, lambda: self._faults, resend=self._resend, end_stream=self._end_stream
        )
        self._sockets = ExitStack()
        self._closing = Event()
        self._sender: StreamSender
        self._messages: MessageChannel
        self._tests_told = 0
        self._acquisition: Acquisition
        self._thread: Thread | None = None

    @property
    def address(self) -> str:
        """Its IPv4 address."""
        return self._address

    @property
    def source(self) -> FrameSource:
        """What makes its frames."""
        return self._source

    @property
    def faults(self) -> GigeFaults:
        """The present faults; can be set at any time."""
        return self._faults

    @faults.setter
    def faults(self, faults: GigeFaults) -> None:
        with self._lock:
            redescribe = faults.temperature_present != self._faults.temperature_present
            self._faults = faults
            self._registers.refused = faults.refused_registers
            self._registers.capabilities = CAPABILITIES
            if faults.resend_disabled:
                self._registers.capabilities &= ~Capability.PACKETRESEND
            if redescribe:
                self._describe()

    @property
    def controller(self) -> tuple[str, int] | None:
        """Address and port of the client that holds control."""
        return self._control.controller

    @property
    def request(self) -> FrameRequest:
        """Request for the first frame of the next acquisition with the present settings."""
        with self._lock:
            return self._state.request(self.acquisitions + 1, 0)

    @property
    def acquisitions(self) -> int:
        """Starts of acquisition since power-up: what `FrameRequest` counts."""
        return self._acquisition.acquisitions

    def value(self, quantity: str) -> float:
        """Value of a quantity by its name and in its unit in a Manta, whoever the maker is."""
        with self._lock:
            return self._state.quantity(quantity)

    def open(self) -> None:
        """Bind the address and start to answer.

        Raises
        ------
        DeviceError
            If the address cannot be bound.
        """
        with ExitStack() as stack:
            control = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            stream = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            messages = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
            try:
                control.bind((self._address, GVCP_PORT))
                stream.bind((self._address, 0))
                messages.bind((self._address, 0))
            except OSError as error:
                raise DeviceError(
                    f"no camera can be served at {self._address}, UDP port {GVCP_PORT}: "
                    f"{error.strerror}"
                ) from error
            broadcast = _broadcast_port(stack)
            stream.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, STREAM_BUFFER_BYTES)
            awake, self._wake = socket.socketpair()
            stack.enter_context(awake)
            stack.enter_context(self._wake)
            self._sockets = stack.pop_all()
        self._stream_port = int(stream.getsockname()[1])
        self._message_port = int(messages.getsockname()[1])
        self._power_up()
        self._messages = MessageChannel(messages, self._message_target)
        self._messages.open()
        self._sender = StreamSender(
            stream, lambda: self._faults, link_mtu_bytes=self._link_mtu_bytes
        )
        self._acquisition = Acquisition(
            self._source,
            self._state,
            self._registers,
            self._lock,
            self._sender,
            lambda: self._faults,
        )
        if self._identity.maker == "basler":
            self._acquisition.payload_type_of_chunks = PAYLOAD_TYPE_CHUNKS
        self._acquisition.tell_exposure_end = self._tell_exposure_end
        self._closing.clear()
        self._acquisition.open()
        self._thread = Thread(
            target=self._serve,
            args=(control, broadcast, awake),
            name="gige-control",
            daemon=True,
        )
        self._thread.start()

    def close(self) -> None:
        """Stop answering and release the address; closing twice is harmless."""
        if self._thread is None:
            return
        self.drop_control()
        self._closing.set()
        self._wake.send(b"\0")
        self._thread.join()
        self._thread = None
        self._acquisition.close()
        self._messages.close()
        self._sockets.close()

    def restart(self) -> None:
        """Lose power briefly: control is lost, and settings are those at power-up."""
        with self._lock:
            self._control.drop()
            self._acquisition.stop()
            self._power_up()

    def drop_control(self) -> None:
        """Take control from the client that holds it."""
        with self._lock:
            self._control.drop()

    def serve_description(self, description: bytes, url: str | None = None) -> None:
        """Serve this description, as damaged firmware may, until the camera's features change.

        Parameters
        ----------
        description
            Any bytes.
        url
            What the URL register says; where the description lies, if None.
        """
        with self._lock:
            self._registers.serve(description, url)

    def pulse_line(self, name: str) -> None:
        """Pulse one of the camera's input lines, by the name that TriggerSource has for it."""
        (source,) = (f for f in self._features if f.name == "TriggerSource")
        self._acquisition.pulse(dict(source.entries)[name])

    def begin_blocks_at(self, block_id: int) -> None:
        """Let block ids begin at ``block_id`` instead of 1 from the next start on."""
        self._acquisition.first_block_id = block_id

    def __enter__(self) -> Self:
        self.open()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _serve(
        self, port: socket.socket, broadcast: socket.socket | None, awake: socket.socket
    ) -> None:
        sources = [source for source in (port, broadcast, awake) if source is not None]
        while not self._closing.is_set():
            ready, _, _ = select(sources, [], [], self._control.seconds_to_expiry)
            if broadcast in ready and broadcast is not None:
                self._introduce(port, *broadcast.recvfrom(LARGEST_DATAGRAM))
            if port in ready:
                datagram, peer = port.recvfrom(LARGEST_DATAGRAM)
                answer = self._answer(port, datagram, peer)
                if answer is not None:
                    _reply(port, answer, peer)
            with self._lock:
                self._control.expire()

    def _answer(self, port: socket.socket, datagram: bytes, peer: tuple[str, int]) -> bytes | None:
        delay_s = self._faults.slow_writes_s
        if delay_s and not self._faults.is_dead and self._control.is_write(datagram):
            if self._registers.pending_is_enabled:
                request_id = int.from_bytes(datagram[6:8], "big")
                wait_ms = min(round(1000 * delay_s) + PATIENCE_MS, LONGEST_PENDING_MS)
                _reply(port, encode_pending(request_id, wait_ms), peer)
            self._closing.wait(delay_s)
        with self._lock:
            return self._control.answer(datagram, peer)

    def _introduce(self, port: socket.socket, datagram: bytes, peer: tuple[str, int]) -> None:
        """Answer a discovery that was broadcast, from this computer only."""
        if not ipaddress.IPv4Address(peer[0]).is_loopback or not is_discovery(datagram):
            return
        answer = self._answer(port, datagram, peer)
        if answer is not None:
            _reply(port, answer, peer)

    def _resend(self, request: ResendRequest) -> None:
        self._sender.send_again(request, self._registers.stream_target)

    def _end_stream(self) -> None:
        self._acquisition.stop()
        self._registers.set_plain(BootstrapAddress.STREAM_PORT, 0)
        self._registers.set_plain(BootstrapAddress.MESSAGE_PORT, 0)

    def _power_up(self) -> None:
        self._registers.power_up()
        self._registers.set_plain(BootstrapAddress.STREAM_SOURCE_PORT, self._stream_port)
        self._registers.set_plain(BootstrapAddress.MESSAGE_SOURCE_PORT, self._message_port)

    def _message_target(self) -> MessageTarget | None:
        with self._lock:
            return None if self._faults.is_dead else self._registers.message_target

    def _tell_exposure_end(self, block_id: int, ticks: int) -> None:
        if self._registers.events.is_on(EventId.EXPOSURE_END):
            event = DeviceEvent(
                event_id=EventId.EXPOSURE_END, timestamp_ticks=ticks, block_id=block_id
            )
            self._messages.tell(event)

    def _tell_test(self) -> None:
        self._tests_told += 1
        if self._registers.events.is_on(EventId.TEST):
            count = self._tests_told.to_bytes(4, "big")
            ticks = self._registers.now_ticks
            event = DeviceEvent(event_id=EventId.TEST, timestamp_ticks=ticks, data=count)
            self._messages.tell(event)

    def _describe(self) -> None:
        self._registers.describe(
            features_of(
                self._bayer_order,
                has_temperature=self._faults.temperature_present,
                maker=self._identity.maker,
            )
        )


def _broadcast_port(stack: ExitStack) -> socket.socket | None:
    """Open the port to which clients broadcast discovery; None where the system has no such port.

    Every camera of this computer opens it, and each receives every broadcast.
    """
    port = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    try:
        port.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        port.bind((BROADCAST_ADDRESS, GVCP_PORT))
    except OSError:  # as on macOS and Windows: there it is found at its own address only
        return None
    return port


def _reply(port: socket.socket, datagram: bytes, peer: tuple[str, int]) -> None:
    # A datagram can come from port 0, to which no answer can be sent.
    with suppress(OSError):
        port.sendto(datagram, peer)


def checked_loopback_address(address: str) -> str:
    """Accept an IPv4 address of the loopback network.

    Raises
    ------
    ValueError
        If it is another address, or not an address.
    """
    try:
        parsed = ipaddress.IPv4Address(address)
    except ipaddress.AddressValueError as error:
        raise ValueError(f"not an IPv4 address such as 127.0.0.1: {address}") from error
    if not parsed.is_loopback:
        raise ValueError(
            f"the simulated camera needs a loopback address such as 127.0.0.1, not {address}"
        )
    return str(parsed)
