"""Wire format of GVSP, the stream protocol of GigE Vision: leader, payload and trailer packets.

Standard packets: block ids of 16 bits, of which 0 is reserved, and packet ids of 24 bits. A block
is a leader with packet id 0, payload packets from 1 on, and a trailer with the id that follows.

References
----------
GigE Vision, Video Streaming and Device Control over Ethernet Standard, version 2.0, AIA, 2011,
sections 23 to 25.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

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
    """Lay out an image as consecutive payload packets in memory.

    Parameters
    ----------
    image_bytes
        The image as it goes over the wire, shape ``(n,)``.
    payload_bytes
        Image bytes in each packet but the last, which takes the rest.

    Returns
    -------
    ndarray of uint8
        Headers and payload; packet ``i`` (its id is ``i + 1``) begins at
        ``i * (8 + payload_bytes)``.
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
