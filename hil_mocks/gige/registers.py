"""The memory of the simulated GigE camera, which a client reads and writes by address."""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from time import monotonic_ns

from hil_mocks.gige.bootstrap import (
    BOOTSTRAP_BYTES,
    DISCOVERY_BYTES,
    BootstrapAddress,
    Capability,
    Identity,
    bootstrap_page,
)
from hil_mocks.gige.description import DESCRIPTION_FILE, describe
from hil_mocks.gige.events import EventSwitches, MessageTarget
from hil_mocks.gige.feature import Feature
from hil_mocks.gige.features import DEVICE_PAGE
from hil_mocks.gige.gvcp import READMEM_LIMIT_BYTES, GvcpError, GvcpStatus, MemoryWrite
from hil_mocks.gige.settings import CameraState

DESCRIPTION_ADDRESS = 0x20000
DEVICE_PAGE_BYTES = 0x800
USER_NAME_BYTES = 16
DEFAULT_HEARTBEAT_MS = 3000
SHORTEST_HEARTBEAT_MS = 500

LOOPBACK_NETWORK = 127
FIRE_TEST_PACKET = 0x8000_0000
DO_NOT_FRAGMENT = 0x4000_0000
PACKET_SIZE_MASK = 0xFFFF
SMALLEST_PACKET, LARGEST_PACKET, PACKET_SIZE_STEP = 500, 8228, 4
PENDING_ENABLE = 0x4
TIMESTAMP_LATCH = 0x2
TIMESTAMP_RESET = 0x1

CAPABILITIES = (
    Capability.CONCATENATION
    | Capability.WRITEMEM
    | Capability.PACKETRESEND
    | Capability.EVENT
    | Capability.EVENTDATA
    | Capability.PENDING
    | Capability.PRIMARY_APPLICATION
    | Capability.SERIAL_NUMBER
    | Capability.USER_NAME
)


@dataclass(frozen=True, slots=True, kw_only=True)
class StreamTarget:
    """Destination and packet size of the stream."""

    address: int
    port: int
    packet_size_bytes: int
    packet_delay_ns: int

    @property
    def is_reachable(self) -> bool:
        """Whether anything is sent there: only within this computer, and not to a group."""
        return self.port != 0 and self.address >> 24 == LOOPBACK_NETWORK


@dataclass(frozen=True, slots=True, kw_only=True)
class _Register:
    name: str
    length: int
    read: Callable[[], bytes]
    write: Callable[[bytes], None] | None


