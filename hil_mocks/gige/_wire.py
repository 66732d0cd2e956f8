"""Wire formats of GigE Vision: GVCP commands, GVSP packets, and pixels: bytes to values and back.

GVSP packets are standard ones: block ids of 16 bits, of which 0 is reserved, and packet ids of 24
bits. A block is a leader with packet id 0, payload packets from 1 on, and a trailer with the id
that follows.

References
----------
GigE Vision, Video Streaming and Device Control over Ethernet Standard, version 2.0, AIA, 2011,
sections 14 to 18 and 27 (GVCP), 23 to 25 (GVSP). Pixel Format Naming Convention (PFNC) 2.1, EMVA,
2016, and its list of 32-bit values; the packed formats are the older ones of GigE Vision 1.2,
section 26: three bytes hold two pixels.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum, IntFlag

import numpy as np
from numpy.typing import NDArray

from hil_mocks.truth import MONO8_SHIFT

GVCP_PORT = 3956
KEY = 0x42
HEADER_BYTES = 8
READMEM_LIMIT_BYTES = 536
"""Most bytes of memory in one datagram: 548 of payload minus the address (section 16.3)."""

REGISTERS_LIMIT = 135
"""Most registers in one READREG."""

WRITES_LIMIT = 67
"""Most registers in one WRITEREG."""


class GvcpStatus(IntEnum):
    """Status codes of acknowledges."""

    SUCCESS = 0x0000
    NOT_IMPLEMENTED = 0x8001
    INVALID_PARAMETER = 0x8002
    INVALID_ADDRESS = 0x8003
    WRITE_PROTECT = 0x8004
    BAD_ALIGNMENT = 0x8005
    ACCESS_DENIED = 0x8006
    BUSY = 0x8007
    PACKET_UNAVAILABLE = 0x800C
    INVALID_HEADER = 0x800E
    ERROR = 0x8FFF


class CommandCode(IntEnum):
    """Commands of a client; the code of the acknowledge is one higher."""

    DISCOVERY = 0x0002
    FORCEIP = 0x0004
    PACKETRESEND = 0x0040
    READREG = 0x0080
    WRITEREG = 0x0082
    READMEM = 0x0084
    WRITEMEM = 0x0086
    PENDING = 0x0088
    """Sent only by devices; only its acknowledge, 0x0089, exists."""
    EVENT = 0x00C0
    """Sent by devices on the message channel; clients acknowledge it."""
    EVENTDATA = 0x00C2
    """As EVENT, with data of the event."""


class CommandFlag(IntFlag):
    """Flags of a command's header."""

    ACKNOWLEDGE = 0x01
    EXTENDED_IDS = 0x10
    """For PACKETRESEND: block ids of 64 bits, which this device does not use."""


class GvcpError(Exception):
    """A datagram that is not GVCP, or a command that a device refuses with a status.

    ``index`` is that of the first register or byte of a write that was refused.
    """

    def __init__(self, message: str, *, status: GvcpStatus, index: int = 0) -> None:
        super().__init__(message)
        self.status = status
        self.index = index


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """One command as received: the code may be unknown, the payload is not parsed yet."""

    code: int
    flags: int
    request_id: int
    payload: bytes

    @property
    def wants_acknowledge(self) -> bool:
        """Whether the sender expects an answer."""
        return bool(self.flags & CommandFlag.ACKNOWLEDGE)


@dataclass(frozen=True, slots=True, kw_only=True)
class MemoryRange:
    """Where READMEM reads."""

    address: int
    length: int


@dataclass(frozen=True, slots=True, kw_only=True)
class MemoryWrite:
    """What WRITEMEM writes."""

    address: int
    data: bytes


@dataclass(frozen=True, slots=True, kw_only=True)
class RegisterWrite:
    """One register of a WRITEREG."""

    address: int
    value: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ResendRequest:
    """A request for the packets ``first`` to ``last`` of a block, both included."""

    channel: int
    block_id: int
    first: int
    last: int


def acknowledge_code(command_code: int) -> int:
    """Code of the acknowledge of a command."""
    return command_code + 1


