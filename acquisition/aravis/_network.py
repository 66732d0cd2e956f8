"""What is said to a GigE Vision camera without Aravis: the route to it, and its description.

The description of a camera is fetched over GVCP from where the camera says that it lies. Aravis
does the same without a look at what it is given: it takes as much memory as the camera says, opens
any file or network address that the camera names, and unpacks past the end of the archive. Here an
archive is unpacked with a limit; the entry is the one that Aravis takes.

References
----------
AIA, GigE Vision, version 2.0 (2011), sections 16.3 (READMEM), 18 (PENDING_ACK), "First URL
register" and "Second URL register".
PKWARE, .ZIP File Format Specification (APPNOTE.TXT), version 6.3.10, sections 4.3 and 4.4.
"""

import re
import socket
import struct
import time
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from typing import Self

from acquisition.aravis._description import LARGEST_BYTES, DescriptionError, description_error
from acquisition.errors import (
    DeviceDisconnectedError,
    DeviceInUseError,
    DeviceProtocolError,
    NoRouteError,
)
from acquisition.regular_files import read_regular_file

try:
    import fcntl
except ModuleNotFoundError:  # Windows
    fcntl = None  # type: ignore[assignment]


GVCP_PORT = 3956

_SIOCGIFADDR = 0x8915
"""Linux, netdevice(7): first IPv4 address of an interface."""

_IP_MTU = 14
"""Linux, ip(7): largest datagram on the path of a connected socket; not in the socket module."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkRoute:
    """The route to one address; ``interface`` is None where its name is not known."""

    address: str
    own_address: str
    interface: str | None
    mtu_bytes: int


def route_to(ip_address: str) -> NetworkRoute:
    """Ask the kernel for the route to ``ip_address``; nothing is sent."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        try:
            probe.connect((ip_address, GVCP_PORT))
            own_address = str(probe.getsockname()[0])
            mtu_bytes = probe.getsockopt(socket.IPPROTO_IP, _IP_MTU)
        except OSError as error:
            raise NoRouteError(
                f"no network interface leads to {ip_address} ({error.strerror}); give the "
                "network card a static address in the camera's subnet",
                address=ip_address,
            ) from error
    return NetworkRoute(
        address=ip_address,
        own_address=own_address,
        interface=_interface_with(own_address),
        mtu_bytes=mtu_bytes,
    )


def receive_buffer_limit_bytes(
    path: Path = Path("/proc/sys/net/core/rmem_max"),
) -> int | None:
    """Largest receive buffer that a program may request; None where the system does not say."""
    try:
        return int(path.read_text(encoding="ascii"))
    except (OSError, ValueError):
        return None


def _interface_with(own_address: str) -> str | None:
    if fcntl is None:
        return None
    wanted = socket.inet_aton(own_address)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as control:
        for _, name in socket.if_nameindex():
            request = struct.pack("256s", name.encode()[:15])
            try:
                answer = fcntl.ioctl(control.fileno(), _SIOCGIFADDR, request)
            except OSError:  # an interface without an IPv4 address
                continue
            if answer[20:24] == wanted:
                return name
    return None


_KEY, _WANTS_REPLY = 0x42, 0x01
_READ_MEMORY, MEMORY, PENDING = 0x0084, 0x0085, 0x0089
ACCESS_DENIED, BUSY = 0x8006, 0x8007

BLOCK_BYTES = 512
"""As Aravis reads; a datagram holds 536."""

TRIES, REPLY_S = 5, 0.5
"""As Aravis asks: a camera that is gone is known after 2.5 s."""

PENDING_MOST_S = 10.0
"""A camera may ask for more time, but not for ever."""

READ_MOST_S = 60.0
"""A description of 1 MB takes a camera less than a second."""

_LARGEST_DATAGRAM = 1 << 16
_HEADER_BYTES = 8


@dataclass(frozen=True, slots=True, kw_only=True)
class _Reply:
    """An acknowledge as received."""

    status: int
    code: int
    request_id: int
    payload: bytes


def _encode_read(address: int, length: int, request_id: int) -> bytes:
    """Return the datagram that asks for ``length`` bytes, a multiple of 4."""
    return struct.pack(
        ">BBHHHIHH", _KEY, _WANTS_REPLY, _READ_MEMORY, 8, request_id, address, 0, length
    )


def _parse_reply(datagram: bytes) -> _Reply | None:
    """Return the acknowledge in a datagram, or None if it is none."""
    if len(datagram) < _HEADER_BYTES:
        return None
    status, code, length, request_id = struct.unpack_from(">HHHH", datagram)
    payload = datagram[_HEADER_BYTES:]
    if len(payload) < length:
        return None
    return _Reply(status=status, code=code, request_id=request_id, payload=payload[:length])


class _CameraMemory:
    """Reads the memory of the camera at an address; a context manager."""

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

    def __exit__(self, *_: object) -> None:
        self._port.close()

    def read(self, address: int, length: int) -> bytes:
        """Read ``length`` bytes from ``address`` on."""
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
                    _encode_read(address, length, request_id), (self.address, GVCP_PORT)
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

    def _reply(self, request_id: int) -> _Reply | None:
        """The reply to this very request; None if none came in time."""
        ends_s = self._clock() + REPLY_S
        patience_ends_s = self._clock() + PENDING_MOST_S
        while (left_s := ends_s - self._clock()) > 0:
            self._port.settimeout(left_s)
            try:
                datagram, sender = self._port.recvfrom(_LARGEST_DATAGRAM)
            except TimeoutError:
                return None
            reply = _parse_reply(datagram)
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


