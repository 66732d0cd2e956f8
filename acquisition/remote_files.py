"""Files by URL, such as ``s3://bucket/photographs``: what fsspec opens, as paths.

A path stands for a URL as pathlib spells it, with one slash: ``Path("s3://bucket/a.png")`` is
``s3:/bucket/a.png``. Its name, suffix and parent are those of the file.
"""

import errno
import hashlib
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from os import fspath
from pathlib import Path, PurePath
from typing import Any
from uuid import uuid4

_URL = re.compile(r"([a-z][a-z0-9+.-]+):/(?!/)")
_EXTRAS = {"s3": "s3", "s3a": "s3", "gs": "gs", "gcs": "gs"}
_OBJECT_STORES = frozenset({"s3", "s3a", "gs", "gcs", "memory"})
"""A file of theirs is there whole or not at all, and cannot be renamed for nothing."""

_VERSION_KEYS = ("ETag", "etag", "LastModified", "mtime", "updated", "last_modified", "created")


@dataclass(frozen=True, slots=True, kw_only=True)
class _RemoteStatus:
    """What is known of a file before it is read; its version is 0 where the server tells none."""

    size_bytes: int
    version: int
    is_folder: bool


def is_url(path: PurePath) -> bool:
    """Whether a path stands for a URL."""
    # Most are local, and absolute.
    return ":" in (text := fspath(path)) and _URL.match(text) is not None


def is_own_memory(path: PurePath) -> bool:
    """Whether other processes do not see it."""
    return is_url(path) and fspath(path).startswith("memory:")


def url_of(path: PurePath) -> str:
    """Return the URL that a path stands for, or the path as it is."""
    text = fspath(path)
    return _URL.sub(r"\1://", text, count=1) if is_url(path) else text


def remote_status(path: Path) -> _RemoteStatus:
    """Look at a file."""
    with _opened(path) as (system, name):
        info = system.info(name)
    return _RemoteStatus(
        size_bytes=int(info.get("size") or 0),
        version=_version(info),
        is_folder=info["type"] == "directory",
    )


def remote_files_in(folder: Path) -> Iterator[Path]:
    """Yield the files of a folder, not those of folders in it."""
    with _opened(folder) as (system, name):
        for one in system.ls(name, detail=True):
            if one["type"] == "file":
                yield Path(system.unstrip_protocol(one["name"]))


def read_remote(path: Path, most_bytes: int) -> bytes:
    """Read a file of at most ``most_bytes``."""
    with _opened(path) as (system, name), system.open(name, "rb") as file:
        data: bytes = file.read(most_bytes + 1)
    if len(data) > most_bytes:
        raise OSError(errno.EFBIG, f"a file of more than {most_bytes} bytes", url_of(path))
    return data


def write_remote(path: Path, data: bytes) -> None:
    """Write a file, whole or not at all."""
    with _opened(path) as (system, name):
        if _protocol(path) in _OBJECT_STORES:
            system.pipe_file(name, data)
            return
        part = f"{name}.{uuid4().hex}.part"
        system.makedirs(system._parent(name), exist_ok=True)
        system.pipe_file(part, data)
        system.mv(part, name)


def _protocol(path: PurePath) -> str:
    return fspath(path).partition(":")[0]


@contextmanager
def _opened(path: Path) -> Iterator[tuple[Any, str]]:
    """Give a block the file system of a URL and the name there; what fails is an `OSError`."""
    import fsspec  # for whoever names a URL

    url, protocol = url_of(path), _protocol(path)
    try:
        yield fsspec.core.url_to_fs(url)
    except ImportError as error:
        package = f"what it needs ({' '.join(str(error).split())})"  # in fsspec's words
        if protocol in _EXTRAS:
            package = f"'standoff[{_EXTRAS[protocol]}]'"
        text = f"{protocol}:// is not installed: pip install {package}"
        raise OSError(errno.ENOSYS, text, url) from error
    except FileNotFoundError as error:
        raise FileNotFoundError(errno.ENOENT, "there is no such file", url) from error
    except Exception as error:  # backends raise what their libraries do
        if protocol not in fsspec.available_protocols():
            text = f"unknown kind of URL, {protocol}://; known are s3://, gs://, https:// and more"
        else:
            said = getattr(error, "strerror", None) or str(error) or type(error).__name__
            text = " ".join(said.split())
        raise OSError(errno.EIO, text, url) from error


def _version(info: dict[str, Any]) -> int:
    found = next((info[key] for key in _VERSION_KEYS if info.get(key)), 0)
    if isinstance(found, datetime):
        found = found.timestamp()
    if isinstance(found, int | float):
        return int(found * 1e9)
    return int.from_bytes(hashlib.sha256(str(found).encode()).digest()[:7], "big")