def parse_command(datagram: bytes) -> Command:
    """Read the header of a command; GvcpError if it is none, or not of the stated length."""
    if len(datagram) < HEADER_BYTES or datagram[0] != KEY:
        raise GvcpError("not a GVCP command", status=GvcpStatus.INVALID_HEADER)
    _, flags, code, length, request_id = struct.unpack_from(">BBHHH", datagram)
    if len(datagram) != HEADER_BYTES + length:
        raise GvcpError(
            f"a command states {length} bytes but has {len(datagram) - HEADER_BYTES}",
            status=GvcpStatus.INVALID_HEADER,
        )
    if request_id == 0:
        raise GvcpError("request id 0 is reserved", status=GvcpStatus.INVALID_HEADER)
    return Command(code=code, flags=flags, request_id=request_id, payload=datagram[HEADER_BYTES:])


def is_discovery(datagram: bytes) -> bool:
    """Whether a datagram is a discovery command."""
    try:
        return parse_command(datagram).code == CommandCode.DISCOVERY
    except GvcpError:
        return False


def encode_acknowledge(
    command_code: int,
    request_id: int,
    payload: bytes = b"",
    status: GvcpStatus = GvcpStatus.SUCCESS,
) -> bytes:
    """Return the datagram that answers a command."""
    code = acknowledge_code(command_code)
    return struct.pack(">HHHH", status, code & 0xFFFF, len(payload), request_id) + payload


def encode_write_result(index: int) -> bytes:
    """Return the payload of the acknowledge of a write, whether it was refused or not.

    ``index`` counts registers (WRITEREG) or bytes (WRITEMEM) written; of a refused write it is that
    of the first that was not (sections 16.2 and 16.4).
    """
    return struct.pack(">HH", 0, index)


def encode_pending(request_id: int, wait_ms: int) -> bytes:
    """Return the datagram that asks a client to wait up to ``wait_ms`` longer for its answer."""
    return encode_acknowledge(CommandCode.PENDING, request_id, struct.pack(">HH", 0, wait_ms))


def parse_read_registers(payload: bytes) -> list[int]:
    """Return the addresses that a READREG asks for, one to 135 of them; GvcpError if malformed."""
    count = len(payload) // 4
    if len(payload) % 4 or not 1 <= count <= REGISTERS_LIMIT:
        raise _invalid("READREG", payload)
    return list(struct.unpack(f">{count}I", payload))


def parse_write_registers(payload: bytes) -> list[RegisterWrite]:
    """Return what a WRITEREG writes, one to 67 registers; GvcpError if malformed."""
    count = len(payload) // 8
    if len(payload) % 8 or not 1 <= count <= WRITES_LIMIT:
        raise _invalid("WRITEREG", payload)
    return [
        RegisterWrite(address=address, value=value)
        for address, value in struct.iter_unpack(">II", payload)
    ]


def parse_read_memory(payload: bytes) -> MemoryRange:
    """Return what a READMEM asks for; GvcpError if malformed, too long or not whole words."""
    if len(payload) != HEADER_BYTES:
        raise _invalid("READMEM", payload)
    address, _, length = struct.unpack(">IHH", payload)
    if not 0 < length <= READMEM_LIMIT_BYTES:
        raise _invalid("READMEM", payload)
    _check_alignment(address, length)
    return MemoryRange(address=address, length=length)


def parse_write_memory(payload: bytes) -> MemoryWrite:
    """Return what a WRITEMEM writes; GvcpError if malformed or not whole 32-bit words."""
    if not 4 < len(payload) <= 4 + READMEM_LIMIT_BYTES:
        raise _invalid("WRITEMEM", payload)
    (address,) = struct.unpack_from(">I", payload)
    _check_alignment(address, len(payload) - 4)
    return MemoryWrite(address=address, data=payload[4:])


def parse_resend_request(payload: bytes) -> ResendRequest:
    """Return what a PACKETRESEND asks for; GvcpError if malformed.

    The form for 64-bit block ids is too long and so refused.
    """
    if len(payload) != 12:
        raise _invalid("PACKETRESEND", payload)
    channel, block_id, first, last = struct.unpack(">HHII", payload)
    first, last = first & 0xFFFFFF, last & 0xFFFFFF
    if block_id == 0 or last < first:
        raise _invalid("PACKETRESEND", payload)
    return ResendRequest(channel=channel, block_id=block_id, first=first, last=last)


def _invalid(name: str, payload: bytes) -> GvcpError:
    return GvcpError(
        f"malformed {name} of {len(payload)} bytes", status=GvcpStatus.INVALID_PARAMETER
    )


