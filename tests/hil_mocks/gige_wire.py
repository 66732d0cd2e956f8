"""The client's half of GVCP and GVSP: commands as bytes, and what a device answers and streams."""

import struct
from dataclasses import dataclass

from hil_mocks.gige._wire import (
    GVSP_HEADER_BYTES,
    HEADER_BYTES,
    KEY,
    LEADER_BODY,
    PAYLOAD_TYPE_IMAGE,
    TRAILER_BODY,
    CommandFlag,
    GvcpError,
    GvcpStatus,
    GvspHeader,
    ImageLeader,
    PacketFormat,
    RegisterWrite,
    ResendRequest,
)

EXTENDED_IDS = 0x80


@dataclass(frozen=True, slots=True, kw_only=True)
class Acknowledge:
    """One answer of a device."""

    status: int
    code: int
    request_id: int
    payload: bytes


def encode_command(
    code: int, request_id: int, payload: bytes = b"", flags: int = CommandFlag.ACKNOWLEDGE
) -> bytes:
    """Return the datagram of a command."""
    return struct.pack(">BBHHH", KEY, flags, code, len(payload), request_id) + payload


def parse_acknowledge(datagram: bytes) -> Acknowledge:
    """Read an answer of a device; GvcpError if it is shorter or longer than it says."""
    if len(datagram) < HEADER_BYTES:
        raise GvcpError("not a GVCP acknowledge", status=GvcpStatus.INVALID_HEADER)
    status, code, length, request_id = struct.unpack_from(">HHHH", datagram)
    if len(datagram) != HEADER_BYTES + length:
        raise GvcpError(
            f"an acknowledge of {length} bytes came with {len(datagram) - HEADER_BYTES}",
            status=GvcpStatus.INVALID_HEADER,
        )
    return Acknowledge(
        status=status, code=code, request_id=request_id, payload=datagram[HEADER_BYTES:]
    )


def encode_read_registers(addresses: list[int]) -> bytes:
    """Return the payload of READREG."""
    return struct.pack(f">{len(addresses)}I", *addresses)


def encode_write_registers(writes: list[RegisterWrite]) -> bytes:
    """Return the payload of WRITEREG."""
    return b"".join(struct.pack(">II", write.address, write.value) for write in writes)


def encode_read_memory(address: int, length: int) -> bytes:
    """Return the payload of READMEM."""
    return struct.pack(">IHH", address, 0, length)


def encode_write_memory(address: int, data: bytes) -> bytes:
    """Return the payload of WRITEMEM."""
    return struct.pack(">I", address) + data


def encode_resend_request(request: ResendRequest) -> bytes:
    """Return the payload of PACKETRESEND, with a block id of 16 bits."""
    return struct.pack(">HHII", request.channel, request.block_id, request.first, request.last)


class GvspError(Exception):
    """A datagram that is no packet of a standard GVSP stream."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GvspPacket:
    """One packet: header and what follows."""

    header: GvspHeader
    body: bytes


def parse_packet(datagram: bytes) -> GvspPacket:
    """Read one packet; GvspError if it is too short, or of extended ids or another payload."""
    if len(datagram) < GVSP_HEADER_BYTES:
        raise GvspError(f"{len(datagram)} bytes are no GVSP packet")
    status, block_id, word = struct.unpack_from(">HHI", datagram)
    if word >> 24 & EXTENDED_IDS:
        raise GvspError("the packet has extended ids")
    try:
        packet_format = PacketFormat(word >> 24 & 0x0F)
    except ValueError as error:
        raise GvspError(f"unknown packet format {word >> 24 & 0x0F}") from error
    header = GvspHeader(
        status=status, block_id=block_id, packet_format=packet_format, packet_id=word & 0xFFFFFF
    )
    return GvspPacket(header=header, body=datagram[GVSP_HEADER_BYTES:])


def parse_leader(body: bytes) -> ImageLeader:
    """Read what follows the header of a leader; GvspError if it is no image's."""
    if len(body) < LEADER_BODY.size:
        raise GvspError(f"a leader of {len(body)} bytes")
    _, payload_type, high, low, pixel_format, width, height, x, y, _, _ = LEADER_BODY.unpack_from(
        body
    )
    if payload_type != PAYLOAD_TYPE_IMAGE:
        raise GvspError(f"payload type {payload_type:#06x} is no image")
    return ImageLeader(
        timestamp_ticks=high << 32 | low,
        pixel_format=pixel_format,
        width=width,
        height=height,
        offset_x=x,
        offset_y=y,
    )


def parse_trailer(body: bytes) -> int:
    """Return the number of rows that a trailer says were sent; GvspError if it is no image's."""
    if len(body) < TRAILER_BODY.size:
        raise GvspError(f"a trailer of {len(body)} bytes")
    _, payload_type, height = TRAILER_BODY.unpack_from(body)
    if payload_type != PAYLOAD_TYPE_IMAGE:
        raise GvspError(f"payload type {payload_type:#06x} is no image")
    return int(height)
