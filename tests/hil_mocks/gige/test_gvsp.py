from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from hil_mocks.gige._wire import (
    PAYLOAD_TYPE_CHUNKS,
    GvspHeader,
    ImageLeader,
    PacketFormat,
    chunked_bytes,
    encode_chunks,
    encode_header,
    encode_leader,
    encode_payload_packets,
    encode_trailer,
    payload_bytes_per_packet,
)
from tests.hil_mocks.gige_wire import GvspError, parse_leader, parse_packet, parse_trailer

LEADER = ImageLeader(
    timestamp_ticks=0x0123_4567_89AB_CDEF,
    pixel_format=0x01100005,
    width=780,
    height=580,
    offset_x=4,
    offset_y=6,
)


def test_a_leader_is_laid_out_as_the_standard_says() -> None:
    # By hand: status, block 5, leader with packet id 0; reserved, image, time, format, sizes.
    assert encode_leader(5, LEADER) == bytes.fromhex(
        "0000 0005 01000000 0000 0001 01234567 89ABCDEF 01100005"
        "0000030C 00000244 00000004 00000006 0000 0000"
    )


def test_a_trailer_is_laid_out_as_the_standard_says() -> None:
    assert encode_trailer(5, 0x1234, LEADER) == bytes.fromhex(
        "0000 0005 02001234 0000 0001 00000244"
    )


def test_chunks_follow_the_image_each_before_its_id_and_length() -> None:
    data = encode_chunks(b"\x01\x02\x03", {0x1001: b"exposure"})
    assert data == bytes.fromhex("01020300 00000001 00000004") + b"exposure" + bytes.fromhex(
        "00001001 00000008"
    )
    assert len(data) == chunked_bytes(3, 1)


def test_the_leader_of_a_chunk_block_tells_its_type_and_time_only() -> None:
    leader = encode_leader(5, replace(LEADER, payload_type=PAYLOAD_TYPE_CHUNKS))
    assert leader == bytes.fromhex("0000 0005 01000000 0000 0004 01234567 89ABCDEF" + 24 * "00")


def test_a_packet_of_1500_bytes_holds_1464_bytes_of_the_image() -> None:
    assert payload_bytes_per_packet(1500) == 1464  # 20 of IP, 8 of UDP, 8 of GVSP


def test_leader_and_trailer_come_back_as_they_went() -> None:
    packet = parse_packet(encode_leader(5, LEADER))
    assert packet.header == GvspHeader(block_id=5, packet_format=PacketFormat.LEADER, packet_id=0)
    assert parse_leader(packet.body) == LEADER
    assert parse_trailer(parse_packet(encode_trailer(5, 9, LEADER)).body) == 580


@given(
    status=st.integers(0, 0xFFFF),
    block_id=st.integers(0, 0xFFFF),
    packet_format=st.sampled_from(PacketFormat),
    packet_id=st.integers(0, 0xFFFFFF),
)
def test_headers_come_back_as_they_went(
    status: int, block_id: int, packet_format: PacketFormat, packet_id: int
) -> None:
    header = GvspHeader(
        status=status, block_id=block_id, packet_format=packet_format, packet_id=packet_id
    )
    assert parse_packet(encode_header(header)).header == header


@given(size=st.integers(1, 4000), payload_bytes=st.integers(464, 1464))
def test_payload_packets_hold_the_image_and_nothing_else(size: int, payload_bytes: int) -> None:
    image_bytes = np.arange(size).astype(np.uint8)
    packets = encode_payload_packets(7, image_bytes, payload_bytes).tobytes()
    stride = payload_bytes + 8
    parsed = [parse_packet(packets[at : at + stride]) for at in range(0, len(packets), stride)]
    assert [packet.header.packet_id for packet in parsed] == list(range(1, len(parsed) + 1))
    assert {packet.header.packet_format for packet in parsed} == {PacketFormat.PAYLOAD}
    assert {packet.header.block_id for packet in parsed} == {7}
    assert b"".join(packet.body for packet in parsed) == image_bytes.tobytes()


@given(st.binary(max_size=100))
def test_a_parser_raises_nothing_but_its_own_error(data: bytes) -> None:
    for parser in (parse_packet, parse_leader, parse_trailer):
        try:
            parser(data)
        except GvspError:
            continue


def test_extended_ids_are_refused() -> None:
    with pytest.raises(GvspError):
        parse_packet(bytes.fromhex("0000 0005 81000000"))
