"""The memory of the simulated GigE camera, which a client reads and writes by address.

References
----------
GigE Vision, Video Streaming and Device Control over Ethernet Standard, version 2.0, AIA, 2011,
section 28, "Bootstrap registers".
"""

import ipaddress
import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum, IntFlag
from functools import partial, reduce
from operator import or_
from time import monotonic_ns

from hil_mocks.gige._description import DESCRIPTION_FILE, describe
from hil_mocks.gige._events import EventSwitches, MessageTarget
from hil_mocks.gige._features import DEVICE_PAGE, Feature, Maker
from hil_mocks.gige._settings import CameraState
from hil_mocks.gige._wire import READMEM_LIMIT_BYTES, GvcpError, GvcpStatus, MemoryWrite

BOOTSTRAP_BYTES = 0x1000
DISCOVERY_BYTES = 0xF8
"""The discovery acknowledge consists of the registers up to the user-defined name."""

TICKS_PER_S = 1_000_000_000


class BootstrapAddress(IntEnum):
    """Addresses that the device handles specially."""

    MANUFACTURER_NAME = 0x0048
    MODEL_NAME = 0x0068
    DEVICE_VERSION = 0x0088
    MANUFACTURER_INFO = 0x00A8
    SERIAL_NUMBER = 0x00D8
    USER_NAME = 0x00E8
    FIRST_URL = 0x0200
    CAPABILITY = 0x0934
    HEARTBEAT_TIMEOUT = 0x0938
    TICK_FREQUENCY_HIGH = 0x093C
    TICK_FREQUENCY_LOW = 0x0940
    TIMESTAMP_CONTROL = 0x0944
    TIMESTAMP_HIGH = 0x0948
    TIMESTAMP_LOW = 0x094C
    GVCP_CONFIGURATION = 0x0954
    PENDING_TIMEOUT = 0x0958
    CONTROL_PRIVILEGE = 0x0A00
    PRIMARY_PORT = 0x0A04
    PRIMARY_ADDRESS = 0x0A14
    MESSAGE_PORT = 0x0B00
    MESSAGE_DESTINATION = 0x0B10
    MESSAGE_TIMEOUT = 0x0B14
    MESSAGE_RETRIES = 0x0B18
    MESSAGE_SOURCE_PORT = 0x0B1C
    STREAM_PORT = 0x0D00
    STREAM_PACKET_SIZE = 0x0D04
    STREAM_PACKET_DELAY = 0x0D08
    STREAM_DESTINATION = 0x0D18
    STREAM_SOURCE_PORT = 0x0D1C


class Capability(IntFlag):
    """Bits of the GVCP capability register that this device may set."""

    CONCATENATION = 1 << 0
    WRITEMEM = 1 << 1
    PACKETRESEND = 1 << 2
    EVENT = 1 << 3
    EVENTDATA = 1 << 4
    PENDING = 1 << 5
    PRIMARY_APPLICATION = 1 << 27
    SERIAL_NUMBER = 1 << 30
    USER_NAME = 1 << 31


@dataclass(frozen=True, slots=True, kw_only=True)
class Identity:
    """Names that a device gives itself; the registers hold 31, 31, 31 and 15 bytes of them.

    ``maker`` is whose cameras it is like, which no register tells.
    """

    vendor: str = "standoff"
    model: str = "Simulated Manta G-046B"
    version: str = "1"
    serial_number: str = "SIM-1"
    maker: Maker = "allied_vision"


_LOOPBACK = ipaddress.IPv4Network("127.0.0.0/8")

_VENDOR_NAMES: dict[Maker, str] = {
    "basler": "Basler",
    "flir": "Point Grey Research",
    "teledyne_dalsa": "Teledyne DALSA",
    "hikrobot": "Hikrobot",
    "ids": "IDS Imaging Development Systems",
}
"""What cameras of these makers name as theirs."""


def maker_identity(maker: Maker, address: str = "127.0.0.1") -> Identity:
    """The names of a simulated camera of this maker; its serial number is that of its address."""
    number = int(ipaddress.IPv4Address(address)) - int(_LOOPBACK.network_address)
    serial_number = f"SIM-{number}"
    if maker == "allied_vision":
        return Identity(serial_number=serial_number)
    return Identity(
        vendor=_VENDOR_NAMES[maker],
        model=f"Simulated {maker}",
        serial_number=serial_number,
        maker=maker,
    )


def _bootstrap_page(identity: Identity, address: str, url: str) -> bytearray:
    """Return the registers 0x0000 to 0x0FFF as they are at power-up."""
    page = bytearray(BOOTSTRAP_BYTES)
    ip = int(ipaddress.IPv4Address(address))

    def put(offset: int, *words: int) -> None:
        struct.pack_into(f">{len(words)}I", page, offset, *words)

    def text(offset: int, value: str, length: int) -> None:
        encoded = value.encode("utf-8")[: length - 1]
        page[offset : offset + len(encoded)] = encoded

    put(0x0000, 0x0001_0002)  # version 1.2
    put(0x0004, 0x8000_0001)  # big endian, UTF-8
    put(0x0008, 0x0000_0200, ip)  # MAC: locally administered, then the address
    put(0x0010, 0x6, 0x4)  # IP configurations: DHCP and link-local can be, link-local is
    put(0x0024, ip)
    put(0x0034, 0xFF00_0000)
    text(BootstrapAddress.MANUFACTURER_NAME, identity.vendor, 32)
    text(BootstrapAddress.MODEL_NAME, identity.model, 32)
    text(BootstrapAddress.DEVICE_VERSION, identity.version, 32)
    text(BootstrapAddress.MANUFACTURER_INFO, "simulated bench", 48)
    text(BootstrapAddress.SERIAL_NUMBER, identity.serial_number, 16)
    text(BootstrapAddress.FIRST_URL, url, 512)
    put(0x0600, 1)  # network interfaces
    put(0x0900, 1, 1)  # message channels, stream channels
    put(BootstrapAddress.TICK_FREQUENCY_HIGH, TICKS_PER_S >> 32, TICKS_PER_S & 0xFFFFFFFF)
    put(BootstrapAddress.PENDING_TIMEOUT, 1000)
    put(0x0D20, 0x8000_0000)  # stream channel capability: big and little endian supported
    return page


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

CAPABILITIES = reduce(or_, Capability)


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

    ``commands`` is the action of each command feature, by its name; ``fire_test_packet`` is called
    when a client asks for one.
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
        self._plain: dict[BootstrapAddress, int] = {}
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
        self._bootstrap = bytes(_bootstrap_page(self._identity, self._address, url))

    def power_up(self) -> None:
        """Set the registers to their values at power-up."""
        self._plain = dict.fromkeys(BootstrapAddress, 0) | {
            BootstrapAddress.HEARTBEAT_TIMEOUT: DEFAULT_HEARTBEAT_MS,
            BootstrapAddress.STREAM_PACKET_SIZE: DO_NOT_FRAGMENT,
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
        """Read memory from an address on; GvcpError if there is none, or words are not aligned."""
        _check_alignment(address)
        return self._memory(address, length)

    def write(self, write: MemoryWrite) -> None:
        """Write one register after another; GvcpError at the first that does not accept it."""
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
