"""Segments of records, each appended to by one writer: what a commit holds and how it is stored."""

import hashlib
import json
import os
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO, Self
from uuid import uuid4

from acquisition.session import fsync_directory
from analysis.errors import ResultsFileError
from analysis.sweep.items import SweepItem

Row = dict[str, Any]

SUFFIX = ".records"
_FORMAT = b"record/1"
SEGMENT_BYTES = 1 << 25
"""A longer segment is not appended to."""

_OPEN_FILES = 64


@dataclass(frozen=True, slots=True, kw_only=True)
class Stored:
    """Bytes of a record, and where they are."""

    path: Path
    at: int
    size: int

    def read(self) -> bytes:
        """Return the bytes.

        Raises
        ------
        ResultsFileError
            If they are gone.
        """
        try:
            with self.path.open("rb") as file:
                file.seek(self.at)
                data = file.read(self.size)
        except OSError:
            data = b""
        if len(data) < self.size:
            raise vanished(self.path)
        return data


@dataclass(frozen=True, slots=True, kw_only=True)
class Record:
    """What is committed of photographs.

    Parameters
    ----------
    items, rows
        The photographs, and what they gave: a JSON object each.
    refused
        The line that says why the photograph gave nothing.
    notes
        What is worth saying once in a sweep, by kind.
    files
        Sizes of the files that were written, by their paths below the work's ``root``.
    data
        Bytes.
    is_final
        Whether no later run is to do it again; if not, that run gets the bytes to go on from.
    """

    items: Sequence[SweepItem]
    rows: Sequence[Row]
    refused: str | None = None
    notes: Mapping[str, str] = field(default_factory=dict)
    files: Mapping[str, int] = field(default_factory=dict)
    data: bytes = b""
    is_final: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Written:
    """Where a record is: the name of its segment, its first byte, and how many it has."""

    segment: str
    at: int
    size: int


@dataclass(frozen=True, slots=True, kw_only=True)
class Batch:
    """Photographs that one worker does.

    Parameters
    ----------
    number
        Leading bits of the hashes of their paths: the same, whatever else is in the sweep.
    run
        The run of the client.
    items
        Those that are left to do, in the order of the hashes.
    digests
        Of what each answer depends on, by the hashes.
    begun
        Bytes of answers that are not final, by the hashes.
    overwritten
        Hashes of those whose files of another answer will be written over.
    """

    number: int
    run: str
    items: tuple[SweepItem, ...]
    digests: Mapping[int, int]
    begun: Mapping[int, Stored] = field(default_factory=dict)
    overwritten: frozenset[int] = frozenset()

    def earlier(self, item: SweepItem) -> bytes | None:
        """Return the bytes that an earlier run left of a photograph."""
        stored = self.begun.get(item.hash)
        return None if stored is None else stored.read()


class Writer:
    """Appends records to a segment of its own.

    After anything went wrong in the middle of a record, or when it is long, another is begun: what
    follows a torn record is not read.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._id = uuid4().hex[:12]
        self._name = ""

    def append(self, digests: Mapping[int, int], records: Sequence[Record]) -> list[Written]:
        """Make records durable; the disk is waited for once. ``digests`` are as of a `Batch`.

        Raises
        ------
        OSError
            If they cannot be written.
        """
        texts = [_text_of(record, digests) for record in records]
        return self.append_texts(
            [(text, record.data) for text, record in zip(texts, records, strict=True)]
        )

    def append_texts(self, texts: Iterable[tuple[bytes, bytes]]) -> list[Written]:
        """Make records durable, each given as its lines and its bytes."""
        name, self._name = self._name, ""  # until all is well
        is_new = not name
        if is_new:
            # Those of later runs come later: their word on a file counts.
            name = f"{time.time_ns():020d}-{self._id}{SUFFIX}"
        written = []
        with (self._folder / name).open("ab") as file:
            for text, data in texts:
                at = file.tell()
                digest = hashlib.sha256(text + data).hexdigest().encode("ascii")
                file.write(b"%s %s %d %d\n" % (_FORMAT, digest, len(text), len(data)))
                file.write(text)
                file.write(data)
                written.append(Written(segment=name, at=at, size=file.tell() - at))
            file.flush()
            os.fsync(file.fileno())
            is_full = file.tell() >= SEGMENT_BYTES
        if is_new:
            fsync_directory(self._folder)
        if not is_full:
            self._name = name
        return written


def writer_for(folder: Path, run: str) -> Writer:
    """Return this thread's writer for a run."""
    return _writer(folder, run, os.getpid(), threading.get_ident())


@lru_cache(maxsize=16)
def _writer(folder: Path, run: str, process: int, thread: int) -> Writer:
    return Writer(folder)


class Segments:
    """Segments of a folder that are open to be read, a few at a time."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files: dict[str, BinaryIO] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        while self._files:
            self._files.popitem()[1].close()

    def read(self, segment: str, at: int, size: int) -> bytes:
        """Read some bytes of a segment."""
        if segment not in self._files:
            if len(self._files) == _OPEN_FILES:
                self._files.pop(next(iter(self._files))).close()
            try:
                self._files[segment] = (self._folder / segment).open("rb")
            except OSError as error:
                raise vanished(self._folder / segment) from error
        file = self._files[segment]
        file.seek(at)
        data = file.read(size)
        if len(data) < size:
            raise vanished(self._folder / segment)
        return data


def vanished(path: Path) -> ResultsFileError:
    """Return the error of records that were there before."""
    return ResultsFileError(f"{path} vanished or was damaged; run the same command again")


def _text_of(record: Record, digests: Mapping[int, int]) -> bytes:
    head = {
        "refused": record.refused,
        "notes": dict(record.notes),
        "files": dict(record.files),
        "is_final": record.is_final,
    }
    lines = (
        json_line([item.hash, digests[item.hash], row])
        for item, row in zip(record.items, record.rows, strict=True)
    )
    return json_line(head) + b"".join(lines)


def read_record(file: BinaryIO) -> tuple[bytes, int] | None:
    """Read a record's lines, and the size of its bytes, which are read as well; None if torn."""
    try:
        kind, digest, *sizes = file.readline(200).split()
        text_size, data_size = map(int, sizes)
        if not 0 <= text_size + data_size <= os.fstat(file.fileno()).st_size:
            return None
        text, data = file.read(text_size), file.read(data_size)
    except ValueError:
        return None
    if kind != _FORMAT or hashlib.sha256(text + data).hexdigest().encode("ascii") != digest:
        return None
    return text, data_size


def json_line(value: object) -> bytes:
    """Return a value as a line of JSON."""
    # Names of files may hold what UTF-8 does not.
    return json.dumps(value).encode("ascii") + b"\n"
