"""The simulated GigE camera: its control channel, sockets, threads; see ``docs/practice-bench.md``.

References
----------
GigE Vision, Video Streaming and Device Control over Ethernet Standard, version 2.0, AIA, 2011,
sections 10 (control channel privilege and heartbeat) and 14 to 18 (commands).
"""

import ipaddress
import socket
import struct
from collections.abc import Callable
from contextlib import ExitStack, suppress
from enum import IntFlag
from select import select
from threading import Event, RLock, Thread
from time import monotonic
from typing import Self

from acquisition.errors import DeviceError
from hil_mocks.gige._events import DeviceEvent, EventId, MessageChannel, MessageTarget
from hil_mocks.gige._features import features_of
from hil_mocks.gige._registers import (
    CAPABILITIES,
    BootstrapAddress,
    Capability,
    Identity,
    RegisterMap,
)
from hil_mocks.gige._settings import CameraState, FrameRequest, FrameSource, GigeFaults
from hil_mocks.gige._wire import (
    BAYER_ORDERS,
    GVCP_PORT,
    PAYLOAD_TYPE_CHUNKS,
    Command,
    CommandCode,
    GvcpError,
    GvcpStatus,
    MemoryWrite,
    ResendRequest,
    encode_acknowledge,
    encode_pending,
    encode_write_result,
    is_discovery,
    parse_command,
    parse_read_memory,
    parse_read_registers,
    parse_resend_request,
    parse_write_memory,
    parse_write_registers,
)
from hil_mocks.gige.stream import Acquisition, StreamSender

Peer = tuple[str, int]
WRITES = (CommandCode.WRITEREG, CommandCode.WRITEMEM)


class _Privilege(IntFlag):
    """Bits of the control channel privilege register."""

    EXCLUSIVE = 0x1
    CONTROL = 0x2