def _check_alignment(address: int, length: int) -> None:
    if address % 4 or length % 4:
        raise GvcpError(
            f"{length} bytes at {address:#x} are not whole 32-bit words",
            status=GvcpStatus.BAD_ALIGNMENT,
        )


IP_UDP_HEADER_BYTES = 28
"""IPv4 and UDP headers: GevSCPSPacketSize counts them too."""

GVSP_HEADER_BYTES = 8
PAYLOAD_TYPE_IMAGE = 0x0001
PAYLOAD_TYPE_CHUNKS = 0x0004
"""Its leader tells only the time stamp: the picture is one of the chunks."""

PAYLOAD_TYPE_IMAGE_AND_CHUNKS = 0x4001
"""An image with the flag that chunks follow it: its leader is that of an image."""

IMAGE_CHUNK_ID = 0x0001
CHUNK_TRAILER = struct.Struct(">II")
CHUNK_VALUE_BYTES = 8
LEADER_BODY = struct.Struct(">HHIIIIIIIHH")
TRAILER_BODY = struct.Struct(">HHI")


class PacketFormat(IntEnum):
    """Kind of a packet."""

    LEADER = 1
    TRAILER = 2
    PAYLOAD = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class GvspHeader:
    """The first eight bytes of a packet."""

    status: int = 0
    block_id: int
    packet_format: PacketFormat
    packet_id: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageLeader:
    """What a leader states about the image that follows."""

    timestamp_ticks: int
    pixel_format: int
    width: int
    height: int
    offset_x: int = 0
    offset_y: int = 0
    payload_type: int = PAYLOAD_TYPE_IMAGE


