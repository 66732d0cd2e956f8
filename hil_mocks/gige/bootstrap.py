"""Bootstrap registers: identity, capabilities and description URL of a GigE Vision device.

References
----------
GigE Vision, Video Streaming and Device Control over Ethernet Standard, version 2.0, AIA, 2011,
section 28, "Bootstrap registers".
"""

import ipaddress
import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag

from hil_mocks.gige.feature import Maker

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


def bootstrap_page(identity: Identity, address: str, url: str) -> bytearray:
    """Return the registers 0x0000 to 0x0FFF as they are at power-up.

    Parameters
    ----------
    identity
        The device's names.
    address
        Its IPv4 address.
    url
        URL of its description.
    """
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
