"""The control channel of the simulated GigE camera: access rights and answers.

References
----------
GigE Vision, Video Streaming and Device Control over Ethernet Standard, version 2.0, AIA, 2011,
sections 10 (control channel privilege and heartbeat) and 14 to 18 (commands).
"""

import ipaddress
import struct
from collections.abc import Callable
from enum import IntFlag
from time import monotonic

from hil_mocks.gige.bootstrap import BootstrapAddress
from hil_mocks.gige.faults import GigeFaults
from hil_mocks.gige.gvcp import (
    Command,
    CommandCode,
    GvcpError,
    GvcpStatus,
    MemoryWrite,
    ResendRequest,
    encode_acknowledge,
    encode_write_result,
    parse_command,
    parse_read_memory,
    parse_read_registers,
    parse_resend_request,
    parse_write_memory,
    parse_write_registers,
)
from hil_mocks.gige.registers import RegisterMap

Peer = tuple[str, int]
WRITES = (CommandCode.WRITEREG, CommandCode.WRITEMEM)


class Privilege(IntFlag):
    """Bits of the control channel privilege register."""

    EXCLUSIVE = 0x1
    CONTROL = 0x2


class ControlChannel:
    """Answers the commands of clients; one of them can hold control.

    Control is lost by a release, after the heartbeat timeout without a command, or by `drop`; the
    stream ends with it.

    Parameters
    ----------
    registers
        The camera's memory.
    faults
        The present faults.
    resend
        Resends packets.
    end_stream
        Called when control ends.
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
        """Carry out the command in a datagram.

        Returns
        -------
        bytes or None
            The acknowledge, or None: not GVCP, no answer requested, or no power.
        """
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
        wanted = int.from_bytes(data[:4], "big") & (Privilege.EXCLUSIVE | Privilege.CONTROL)
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
        if privilege & Privilege.EXCLUSIVE and peer != self._controller:
            raise GvcpError("another client has exclusive control", status=GvcpStatus.ACCESS_DENIED)

    def _check_may_write(self, peer: Peer) -> None:
        if peer != self._controller:
            raise GvcpError("the client does not hold control", status=GvcpStatus.ACCESS_DENIED)