def chunked_bytes(image_bytes: int, chunks: int) -> int:
    """Bytes of an image with so many chunks beside it; the same without any."""
    if not chunks:
        return image_bytes
    whole_words = -(-image_bytes // 4) * 4
    return whole_words + chunks * CHUNK_VALUE_BYTES + (1 + chunks) * CHUNK_TRAILER.size


def encode_chunks(image_bytes: bytes, chunks: Mapping[int, bytes]) -> bytes:
    """Lay out an image and what it carries: data before its id and length, in whole words."""
    parts = {IMAGE_CHUNK_ID: image_bytes.ljust(-(-len(image_bytes) // 4) * 4, b"\0"), **chunks}
    return b"".join(
        data + CHUNK_TRAILER.pack(chunk_id, len(data)) for chunk_id, data in parts.items()
    )


def payload_bytes_per_packet(packet_size_bytes: int) -> int:
    """Image bytes in one packet of a size that includes the IP and UDP headers."""
    return packet_size_bytes - IP_UDP_HEADER_BYTES - GVSP_HEADER_BYTES


def encode_header(header: GvspHeader) -> bytes:
    """Return the eight bytes of a header."""
    return struct.pack(
        ">HHI",
        header.status,
        header.block_id,
        header.packet_format << 24 | header.packet_id,
    )


def encode_leader(block_id: int, leader: ImageLeader) -> bytes:
    """Return the leader packet of an image."""
    header = GvspHeader(block_id=block_id, packet_format=PacketFormat.LEADER, packet_id=0)
    picture = (
        leader.pixel_format,
        leader.width,
        leader.height,
        leader.offset_x,
        leader.offset_y,
    )
    if leader.payload_type == PAYLOAD_TYPE_CHUNKS:
        picture = (0, 0, 0, 0, 0)
    return encode_header(header) + LEADER_BODY.pack(
        0,
        leader.payload_type,
        leader.timestamp_ticks >> 32 & 0xFFFFFFFF,
        leader.timestamp_ticks & 0xFFFFFFFF,
        *picture,
        0,
        0,
    )


def encode_trailer(block_id: int, packet_id: int, leader: ImageLeader) -> bytes:
    """Return the trailer packet of an image."""
    header = GvspHeader(block_id=block_id, packet_format=PacketFormat.TRAILER, packet_id=packet_id)
    return encode_header(header) + TRAILER_BODY.pack(0, leader.payload_type, leader.height)


def encode_payload_packets(
    block_id: int, image_bytes: NDArray[np.uint8], payload_bytes: int
) -> NDArray[np.uint8]:
    """Lay out an image, shape ``(n,)``, as consecutive payload packets in memory.

    Each has ``payload_bytes`` of it, the last one the rest; packet ``i`` (its id is ``i + 1``)
    begins at ``i * (8 + payload_bytes)``.
    """
    whole, rest = divmod(image_bytes.size, payload_bytes)
    count = whole + (rest > 0)
    stride = GVSP_HEADER_BYTES + payload_bytes
    packets = np.empty(image_bytes.size + count * GVSP_HEADER_BYTES, np.uint8)
    headers = np.zeros((count, 2), ">u4")
    headers[:, 0] = block_id
    headers[:, 1] = (PacketFormat.PAYLOAD << 24) + np.arange(1, count + 1)
    header_bytes = headers.view(np.uint8)
    table = packets[: whole * stride].reshape(whole, stride)
    table[:, :GVSP_HEADER_BYTES] = header_bytes[:whole]
    table[:, GVSP_HEADER_BYTES:] = image_bytes[: whole * payload_bytes].reshape(
        whole, payload_bytes
    )
    if rest:
        packets[whole * stride : whole * stride + GVSP_HEADER_BYTES] = header_bytes[whole]
        packets[whole * stride + GVSP_HEADER_BYTES :] = image_bytes[whole * payload_bytes :]
    return packets


MONO16_SHIFT = 4
"""Mono16 holds the 12 bits in its upper bits."""

BAYER_ORDERS = ("GR", "RG", "GB", "BG")


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelLayout:
    """Memory layout of the levels of one pixel format."""

    code: int
    significant_bits: int
    is_packed: bool = False

    @property
    def bits_per_pixel(self) -> int:
        """Bits of a pixel on the wire, as contained in the code (PFNC)."""
        return self.code >> 16 & 0xFF


def _layouts() -> dict[str, PixelLayout]:
    layouts = {
        "Mono8": PixelLayout(code=0x01080001, significant_bits=8),
        "Mono12": PixelLayout(code=0x01100005, significant_bits=12),
        "Mono12Packed": PixelLayout(code=0x010C0006, significant_bits=12, is_packed=True),
        "Mono16": PixelLayout(code=0x01100007, significant_bits=16),
    }
    for index, order in enumerate(BAYER_ORDERS):
        layouts |= {
            f"Bayer{order}8": PixelLayout(code=0x01080008 + index, significant_bits=8),
            f"Bayer{order}12": PixelLayout(code=0x01100010 + index, significant_bits=12),
            f"Bayer{order}12Packed": PixelLayout(
                code=0x010C002A + index, significant_bits=12, is_packed=True
            ),
        }
    return layouts


PIXEL_LAYOUTS = _layouts()
"""Every pixel format by its name."""


def pixel_formats_of(bayer_order: str | None) -> tuple[str, ...]:
    """Names that a camera offers: the mono ones, and those of its colour filter if it has one."""
    mono = ("Mono8", "Mono12", "Mono12Packed", "Mono16")
    if bayer_order is None:
        return mono
    return (*mono, *(f"Bayer{bayer_order}{depth}" for depth in ("8", "12", "12Packed")))


def image_of_levels(
    level_dn: NDArray[np.uint16], layout: PixelLayout
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Convert 12-bit levels to those of a pixel format, unpacked as a client reads them."""
    if layout.significant_bits == 8:
        return (level_dn >> MONO8_SHIFT).astype(np.uint8)
    if layout.significant_bits == 16:
        return (level_dn << MONO16_SHIFT).astype(np.uint16, copy=False)
    return level_dn


def wire_bytes(level_dn: NDArray[np.uint16], layout: PixelLayout) -> NDArray[np.uint8]:
    """Bytes of an image of 12-bit levels in a pixel format, shape ``(n,)``.

    ValueError if a packed format has an odd number of pixels.
    """
    image = np.ascontiguousarray(image_of_levels(level_dn, layout)).ravel()
    if not layout.is_packed:
        return image.astype(image.dtype.newbyteorder("<"), copy=False).view(np.uint8)
    if image.size % 2:
        raise ValueError(f"a packed image needs an even number of pixels, got {image.size}")
    pairs = np.ascontiguousarray(image).view("<u4")
    # One pair is 0x0BBB0AAA; its bytes are A >> 4, then both low nibbles (A's below), then B >> 4.
    packed = np.empty((pairs.size, 3), np.uint8)
    packed[:, 0] = pairs >> 4
    packed[:, 1] = (pairs & 0x0F) | (pairs >> 12 & 0xF0)
    packed[:, 2] = pairs >> 20
    return packed.ravel()
