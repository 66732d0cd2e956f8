from collections.abc import Callable
from contextlib import suppress

import pytest
from hypothesis import given, strategies as st

from hil_mocks.gige._wire import (
    Command,
    CommandCode,
    GvcpError,
    GvcpStatus,
    MemoryRange,
    MemoryWrite,
    RegisterWrite,
    ResendRequest,
    encode_acknowledge,
    encode_pending,
    parse_command,
    parse_read_memory,
    parse_read_registers,
    parse_resend_request,
    parse_write_memory,
    parse_write_registers,
)
from tests.hil_mocks.gige_wire import (
    encode_command,
    encode_read_memory,
    encode_read_registers,
    encode_resend_request,
    encode_write_memory,
    encode_write_registers,
    parse_acknowledge,
)

WORDS = st.integers(0, 2**32 - 1)
PARSERS: list[Callable[[bytes], object]] = [
    parse_command,
    parse_acknowledge,
    parse_read_registers,
    parse_write_registers,
    parse_read_memory,
    parse_write_memory,
    parse_resend_request,
]


def test_a_command_is_laid_out_as_the_standard_says() -> None:
    # By hand: key, flag "acknowledge", READREG, 4 bytes, request 5; the address of CCP.
    datagram = bytes.fromhex("42 01 0080 0004 0005 00000A00")
    assert encode_command(CommandCode.READREG, 5, encode_read_registers([0x0A00])) == datagram
    assert parse_command(datagram) == Command(
        code=0x80, flags=1, request_id=5, payload=bytes.fromhex("00000A00")
    )


def test_an_acknowledge_is_laid_out_as_the_standard_says() -> None:
    # By hand: success, READREG_ACK, 4 bytes, request 5, the value 2.
    assert encode_acknowledge(CommandCode.READREG, 5, b"\0\0\0\x02") == bytes.fromhex(
        "0000 0081 0004 0005 00000002"
    )
    refused = encode_acknowledge(CommandCode.WRITEREG, 6, status=GvcpStatus.ACCESS_DENIED)
    assert refused == bytes.fromhex("8006 0083 0000 0006")


def test_a_request_for_patience_is_laid_out_as_the_standard_says() -> None:
    # By hand: success, PENDING_ACK, 4 bytes, request 7, reserved, 250 ms.
    assert encode_pending(7, 250) == bytes.fromhex("0000 0089 0004 0007 0000 00FA")


def test_a_resend_request_is_laid_out_as_the_standard_says() -> None:
    request = ResendRequest(channel=0, block_id=0x1234, first=3, last=9)
    assert encode_resend_request(request) == bytes.fromhex("0000 1234 00000003 00000009")
    assert parse_resend_request(encode_resend_request(request)) == request


@given(data=st.binary(max_size=700), parser=st.sampled_from(PARSERS))
def test_a_parser_raises_nothing_but_its_own_error(
    data: bytes, parser: Callable[[bytes], object]
) -> None:
    with suppress(GvcpError):
        parser(data)


@given(
    code=st.integers(0, 0xFFFF),
    flags=st.integers(0, 0xFF),
    request_id=st.integers(1, 0xFFFF),
    payload=st.binary(max_size=540),
)
def test_commands_come_back_as_they_went(
    code: int, flags: int, request_id: int, payload: bytes
) -> None:
    command = parse_command(encode_command(code, request_id, payload, flags))
    assert command == Command(code=code, flags=flags, request_id=request_id, payload=payload)


@given(st.lists(WORDS, min_size=1, max_size=135))
def test_register_reads_come_back_as_they_went(addresses: list[int]) -> None:
    assert parse_read_registers(encode_read_registers(addresses)) == addresses


@given(st.lists(st.tuples(WORDS, WORDS), min_size=1, max_size=67))
def test_register_writes_come_back_as_they_went(pairs: list[tuple[int, int]]) -> None:
    writes = [RegisterWrite(address=address, value=value) for address, value in pairs]
    assert parse_write_registers(encode_write_registers(writes)) == writes


@given(place=st.integers(0, 2**30 - 1), words=st.integers(1, 134))
def test_memory_commands_come_back_as_they_went(place: int, words: int) -> None:
    address, length = 4 * place, 4 * words
    assert parse_read_memory(encode_read_memory(address, length)) == MemoryRange(
        address=address, length=length
    )
    data = bytes(range(256))[:length] * (length // 256 + 1)
    write = MemoryWrite(address=address, data=data[:length])
    assert parse_write_memory(encode_write_memory(address, data[:length])) == write


@pytest.mark.parametrize(
    ("datagram", "status"),
    [
        (b"", GvcpStatus.INVALID_HEADER),
        (bytes.fromhex("41 01 0002 0000 0001"), GvcpStatus.INVALID_HEADER),  # another key
        (bytes.fromhex("42 01 0002 0004 0001"), GvcpStatus.INVALID_HEADER),  # shorter than it says
        (bytes.fromhex("42 01 0002 0000 0000"), GvcpStatus.INVALID_HEADER),  # request id 0
    ],
)
def test_what_is_no_command_is_refused(datagram: bytes, status: GvcpStatus) -> None:
    with pytest.raises(GvcpError) as caught:
        parse_command(datagram)
    assert caught.value.status == status


def test_memory_that_is_not_aligned_has_a_status_of_its_own() -> None:
    with pytest.raises(GvcpError) as caught:
        parse_read_memory(encode_read_memory(2, 4))
    assert caught.value.status == GvcpStatus.BAD_ALIGNMENT
    with pytest.raises(GvcpError) as caught:
        parse_read_memory(encode_read_memory(0, 540))
    assert caught.value.status == GvcpStatus.INVALID_PARAMETER
