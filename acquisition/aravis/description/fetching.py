"""The description of a GigE Vision camera, from where the camera says that it lies.

Aravis does the same without a look at what it is given: it takes as much memory as the camera says,
opens any file or network address that the camera names, and unpacks past the end of the archive.

References
----------
AIA, GigE Vision, version 2.0 (2011), sections "First URL register" and "Second URL register".
"""

import re
from dataclasses import dataclass
from pathlib import Path

from acquisition.aravis.description.camera_memory import CameraMemory
from acquisition.aravis.description.checking import description_error
from acquisition.aravis.description.nodes import LARGEST_BYTES, DescriptionError
from acquisition.aravis.description.unpacking import unpack
from acquisition.regular_files import read_regular_file

URL_REGISTERS = (0x0200, 0x0400)
URL_BYTES = 512
ADDRESSES = 1 << 32

_URL = re.compile(r"^(?:([^:/?#]+):)?(?://[^/?#]*)?([^?#]*)", re.DOTALL)
_PLACE = re.compile(r"\s*(.+);\s*(?:0x)?([0-9a-f]+);\s*(?:0x)?([0-9a-f]+)", re.IGNORECASE)


@dataclass(frozen=True, slots=True, kw_only=True)
class Place:
    """Where a description lies in the camera's memory, and the name of its file."""

    name: str
    address: int
    length: int


def parse_url(url: str) -> Place | Path | None:
    """Return where a URL register says that the description lies; None for the maker's website.

    Aravis goes on to the second register then.

    Raises
    ------
    DescriptionError
        If it says nothing that can be followed.
    """
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
    place = Place(name=found[1], address=int(found[2], 16), length=int(found[3], 16))
    if place.length > LARGEST_BYTES or place.address + place.length > ADDRESSES:
        raise DescriptionError(
            f"is said to have {place.length} bytes at {place.address:#x}; at most "
            f"{LARGEST_BYTES} are read",
            fault="too large",
        )
    return place


def read_description(address: str, own_address: str) -> bytes:
    """Return the description of the camera at an address, unpacked but not checked.

    Parameters
    ----------
    own_address
        Of the interface that leads to the camera.

    Raises
    ------
    CameraDescriptionError
        If the camera does not say where it is, or its archive is damaged.
    DeviceError
        As for `CameraMemory.read`.
    """
    try:
        with CameraMemory(address, own_address) as memory:
            return _read(memory)
    except DescriptionError as error:
        raise description_error(error, f"the camera at {address}") from error


def _read(memory: CameraMemory) -> bytes:
    for register in URL_REGISTERS:
        url = memory.read(register, URL_BYTES).partition(b"\0")[0].decode("utf-8", "replace")
        place = parse_url(url)
        if isinstance(place, Path):
            return _in_file(place)
        if place is not None and place.length > 0:
            data = memory.read(place.address, place.length)
            # Aravis itself knows only the small letters.
            return unpack(data) if place.name.casefold().endswith(".zip") else data
    raise DescriptionError("is nowhere: neither of its registers names a place", fault="nowhere")


def _in_file(path: Path) -> bytes:
    """A description that the maker installed on this computer."""
    try:
        return read_regular_file(path, LARGEST_BYTES)
    except OSError as error:
        raise DescriptionError(
            f"is said to be the file {str(path)[:80]!r} on this computer ({error.strerror})",
            fault="nowhere",
        ) from error