class ControlChannel:
    """Answers the commands of clients; one of them can hold control.

    Control is lost by a release, after the heartbeat timeout without a command, or by `drop`; the
    stream ends with it, by ``end_stream``.
    """

    def __init__(
        self,
        registers: RegisterMap,
        faults: Callable[[], GigeFaults],
        *,
        resend: Callable[[ResendRequest], None],
        end_stream: Callable[[], None],
    ) -> None:
        self._registers = registers
        self._faults = faults
        self._resend = resend
        self._end_stream = end_stream
        self._controller: Peer | None = None
        self._last_heard_s = 0.0
        self._answered: tuple[Peer, bytes, bytes] | None = None

    @property
    def controller(self) -> Peer | None:
        """Address and port of the client that holds control."""
        return self._controller

    @property
    def seconds_to_expiry(self) -> float | None:
        """Time until control expires if no command comes; None while nobody holds it."""
        if self._controller is None:
            return None
        return max(self._last_heard_s + self._registers.heartbeat_s - monotonic(), 0.0)

    def expire(self) -> None:
        """Take control from a client that has been silent for too long."""
        if self.seconds_to_expiry == 0.0:
            self.drop()

    def drop(self) -> None:
        """Take control from whoever holds it."""
        if self._controller is None:
            return
        self._set_controller(None, 0)
        self._end_stream()

    def is_write(self, datagram: bytes) -> bool:
        """Whether a datagram is a command that writes."""
        try:
            return parse_command(datagram).code in WRITES
        except GvcpError:
            return False

    def answer(self, datagram: bytes, peer: Peer) -> bytes | None:
        """Carry out a command; the acknowledge, or None: not GVCP, none requested, or no power."""
        if self._faults().is_dead:
            return None
        try:
            command = parse_command(datagram)
        except GvcpError:
            return None
        if peer == self._controller and not self._faults().heartbeat_lost:
            self._last_heard_s = monotonic()
        # A client that misses an acknowledge repeats the command: it is carried out once.
        if self._answered is not None and self._answered[:2] == (peer, datagram):
            return self._answered[2]
        try:
            payload, status = self._execute(command, peer), GvcpStatus.SUCCESS
        except GvcpError as error:
            is_write = command.code in WRITES
            payload, status = encode_write_result(error.index) if is_write else b"", error.status
        if payload is None or not command.wants_acknowledge:
            return None
        acknowledge = encode_acknowledge(command.code, command.request_id, payload, status)
        if command.code in WRITES:
            self._answered = (peer, datagram, acknowledge)
        return acknowledge

    def _execute(self, command: Command, peer: Peer) -> bytes | None:
        match command.code:
            case CommandCode.DISCOVERY:
                return self._registers.discovery()
            case CommandCode.FORCEIP:
                return None
            case CommandCode.READREG:
                self._check_may_read(peer)
                addresses = parse_read_registers(command.payload)
                return b"".join(self._registers.read(address, 4) for address in addresses)
            case CommandCode.READMEM:
                self._check_may_read(peer)
                memory = parse_read_memory(command.payload)
                data = self._registers.read(memory.address, memory.length)
                return struct.pack(">I", memory.address) + data
            case CommandCode.WRITEREG:
                writes = parse_write_registers(command.payload)
                for index, write in enumerate(writes):
                    data = struct.pack(">I", write.value)
                    try:
                        self._write(MemoryWrite(address=write.address, data=data), peer)
                    except GvcpError as error:
                        raise GvcpError(str(error), status=error.status, index=index) from error
                return encode_write_result(len(writes))
            case CommandCode.WRITEMEM:
                memory_write = parse_write_memory(command.payload)
                self._write(memory_write, peer)
                return encode_write_result(len(memory_write.data))
            case CommandCode.PACKETRESEND if not self._faults().resend_disabled:
                # Aravis asks from the port of its stream, not from that of its control channel.
                if self._controller is None or peer[0] != self._controller[0]:
                    raise GvcpError(
                        "the client does not hold control", status=GvcpStatus.ACCESS_DENIED
                    )
                self._resend(parse_resend_request(command.payload))
                return None
            case _:
                raise GvcpError(
                    f"command {command.code:#06x} is not known", status=GvcpStatus.NOT_IMPLEMENTED
                )

    def _write(self, write: MemoryWrite, peer: Peer) -> None:
        if write.address == BootstrapAddress.CONTROL_PRIVILEGE:
            self._write_privilege(write.data, peer)
            return
        self._check_may_write(peer)
        self._registers.write(write)

    def _write_privilege(self, data: bytes, peer: Peer) -> None:
        if self._controller not in (None, peer):
            raise GvcpError("another client holds control", status=GvcpStatus.ACCESS_DENIED)
        wanted = int.from_bytes(data[:4], "big") & (_Privilege.EXCLUSIVE | _Privilege.CONTROL)
        if wanted:
            self._set_controller(peer, wanted)
        else:
            self.drop()

    def _set_controller(self, peer: Peer | None, privilege: int) -> None:
        self._controller = peer
        self._last_heard_s = monotonic()
        addresses = BootstrapAddress
        address, port = (0, 0) if peer is None else (int(ipaddress.IPv4Address(peer[0])), peer[1])
        self._registers.set_plain(addresses.CONTROL_PRIVILEGE, privilege)
        self._registers.set_plain(addresses.PRIMARY_ADDRESS, address)
        self._registers.set_plain(addresses.PRIMARY_PORT, port)

    def _check_may_read(self, peer: Peer) -> None:
        privilege = self._registers.plain(BootstrapAddress.CONTROL_PRIVILEGE)
        if privilege & _Privilege.EXCLUSIVE and peer != self._controller:
            raise GvcpError("another client has exclusive control", status=GvcpStatus.ACCESS_DENIED)

    def _check_may_write(self, peer: Peer) -> None:
        if peer != self._controller:
            raise GvcpError("the client does not hold control", status=GvcpStatus.ACCESS_DENIED)


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
    answers discovery at its own address and, from this computer, by broadcast. Several can run side
    by side on different addresses in 127.0.0.0/8; ValueError for any other. ``bayer_order``
    (``RG``, ``GR``, ``GB``, ``BG``) must match that of the source; ``black_level_dn`` is at 12
    bits; ``link_mtu_bytes`` is the largest packet that the link carries, IP header included.
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
        """Bind the address and start to answer; DeviceError if it cannot be bound."""
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
        """Serve any bytes as the description, as damaged firmware may, until its features change.

        ``url`` is what the URL register says; where the description lies, if None.
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

    def __exit__(self, *_: object) -> None:
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
    """Accept an IPv4 address of the loopback network; ValueError if it is another, or none."""
    try:
        parsed = ipaddress.IPv4Address(address)
    except ipaddress.AddressValueError as error:
        raise ValueError(f"not an IPv4 address such as 127.0.0.1: {address}") from error
    if not parsed.is_loopback:
        raise ValueError(
            f"the simulated camera needs a loopback address such as 127.0.0.1, not {address}"
        )
    return str(parsed)
