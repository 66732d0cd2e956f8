"""Wire format of GVCP, the control protocol of GigE Vision: bytes to commands and back.

References
----------
GigE Vision, Video Streaming and Device Control over Ethernet Standard, version 2.0, AIA, 2011,
sections 14 to 18 and 27 (status codes).
"""

import struct
from dataclasses import dataclass
from enum import IntEnum, IntFlag

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
    """Read the header of a command.

    Raises
    ------
    GvcpError
        If the datagram is not a GVCP command, or its length is not the stated one.
    """
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

    Parameters
    ----------
    index
        Registers (WRITEREG) or bytes (WRITEMEM) written; of a refused write, the index of the
        first that was not (sections 16.2 and 16.4).
    """
    return struct.pack(">HH", 0, index)


def encode_pending(request_id: int, wait_ms: int) -> bytes:
    """Return the datagram that asks a client to wait up to ``wait_ms`` longer for its answer."""
    return encode_acknowledge(CommandCode.PENDING, request_id, struct.pack(">HH", 0, wait_ms))


def parse_read_registers(payload: bytes) -> list[int]:
    """Return the addresses that a READREG asks for, one to 135 of them.

    Raises
    ------
    GvcpError
        If the payload is not such a list.
    """
    count = len(payload) // 4
    if len(payload) % 4 or not 1 <= count <= REGISTERS_LIMIT:
        raise _invalid("READREG", payload)
    return list(struct.unpack(f">{count}I", payload))


def parse_write_registers(payload: bytes) -> list[RegisterWrite]:
    """Return what a WRITEREG writes, one to 67 registers.

    Raises
    ------
    GvcpError
        If the payload is not such a list.
    """
    count = len(payload) // 8
    if len(payload) % 8 or not 1 <= count <= WRITES_LIMIT:
        raise _invalid("WRITEREG", payload)
    return [
        RegisterWrite(address=address, value=value)
        for address, value in struct.iter_unpack(">II", payload)
    ]


def parse_read_memory(payload: bytes) -> MemoryRange:
    """Return what a READMEM asks for.

    Raises
    ------
    GvcpError
        If the payload is malformed, or the range is too long or not whole 32-bit words.
    """
    if len(payload) != HEADER_BYTES:
        raise _invalid("READMEM", payload)
    address, _, length = struct.unpack(">IHH", payload)
    if not 0 < length <= READMEM_LIMIT_BYTES:
        raise _invalid("READMEM", payload)
    _check_alignment(address, length)
    return MemoryRange(address=address, length=length)


def parse_write_memory(payload: bytes) -> MemoryWrite:
    """Return what a WRITEMEM writes.

    Raises
    ------
    GvcpError
        If the payload is malformed or does not write whole 32-bit words.
    """
    if not 4 < len(payload) <= 4 + READMEM_LIMIT_BYTES:
        raise _invalid("WRITEMEM", payload)
    (address,) = struct.unpack_from(">I", payload)
    _check_alignment(address, len(payload) - 4)
    return MemoryWrite(address=address, data=payload[4:])


def parse_resend_request(payload: bytes) -> ResendRequest:
    """Return what a PACKETRESEND asks for.

    Raises
    ------
    GvcpError
        If the payload is malformed; the form for 64-bit block ids is too long and so refused.
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
