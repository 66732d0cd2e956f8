"""Folders of results that are made here and copied to a URL when they are whole."""

from collections.abc import Iterable
from pathlib import Path

from acquisition.files import is_there, write_file
from acquisition.regular_files import LARGEST_IMAGE_BYTES, read_regular_file
from acquisition.remote_files import is_url, remote_status, url_of
from standoff.errors import ApplicationError

_NAMED_BY_CONTENT = frozenset({".png", ".tif"})


def made_in(out: Path) -> Path:
    """Return where a folder of results is made: of a URL, under its last name right here."""
    if not is_url(out):
        return out
    is_there(out)
    return Path(out.name)


def copied(folder: Path, out: Path, files: Iterable[Path], last: Path) -> int:
    """Copy files of a folder to a URL; return how many those were.

    Images that are there with their size are not copied again. ``last`` is copied when all others
    are there.
    """
    count = 0
    for file in (*sorted(files), last):
        target = out / file.relative_to(folder)
        try:
            size_bytes = file.stat().st_size
            if file.suffix in _NAMED_BY_CONTENT and _size_bytes(target) == size_bytes:
                continue
            data = read_regular_file(file, max(size_bytes, LARGEST_IMAGE_BYTES))
        except OSError as error:
            raise ApplicationError(
                f"cannot copy {file} to {url_of(out)}: {error.strerror}"
            ) from error
        write_file(target, data)
        count += 1
    return count


def _size_bytes(path: Path) -> int:
    try:
        return remote_status(path).size_bytes
    except FileNotFoundError:
        return -1
