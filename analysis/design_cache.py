"""Designed kernels on disk: those of a PSF and zoom take up to 6 s, reading them 1 ms.

A folder holds one file a design, named by a digest of all that decides its numbers: PSF, zoom and
window, the code, the libraries and the processor. It is a cache: a file that is damaged or not
ours is designed anew and replaced, the least recently used ones go when it is full, and without a
folder to write to everything works as before. ``rm -r`` empties it at any time.
"""

import hashlib
import logging
import os
import platform
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from io import BytesIO
from pathlib import Path

import numpy as np

import simulation
from acquisition.regular_files import read_regular_file
from acquisition.session import PART_SUFFIX, whole_file
from simulation.kept_kernels import Arrays, Design, keep_kernels

FOLDER_VARIABLE = "STANDOFF_DESIGN_CACHE"
LIMIT_VARIABLE = "STANDOFF_DESIGN_CACHE_MB"

DEFAULT_LIMIT_MB = 256.0
"""A design takes 2 kB to 2 MB."""

_SUFFIX = ".kernels"
_KEY_DIGITS = 40
_ROOMS = ("psf", "resampling", "zoom_kernels")
"""Where the code is that decides a design's numbers."""

_BYTES_PER_MB = 1_000_000


def user_cache_folder() -> Path:
    """Return the user's folder for our caches, by the XDG base directory specification."""
    # It says to ignore relative paths.
    caches = Path(os.environ.get("XDG_CACHE_HOME", ""))
    if not caches.is_absolute():
        caches = Path.home() / ".cache"
    return caches / "standoff"


class DesignCache:
    """Keeps designs in a folder, which is created when the first is stored.

    Parameters
    ----------
    folder
        Several processes may use it at once.
    most_bytes
        Largest sum of the files' sizes.
    tell
        Takes a remark, once, if the folder cannot be written.
    """

    def __init__(self, folder: Path, most_bytes: float, tell: Callable[[str], None]) -> None:
        self.folder = folder
        self._most_bytes = most_bytes
        self._tell = tell
        self._is_writable = True

    def __call__(self, name: str, design: Design) -> Arrays:
        """Return what is kept by a name; else what the design returns, and keep that."""
        digest = hashlib.sha256(f"{_made_by()}\n{name}".encode())
        path = self.folder / f"{digest.hexdigest()[:_KEY_DIGITS]}{_SUFFIX}"
        arrays = _read(path, digest.digest())
        if arrays is None:
            arrays = design()
            self._store(path, _written(arrays, digest.digest()))
        return arrays

    def _store(self, path: Path, data: bytes) -> None:
        if not self._is_writable or len(data) > self._most_bytes:
            return
        try:
            self.folder.mkdir(parents=True, exist_ok=True)
            with whole_file(path) as file:  # what a power cut cuts short is designed anew
                file.write(data)
            self._drop_least_used()
        except FileNotFoundError:
            return  # somebody empties the folder at this moment
        except OSError as error:
            self._is_writable = False
            self._tell(
                f"designed kernels are not kept: cannot write {self.folder} "
                f"({error.strerror or error}); name another folder in {FOLDER_VARIABLE}"
            )

    def _drop_least_used(self) -> None:
        """Drop files from the one on that was last used longest ago, until the rest fits."""
        held: list[tuple[float, int, Path]] = []
        for path in self.folder.iterdir():
            # Parts are those of runs that were killed, or of another process at this moment.
            if path.suffix in (_SUFFIX, PART_SUFFIX):
                with suppress(FileNotFoundError):
                    status = path.stat()
                    held.append((status.st_mtime, status.st_size, path))
        total = sum(size for _, size, _ in held)
        for _, size, path in sorted(held):
            if total <= self._most_bytes:
                break
            path.unlink(missing_ok=True)
            total -= size


@cache
def keep_designs_on_disk() -> None:
    """Keep this process's kernels in the user's cache folder, or as the environment says; once."""
    log = logging.getLogger("standoff")
    limit_mb = _limit_mb(log.warning)
    if limit_mb == 0:
        return
    try:
        folder = Path(os.environ.get(FOLDER_VARIABLE) or user_cache_folder() / "designs")
    except RuntimeError as error:  # a user without a home
        log.warning(f"designed kernels are not kept: {error}; name a folder in {FOLDER_VARIABLE}")
        return
    keep_kernels(DesignCache(folder, limit_mb * _BYTES_PER_MB, log.warning))


def _limit_mb(tell: Callable[[str], None]) -> float:
    text = os.environ.get(LIMIT_VARIABLE) or str(DEFAULT_LIMIT_MB)
    with suppress(ValueError):
        if (limit := float(text)) >= 0:
            return limit
    tell(
        f"{LIMIT_VARIABLE} must be a number of megabytes, 0 to keep none, not {text!r}: "
        f"{DEFAULT_LIMIT_MB:g} is taken"
    )
    return DEFAULT_LIMIT_MB


def _written(arrays: Arrays, key: bytes) -> bytes:
    buffer = BytesIO()
    np.savez(buffer, *arrays)
    content = buffer.getvalue()
    return hashlib.sha256(key + content).digest() + content


def _read(path: Path, key: bytes) -> Arrays | None:
    """Arrays of a file, which is marked as used; None if it is not there, not whole or not ours."""
    try:
        data = read_regular_file(path)
    except OSError:
        return None
    check, content = data[:32], data[32:]
    if hashlib.sha256(key + content).digest() != check:
        return None
    with suppress(OSError):  # a folder of somebody else's
        os.utime(path)
    with np.load(BytesIO(content), allow_pickle=False) as held:
        return tuple(held[f"arr_{number}"] for number in range(len(held.files)))


@cache
def _made_by() -> str:
    """Digest of the code, the libraries and the processor: they decide a design's last bits."""
    import scipy  # here, so that commands that design nothing start without it

    digest = hashlib.sha256()
    for room in _ROOMS:
        for path in sorted(Path(simulation.__file__).parent.joinpath(room).glob("*.py")):
            digest.update(path.read_bytes())
    threads = os.environ.get("OPENBLAS_NUM_THREADS", os.cpu_count())
    facts = (np.__version__, scipy.__version__, platform.machine(), _processor(), threads)
    digest.update(repr(facts).encode())
    return digest.hexdigest()


def _processor() -> str:
    """Name of the processor, by which libraries choose their code."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(errors="replace").splitlines():
            if line.startswith("model name"):
                return line
    return platform.processor()