_END, _ENTRY, _FILE = b"PK\x05\x06", b"PK\x01\x02", b"PK\x03\x04"
_END_BYTES, _ENTRY_BYTES, _FILE_BYTES = 22, 46, 30


def _unpack(data: bytes) -> bytes:
    """Return the last file of an archive."""
    try:
        return _last_file(data)
    except (struct.error, zlib.error) as error:
        raise _damaged() from error


def _last_file(data: bytes) -> bytes:
    end = data.rfind(_END)
    if end < 0:
        raise _damaged()
    files, directory_bytes, directory = struct.unpack_from("<HII", data, end + 10)
    # What lies before the archive shifts all its places.
    shift = end - directory_bytes - directory
    place = directory + shift
    packed_bytes = unpacked_bytes = start = -1
    for _ in range(files):
        if place < 0 or data[place : place + 4] != _ENTRY:
            raise _damaged()
        packed_bytes, unpacked_bytes = struct.unpack_from("<II", data, place + 20)
        lengths = struct.unpack_from("<HHH", data, place + 28)
        (start,) = struct.unpack_from("<I", data, place + 42)
        place += _ENTRY_BYTES + sum(lengths)
    if unpacked_bytes > LARGEST_BYTES:
        raise DescriptionError(
            f"unpacks to {unpacked_bytes} bytes; at most {LARGEST_BYTES} are read",
            fault="too large",
        )
    start += shift
    if files == 0 or start < 0 or data[start : start + 4] != _FILE:
        raise _damaged()
    start += _FILE_BYTES + sum(struct.unpack_from("<HH", data, start + 26))
    packed = data[start : start + packed_bytes]
    if len(packed) < packed_bytes:
        raise _damaged()
    if packed_bytes < unpacked_bytes:  # otherwise it is only stored
        unpacker = zlib.decompressobj(-zlib.MAX_WBITS)
        packed = unpacker.decompress(packed, unpacked_bytes + 1)
    if len(packed) != unpacked_bytes:
        raise _damaged()
    return packed


def _damaged() -> DescriptionError:
    return DescriptionError("is in a damaged zip archive", fault="packed")


_URL_REGISTERS = (0x0200, 0x0400)
_URL_BYTES = 512
_ADDRESSES = 1 << 32

_URL = re.compile(r"^(?:([^:/?#]+):)?(?://[^/?#]*)?([^?#]*)", re.DOTALL)
_PLACE = re.compile(r"\s*(.+);\s*(?:0x)?([0-9a-f]+);\s*(?:0x)?([0-9a-f]+)", re.IGNORECASE)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Place:
    """Where a description lies in the camera's memory, and the name of its file."""

    name: str
    address: int
    length: int


def _parse_url(url: str) -> _Place | Path | None:
    """Return where a URL register says that the description lies; None for the maker's website."""
    parts = _URL.match(url)
    scheme, path = (parts[1] or "", parts[2]) if parts else ("", "")
    if scheme.casefold() == "http":
        return None
    if scheme.casefold() == "file" and path:
        return Path(path)
    found = _PLACE.search(path) if scheme.casefold() == "local" else None
    if found is None:
        raise DescriptionError(
            f"is not in the camera: its register says {url[:80]!r}", fault="nowhere"
        )
    place = _Place(name=found[1], address=int(found[2], 16), length=int(found[3], 16))
    if place.length > LARGEST_BYTES or place.address + place.length > _ADDRESSES:
        raise DescriptionError(
            f"is said to have {place.length} bytes at {place.address:#x}; at most "
            f"{LARGEST_BYTES} are read",
            fault="too large",
        )
    return place


def read_description(address: str, own_address: str) -> bytes:
    """Return the description of the camera at an address, unpacked but not checked."""
    try:
        with _CameraMemory(address, own_address) as memory:
            return _read(memory)
    except DescriptionError as error:
        raise description_error(error, f"the camera at {address}") from error


def _read(memory: _CameraMemory) -> bytes:
    for register in _URL_REGISTERS:
        url = memory.read(register, _URL_BYTES).partition(b"\0")[0].decode("utf-8", "replace")
        place = _parse_url(url)
        if isinstance(place, Path):
            return _in_file(place)
        if place is not None and place.length > 0:
            data = memory.read(place.address, place.length)
            # Aravis itself knows only the small letters.
            return _unpack(data) if place.name.casefold().endswith(".zip") else data
    raise DescriptionError("is missing: neither of its registers names a place", fault="nowhere")


def _in_file(path: Path) -> bytes:
    """A description that the maker installed on this computer."""
    try:
        return read_regular_file(path, LARGEST_BYTES)
    except OSError as error:
        raise DescriptionError(
            f"is said to be the file {str(path)[:80]!r} on this computer ({error.strerror})",
            fault="nowhere",
        ) from error
