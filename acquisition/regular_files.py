"""Files read whole: what is none, or too large to be one, is refused before it is opened."""

import errno
import stat
from pathlib import Path

from acquisition.remote_files import is_url, read_remote

LARGEST_DOCUMENT_BYTES = 64 << 20
"""Of JSON and TOML; the psf.json of 20,000 edges takes half."""

LARGEST_JOURNAL_BYTES = 512 << 20
"""A capture takes about 1 kB."""

LARGEST_IMAGE_BYTES = 640 << 20

_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISFIFO, "a pipe"),
    (stat.S_ISSOCK, "a socket"),
)


def read_regular_file(path: Path, most_bytes: int = LARGEST_DOCUMENT_BYTES) -> bytes:
    """Read a regular file, or that of a URL, of at most ``most_bytes``; no device and no pipe."""
    if is_url(path):
        return read_remote(path, most_bytes)
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        kind = next((name for is_kind, name in _KINDS if is_kind(status.st_mode)), "something else")
        raise OSError(errno.EINVAL, f"{kind}, not a file; save it to one first", str(path))
    if status.st_size <= most_bytes:
        with path.open("rb") as file:
            data = file.read(most_bytes + 1)
        if len(data) <= most_bytes:
            return data
    raise OSError(
        errno.EFBIG,
        f"a file of {size_text(status.st_size)}; at most {size_text(most_bytes)} are read",
        str(path),
    )


def size_text(count: int) -> str:
    """A number of bytes in MiB or GiB."""
    if count >= 1 << 30:
        return f"{count / (1 << 30):.3g} GiB"
    return f"{count / (1 << 20):.3g} MiB"