class RegisterMap:
    """Bootstrap registers, feature registers and the description, each at its address.

    Parameters
    ----------
    identity, address
        The device's names and IPv4 address.
    features, state
        What the feature registers hold.
    commands
        The action of each command feature, by its name.
    fire_test_packet
        Called when a client asks for one.
    """

    def __init__(
        self,
        identity: Identity,
        address: str,
        features: tuple[Feature, ...],
        state: CameraState,
        *,
        commands: dict[str, Callable[[], None]],
        fire_test_packet: Callable[[], None],
    ) -> None:
        self._identity = identity
        self._address = address
        self._state = state
        self._commands = commands
        self._fire_test_packet = fire_test_packet
        self.events = EventSwitches()
        self._description = b""
        self._bootstrap = b""
        self.describe(features)
        self.refused: frozenset[str] = frozenset()
        self.capabilities = CAPABILITIES
        self._registers: dict[int, _Register] = {}
        self._plain: dict[int, int] = {}
        self._user_name = bytes(USER_NAME_BYTES)
        self._latched_ns = 0
        self._zero_ns = monotonic_ns()
        self._add_bootstrap_registers()
        for feature in features:
            if feature.address >= DEVICE_PAGE and feature.chunk_id is None:
                self._add_feature(feature)
        for word in self.events.words():
            self._add_word(*word)
        self.power_up()

    def describe(self, features: tuple[Feature, ...]) -> None:
        """Describe these features to clients from now on."""
        self.serve(describe(features, vendor=self._identity.vendor, model=self._identity.model))

    def serve(self, description: bytes, url: str | None = None) -> None:
        """Serve this description from now on, at this URL or where it lies."""
        # Clients read whole blocks: memory beyond the end exists and is zero.
        padded = -(-len(description) // 4) * 4 + READMEM_LIMIT_BYTES
        self._description = description.ljust(padded, b"\0")
        url = url or f"Local:{DESCRIPTION_FILE};{DESCRIPTION_ADDRESS:x};{len(description):x}"
        self._bootstrap = bytes(bootstrap_page(self._identity, self._address, url))

    def power_up(self) -> None:
        """Set the registers to their values at power-up."""
        self._plain = {
            BootstrapAddress.HEARTBEAT_TIMEOUT: DEFAULT_HEARTBEAT_MS,
            BootstrapAddress.GVCP_CONFIGURATION: 0,
            BootstrapAddress.MESSAGE_PORT: 0,
            BootstrapAddress.MESSAGE_DESTINATION: 0,
            BootstrapAddress.MESSAGE_TIMEOUT: 0,
            BootstrapAddress.MESSAGE_RETRIES: 0,
            BootstrapAddress.MESSAGE_SOURCE_PORT: 0,
            BootstrapAddress.STREAM_PORT: 0,
            BootstrapAddress.STREAM_PACKET_SIZE: DO_NOT_FRAGMENT,
            BootstrapAddress.STREAM_PACKET_DELAY: 0,
            BootstrapAddress.STREAM_DESTINATION: 0,
            BootstrapAddress.STREAM_SOURCE_PORT: 0,
            BootstrapAddress.CONTROL_PRIVILEGE: 0,
            BootstrapAddress.PRIMARY_PORT: 0,
            BootstrapAddress.PRIMARY_ADDRESS: 0,
        }
        self._state.power_up()
        self.events.power_up()

    def plain(self, address: BootstrapAddress) -> int:
        """Value of a bootstrap register."""
        return self._plain[address]

    def set_plain(self, address: BootstrapAddress, value: int) -> None:
        """Set a bootstrap register from inside the device."""
        self._plain[address] = value

    @property
    def heartbeat_s(self) -> float:
        """Time without a command after which control is lost."""
        return self._plain[BootstrapAddress.HEARTBEAT_TIMEOUT] / 1000

    @property
    def pending_is_enabled(self) -> bool:
        """Whether the client accepts pending acknowledges."""
        return bool(self._plain[BootstrapAddress.GVCP_CONFIGURATION] & PENDING_ENABLE)

    @property
    def stream_target(self) -> StreamTarget:
        """Present target of the stream."""
        return StreamTarget(
            address=self._plain[BootstrapAddress.STREAM_DESTINATION],
            port=self._plain[BootstrapAddress.STREAM_PORT],
            packet_size_bytes=int(self._state.value("GevSCPSPacketSize")),
            packet_delay_ns=self._plain[BootstrapAddress.STREAM_PACKET_DELAY],
        )

    @property
    def message_target(self) -> MessageTarget | None:
        """Present target of events: None unless it is set, and within this computer."""
        words = (
            BootstrapAddress.MESSAGE_DESTINATION,
            BootstrapAddress.MESSAGE_PORT,
            BootstrapAddress.MESSAGE_TIMEOUT,
            BootstrapAddress.MESSAGE_RETRIES,
        )
        target = MessageTarget.of(*(self._plain[word] for word in words))
        return target if target.is_reachable else None

    @property
    def now_ticks(self) -> int:
        """Time on the device's clock, in ns since power-up or its last reset."""
        return monotonic_ns() - self._zero_ns

    def ticks_at(self, moment_s: float) -> int:
        """Time on the device's clock at a moment of `time.monotonic`."""
        return max(0, round(moment_s * 1e9) - self._zero_ns)

    def discovery(self) -> bytes:
        """Payload of a discovery acknowledge."""
        return self._memory(0, DISCOVERY_BYTES)

    def read(self, address: int, length: int) -> bytes:
        """Read memory from an address on.

        Raises
        ------
        GvcpError
            If there is no memory, or the words are not aligned.
        """
        _check_alignment(address)
        return self._memory(address, length)

    def write(self, write: MemoryWrite) -> None:
        """Write one register after another.

        Raises
        ------
        GvcpError
            If one of them does not accept it; those before it are written.
        """
        written = 0
        while written < len(write.data):
            try:
                written += self._write_one(write.address + written, write.data[written:])
            except GvcpError as error:
                raise GvcpError(str(error), status=error.status, index=written) from error

    def _write_one(self, address: int, data: bytes) -> int:
        """Write the register at an address; return how many bytes of ``data`` it took."""
        _check_alignment(address)
        register = self._registers.get(address)
        if register is None:
            self._memory(address, 4)
            raise GvcpError(f"{address:#x} is read only", status=GvcpStatus.WRITE_PROTECT)
        if len(data) < register.length and register.length > 8:
            data = data.ljust(register.length, b"\0")
        if register.write is None or register.name in self.refused:
            raise GvcpError(f"{register.name} is read only", status=GvcpStatus.WRITE_PROTECT)
        if len(data) < register.length:
            raise GvcpError(
                f"{register.name} takes {register.length} bytes",
                status=GvcpStatus.INVALID_PARAMETER,
            )
        register.write(data[: register.length])
        return register.length

    def _memory(self, address: int, length: int) -> bytes:
        end = address + length
        if address >= DESCRIPTION_ADDRESS and end <= DESCRIPTION_ADDRESS + len(self._description):
            start = address - DESCRIPTION_ADDRESS
            return self._description[start : start + length]
        if end <= BOOTSTRAP_BYTES:
            memory = bytearray(self._bootstrap[address:end])
        elif address >= DEVICE_PAGE and end <= DEVICE_PAGE + DEVICE_PAGE_BYTES:
            memory = bytearray(length)
        else:
            raise GvcpError(f"no memory at {address:#x}", status=GvcpStatus.INVALID_ADDRESS)
        for start, register in self._registers.items():
            if start < end and start + register.length > address:
                value = register.read()
                low, high = max(start, address), min(start + register.length, end)
                memory[low - address : high - address] = value[low - start : high - start]
        return bytes(memory)

    def _add_feature(self, feature: Feature) -> None:
        form = ">d" if feature.kind == "float" else ">I"
        name = feature.name

        def read() -> bytes:
            if feature.access == "WO":
                return bytes(4)
            value = self._state.value(name)
            return struct.pack(form, value if form == ">d" else int(value))

        def write(data: bytes) -> None:
            if feature.kind == "command":
                self._commands[name]()
            else:
                self._state.set_value(name, struct.unpack(form, data)[0])

        self._registers[feature.address] = _Register(
            name=name,
            length=feature.length,
            read=read,
            write=None if feature.access == "RO" else write,
        )

    def _add_bootstrap_registers(self) -> None:
        addresses = BootstrapAddress
        self._add_word(addresses.CAPABILITY, "GVCPCapability", lambda: int(self.capabilities), None)
        self._add_word(
            addresses.HEARTBEAT_TIMEOUT,
            "GevHeartbeatTimeout",
            partial(self.plain, addresses.HEARTBEAT_TIMEOUT),
            lambda value: self.set_plain(
                addresses.HEARTBEAT_TIMEOUT, max(value, SHORTEST_HEARTBEAT_MS)
            ),
        )
        for address, name in (
            (addresses.PRIMARY_PORT, "PrimaryApplicationPort"),
            (addresses.PRIMARY_ADDRESS, "PrimaryApplicationAddress"),
            (addresses.CONTROL_PRIVILEGE, "ControlPrivilege"),
            (addresses.STREAM_SOURCE_PORT, "GevSCSP"),
            (addresses.MESSAGE_SOURCE_PORT, "GevMCSP"),
        ):
            self._add_word(address, name, partial(self.plain, address), None)
        for address, name, mask in (
            (addresses.GVCP_CONFIGURATION, "GVCPConfiguration", PENDING_ENABLE),
            (addresses.MESSAGE_PORT, "GevMCPHostPort", 0xFFFF),
            (addresses.MESSAGE_DESTINATION, "GevMCDA", 0xFFFFFFFF),
            (addresses.MESSAGE_TIMEOUT, "GevMCTT", 0xFFFFFFFF),
            (addresses.MESSAGE_RETRIES, "GevMCRC", 0xFFFFFFFF),
            (addresses.STREAM_PORT, "GevSCPHostPort", 0xFFFF),
            (addresses.STREAM_PACKET_DELAY, "GevSCPD", 0xFFFFFFFF),
            (addresses.STREAM_DESTINATION, "GevSCDA", 0xFFFFFFFF),
        ):
            self._add_word(
                address, name, partial(self.plain, address), partial(self._store, address, mask)
            )
        self._add_word(
            addresses.STREAM_PACKET_SIZE,
            "GevSCPSPacketSize",
            self._packet_word,
            self._set_packet_word,
        )
        self._add_word(
            addresses.TIMESTAMP_CONTROL, "TimestampControl", lambda: 0, self._control_clock
        )
        self._add_word(
            addresses.TIMESTAMP_HIGH, "TimestampHigh", lambda: self._latched_ns >> 32, None
        )
        self._add_word(
            addresses.TIMESTAMP_LOW, "TimestampLow", lambda: self._latched_ns & 0xFFFFFFFF, None
        )
        self._registers[addresses.USER_NAME] = _Register(
            name="DeviceUserID",
            length=USER_NAME_BYTES,
            read=lambda: self._user_name,
            write=self._set_user_name,
        )

    def _add_word(
        self,
        address: int,
        name: str,
        read: Callable[[], int],
        write: Callable[[int], None] | None,
    ) -> None:
        self._registers[address] = _Register(
            name=name,
            length=4,
            read=lambda: struct.pack(">I", read()),
            write=None if write is None else lambda data: write(int.from_bytes(data, "big")),
        )

    def _store(self, address: BootstrapAddress, mask: int, value: int) -> None:
        self._plain[address] = value & mask

    def _packet_word(self) -> int:
        flags = self._plain[BootstrapAddress.STREAM_PACKET_SIZE]
        return flags | int(self._state.value("GevSCPSPacketSize"))

    def _set_packet_word(self, value: int) -> None:
        # An impossible packet size becomes the nearest one below: clients read it back.
        step = PACKET_SIZE_STEP
        size = max(min(value & PACKET_SIZE_MASK, LARGEST_PACKET) // step * step, SMALLEST_PACKET)
        if size != self._state.value("GevSCPSPacketSize"):
            self._state.set_value("GevSCPSPacketSize", size)
        self._plain[BootstrapAddress.STREAM_PACKET_SIZE] = value & DO_NOT_FRAGMENT
        if value & FIRE_TEST_PACKET:
            self._fire_test_packet()

    def _control_clock(self, value: int) -> None:
        if value & TIMESTAMP_RESET:
            self._zero_ns = monotonic_ns()
        if value & TIMESTAMP_LATCH:
            self._latched_ns = self.now_ticks

    def _set_user_name(self, data: bytes) -> None:
        self._user_name = data[: USER_NAME_BYTES - 1] + b"\0"


def _check_alignment(address: int) -> None:
    if address % 4:
        raise GvcpError(f"{address:#x} is not aligned", status=GvcpStatus.BAD_ALIGNMENT)
