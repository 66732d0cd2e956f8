"""Photographs with the same content, of which a dataset takes one.

Only files of the same size are looked into, and only those that agree in a sample are read whole:
of photographs that a camera compressed few share their size.
"""

import hashlib
import json
import os
import stat
from collections.abc import Iterable, Iterator
from itertools import groupby
from pathlib import Path

from acquisition.regular_files import LARGEST_IMAGE_BYTES, read_regular_file
from acquisition.remote_files import is_url
from analysis.sweep import Manifest, SweepItem, sorted_lines

_SAMPLE_BYTES = 4096
"""Read at the start, the middle and the end: a page each."""

_READ_BYTES = 1 << 20


def copies_in(manifest: Manifest, folder: Path) -> Iterator[tuple[Path, Path]]:
    """Yield the photographs that are copies, each with the one that is kept: the first by name.

    Parameters
    ----------
    manifest
        The photographs; those that cannot be read are no copies.
    folder
        For the nameless files of the sorting.
    """
    by_size = sorted_lines(map(_line_by_size, manifest), folder)
    by_sample = sorted_lines(_lines_by_sample(by_size), folder)
    for _, alike in groupby(by_sample, lambda line: line.partition(b" ")[0]):
        kept: dict[bytes, Path] = {}
        for path in _if_several(_path_of(line) for line in alike):
            try:
                content = _digest_of(path)
            except OSError:
                continue
            if content in kept:
                yield path, kept[content]
            else:
                kept[content] = path


def _line_by_size(item: SweepItem) -> bytes:
    return f"{max(item.size_bytes, 0):016x} {json.dumps(os.fspath(item.path))}\n".encode("ascii")


def _lines_by_sample(lines: Iterable[bytes]) -> Iterator[bytes]:
    for size, of_size in groupby(lines, lambda line: line.partition(b" ")[0]):
        if int(size, 16) == 0:
            continue
        for path in _if_several(map(_path_of, of_size)):
            try:
                sample = _sample_of(path, int(size, 16))
            except OSError:
                continue
            name = json.dumps(os.fspath(path)).encode("ascii")
            yield size + sample.hex().encode("ascii") + b" " + name + b"\n"


def _if_several(paths: Iterable[Path]) -> Iterator[Path]:
    """Yield the paths, but nothing of one alone."""
    each = iter(paths)
    first = next(each, None)
    second = next(each, None)
    if first is not None and second is not None:
        yield first
        yield second
        yield from each


def _path_of(line: bytes) -> Path:
    return Path(json.loads(line.partition(b" ")[2]))


def _sample_of(path: Path, size_bytes: int) -> bytes:
    if is_url(path):
        return _digest_of(path)
    # Opening a device may set it going, and opening a pipe waits for its writer.
    if not stat.S_ISREG(path.stat().st_mode):
        raise OSError(f"{path} is no file")
    digest = hashlib.sha256()
    with path.open("rb") as file:
        for offset in (0, size_bytes // 2, max(size_bytes - _SAMPLE_BYTES, 0)):
            file.seek(offset)
            digest.update(file.read(_SAMPLE_BYTES))
    return digest.digest()


def _digest_of(path: Path) -> bytes:
    if is_url(path):
        return hashlib.sha256(read_regular_file(path, LARGEST_IMAGE_BYTES)).digest()
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").digest()
