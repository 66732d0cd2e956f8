"""A folder as a ZIP file that is made while it is sent: nothing is stored beside it."""

import io
from collections.abc import Iterator
from pathlib import Path
from zipfile import ZIP_STORED, ZipFile, ZipInfo

_PART_BYTES = 1 << 20


class _Sent(io.RawIOBase):
    """Takes what is written, until it is fetched."""

    def __init__(self) -> None:
        self._waiting = bytearray()

    def writable(self) -> bool:
        return True

    def write(self, data: object, /) -> int:
        part = bytes(memoryview(data))  # type: ignore[arg-type]  # zipfile writes bytes alone
        self._waiting += part
        return len(part)

    def taken(self) -> bytes:
        """What has been written since."""
        part = bytes(self._waiting)
        self._waiting.clear()
        return part


def zipped(folder: Path) -> Iterator[bytes]:
    """Return the parts of a ZIP file of a folder; links in it are left out."""
    sent = _Sent()
    with ZipFile(sent, "w", ZIP_STORED) as archive:
        for path in sorted(folder.rglob("*")):
            if path.is_symlink() or not path.is_file():
                continue
            entry = ZipInfo(f"{folder.name}/{path.relative_to(folder).as_posix()}")
            with path.open("rb") as source, archive.open(entry, "w", force_zip64=True) as target:
                while part := source.read(_PART_BYTES):
                    target.write(part)
                    yield sent.taken()
    yield sent.taken()
