"""The memory of a GigE Vision camera, read over GVCP without control of it.

References
----------
AIA, GigE Vision, version 2.0 (2011), sections 16.3 (READMEM) and 18 (PENDING_ACK).
"""

import socket
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from types import TracebackType
from typing import Self

from acquisition.aravis.route import GVCP_PORT
from acquisition.errors import DeviceDisconnectedError, DeviceInUseError, DeviceProtocolError

KEY, WANTS_REPLY = 0x42, 0x01
READ_MEMORY, MEMORY, PENDING = 0x0084, 0x0085, 0x0089
ACCESS_DENIED, BUSY = 0x8006, 0x8007

BLOCK_BYTES = 512
"""As Aravis reads; a datagram holds 536."""

TRIES, REPLY_S = 5, 0.5
"""As Aravis asks: a camera that is gone is known after 2.5 s."""

PENDING_MOST_S = 10.0
"""A camera may ask for more time, but not for ever."""

READ_MOST_S = 60.0
"""A description of 1 MB takes a camera less than a second."""

LARGEST_DATAGRAM = 1 << 16
HEADER_BYTES = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class Reply:
    """An acknowledge as received."""

    status: int
    code: int
    request_id: int
    payload: bytes


def encode_read(address: int, length: int, request_id: int) -> bytes:
    """Return the datagram that asks for ``length`` bytes, a multiple of 4."""
    return struct.pack(
        ">BBHHHIHH", KEY, WANTS_REPLY, READ_MEMORY, 8, request_id, address, 0, length
    )


def parse_reply(datagram: bytes) -> Reply | None:
    """Return the acknowledge in a datagram, or None if it is none."""
    if len(datagram) < HEADER_BYTES:
        return None
    status, code, length, request_id = struct.unpack_from(">HHHH", datagram)
    payload = datagram[HEADER_BYTES:]
    if len(payload) < length:
        return None
    return Reply(status=status, code=code, request_id=request_id, payload=payload[:length])


class CameraMemory:
    """Reads the memory of the camera at an address; a context manager.

    Parameters
    ----------
    address
        The camera's.
    own_address
        Of the interface that leads to it.
    clock
        Monotonic time in seconds.
    """

    def __init__(
        self, address: str, own_address: str, clock: Callable[[], float] = time.monotonic
    ) -> None:
        self.address = address
        self._own_address = own_address
        self._clock = clock
        self._request_ids = count(1)

    def __enter__(self) -> Self:
        self._port = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            self._port.bind((self._own_address, 0))
        except OSError as error:
            self._port.close()
            raise DeviceDisconnectedError(self._silent(error.strerror or str(error))) from error
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._port.close()

    def read(self, address: int, length: int) -> bytes:
        """Read ``length`` bytes from ``address`` on.

        Raises
        ------
        DeviceDisconnectedError
            If the camera does not answer, or takes for ever.
        DeviceInUseError
            If another program alone may read it.
        DeviceProtocolError
            If it refuses.
        """
        ends_s = self._clock() + READ_MOST_S
        blocks: list[bytes] = []
        for start in range(0, length, BLOCK_BYTES):
            if self._clock() > ends_s:
                raise DeviceDisconnectedError(self._silent(f"not done within {READ_MOST_S:.0f} s"))
            words = -(-min(BLOCK_BYTES, length - start) // 4)
            blocks.append(self._block(address + start, 4 * words))
        return b"".join(blocks)[:length]

    def _block(self, address: int, length: int) -> bytes:
        status = 0
        for _ in range(TRIES):
            request_id = next(self._request_ids) % 0xFFFF + 1
            try:
                self._port.sendto(
                    encode_read(address, length, request_id), (self.address, GVCP_PORT)
                )
                reply = self._reply(request_id)
            except OSError as error:
                raise DeviceDisconnectedError(self._silent(error.strerror or str(error))) from error
            if reply is None:
                continue
            status = reply.status
            place, data = reply.payload[:4], reply.payload[4:]
            if status == 0 and len(data) == length and place == struct.pack(">I", address):
                return data
            if status == ACCESS_DENIED:
                raise DeviceInUseError(
                    f"the camera at {self.address} denies access to its description; another "
                    "program controls the camera, and allows no other to read it"
                )
            if status != BUSY:
                break
        else:
            if status == 0:
                raise DeviceDisconnectedError(self._silent("read_memory timeout"))
        raise DeviceProtocolError(
            f"the camera at {self.address} does not let its description be read (status "
            f"{status:#06x} at {address:#x}); switch it off and on again"
        )

    def _reply(self, request_id: int) -> Reply | None:
        """The reply to this very request; None if none came in time."""
        ends_s = self._clock() + REPLY_S
        patience_ends_s = self._clock() + PENDING_MOST_S
        while (left_s := ends_s - self._clock()) > 0:
            self._port.settimeout(left_s)
            try:
                datagram, sender = self._port.recvfrom(LARGEST_DATAGRAM)
            except TimeoutError:
                return None
            reply = parse_reply(datagram)
            if sender[0] != self.address or reply is None or reply.request_id != request_id:
                continue
            if reply.code == MEMORY:
                return reply
            if reply.code == PENDING and len(reply.payload) >= 4:
                wait_s = 1e-3 * struct.unpack_from(">H", reply.payload, 2)[0]
                ends_s = min(self._clock() + wait_s, patience_ends_s)
        return None

    def _silent(self, reason: str) -> str:
        return f"the camera does not answer (opening it at {self.address}: {reason})"
