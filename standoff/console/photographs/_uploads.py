"""Photographs that arrive in parts, over a link that breaks: whole and verified, or not at all."""

import hashlib
import os
import re
import shutil
import time
from dataclasses import dataclass
from pathlib import Path
from threading import Lock

from acquisition.errors import ApplicationError
from acquisition.files import make_folder
from acquisition.session import fsync_directory

MOST_BYTES = 64 * 2**20
PART_BYTES = 2**20
"""Of one request at most: what is sent again after a lost link."""

MOST_WAITING = 16
"""Photographs that are on their way at one time."""

LEAST_FREE_BYTES = 2**30
"""Of the disk: with less no photograph is begun, as its session takes several times its size."""

STALE_S = 7 * 24 * 3600.0
"""A photograph of which nothing came for so long is given up."""

STALE_IN_THE_WAY_S = 3600.0
"""The same where it is in the way of a new one: it is sent from its beginning then."""

_SHA256 = re.compile(r"[0-9a-f]{64}")
_PART = ".part"


class UploadError(ApplicationError):
    """A part does not fit what is known of its photograph."""


class TryAgainError(UploadError):
    """What was sent is not taken now; sent again from where ``begin`` says, it will be."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Received:
    """How much of a photograph is there; ``path`` is its file once it is whole and verified."""

    received: int
    path: Path | None = None


class Uploads:
    """Photographs named by the SHA-256 of their bytes, in one folder, which survives a restart."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._lock = Lock()

    def whole(self) -> list[Path]:
        """Return what has arrived whole and has not been taken yet."""
        if not self._folder.is_dir():
            return []
        return sorted(path for path in self._folder.iterdir() if _SHA256.fullmatch(path.name))

    def begin(self, sha256: str, size: int) -> Received:
        """Say how much of a photograph is there already: where to go on, or that it is whole."""
        if not _SHA256.fullmatch(sha256):
            raise UploadError("a photograph is named by its SHA-256, in hexadecimal digits")
        if not 0 < size <= MOST_BYTES:
            raise UploadError(f"a photograph has at most {MOST_BYTES // 2**20} MB")
        with self._lock:
            whole = self._whole(sha256)
            if whole is not None:
                return whole
            part = self._part(sha256)
            if not part.exists():
                make_folder(self._folder)
                self._give_up_stale(STALE_S)
                if self._is_full():
                    self._give_up_stale(STALE_IN_THE_WAY_S)
                if self._is_full():
                    raise TryAgainError(
                        f"{MOST_WAITING} photographs are on their way; wait until one is done"
                    )
                if shutil.disk_usage(self._folder).free < LEAST_FREE_BYTES:
                    raise TryAgainError("the computer's disk is full; make room there")
                part.touch()
            return Received(received=part.stat().st_size)

    def add(self, sha256: str, offset: int, data: bytes, size: int) -> Received:
        """Add the part that begins at ``offset``; another offset adds nothing.

        ``size``: bytes of the whole photograph. The last part is followed by a check of the whole:
        if its hash is another one, what was received is thrown away. To one that is whole nothing
        is added.
        """
        if not _SHA256.fullmatch(sha256):
            raise UploadError("a photograph is named by its SHA-256, in hexadecimal digits")
        with self._lock:
            whole = self._whole(sha256)
            if whole is not None:
                return whole
            part = self._part(sha256)
            if not part.exists():
                raise TryAgainError("this photograph was not announced, or is stored already")
            received = part.stat().st_size
            if offset != received:
                return Received(received=received)
            if not received + len(data) <= min(size, MOST_BYTES):
                raise UploadError("more was sent than the photograph was said to have")
            with part.open("ab") as written:
                written.write(data)
                written.flush()
                os.fsync(written.fileno())
            received += len(data)
            return self._finished(part, sha256) if received == size else Received(received=received)

    def path_of(self, sha256: str) -> Path:
        """Where a photograph is once it is whole."""
        return self._folder / sha256

    def discard(self, path: Path) -> None:
        """Forget a photograph that is stored elsewhere, or of no use."""
        path.unlink(missing_ok=True)

    def _is_full(self) -> bool:
        return len(list(self._folder.iterdir())) >= MOST_WAITING

    def _give_up_stale(self, after_s: float) -> None:
        for part in self._folder.glob(f"*{_PART}"):
            if time.time() - part.stat().st_mtime > after_s:
                part.unlink()

    def _part(self, sha256: str) -> Path:
        return self._folder / (sha256 + _PART)

    def _whole(self, sha256: str) -> Received | None:
        """A photograph that waits to be taken, of which the answer may have been lost."""
        path = self.path_of(sha256)
        return Received(received=path.stat().st_size, path=path) if path.exists() else None

    def _finished(self, part: Path, sha256: str) -> Received:
        with part.open("rb") as opened:
            found = hashlib.file_digest(opened, "sha256").hexdigest()
        if found != sha256:
            part.unlink()
            raise TryAgainError("the photograph did not arrive as it was sent; send it again")
        whole = self.path_of(sha256)
        size = part.stat().st_size
        part.replace(whole)
        fsync_directory(self._folder)
        return Received(received=size, path=whole)
