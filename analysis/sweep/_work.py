"""What is asked of photographs, and the records that a worker appends to a segment of its own.

A segment's records are a line with their SHA-256 and sizes, a line of JSON, a line for each
photograph, and bytes. What is torn is no record, nor is what follows it.
"""

import hashlib
import json
import os
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO, ClassVar
from uuid import uuid4

from acquisition.printable import on_one_line
from acquisition.session import fsync_directory
from analysis.errors import RefusedPhotographError, ResultsFileError
from analysis.sweep._items import SweepItem

Row = dict[str, Any]

SUFFIX = ".records"
SEGMENT_BYTES = 1 << 25
"""A longer segment is not appended to."""

_FORMAT = b"record/1"
_PAIR_BYTES = 16


@dataclass(frozen=True, slots=True, kw_only=True)
class Stored:
    """Bytes of a record, and where they are."""

    path: Path
    at: int
    size: int

    def read(self) -> bytes:
        """Return the bytes; a `ResultsFileError` says that they are gone."""
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
        What the work's ``mark_of`` says of files that were written, by their paths below ``root``.
    data
        Bytes.
    is_final
        Whether no later run is to do it again; if not, that run gets the bytes to go on from.
    """

    items: Sequence[SweepItem]
    rows: Sequence[Row]
    refused: str | None = None
    notes: Mapping[str, str] = field(default_factory=dict)
    files: Mapping[str, int | str] = field(default_factory=dict)
    data: bytes = b""
    is_final: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Written:
    """Where a record is: the name of its segment, and its first byte."""

    segment: str
    at: int


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordText:
    """A record as it is stored, but for its bytes.

    ``pairs`` are the hash and the digest of each photograph, big endian; ``head`` is all but these
    and the rows.
    """

    pairs: bytes
    head: Mapping[str, Any]
    rows: Sequence[bytes]

    @property
    def lines(self) -> bytes:
        """The text: the head, and a row a line."""
        # Names of files may hold what UTF-8 does not.
        head = json.dumps({"photographs": self.pairs.hex(), **self.head}).encode("ascii")
        return b"".join(line + b"\n" for line in (head, *self.rows))


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


Commit = Callable[[Sequence[Record]], None]


class SweepWork(ABC):
    """Answers a question about photographs, in any process: it is pickled.

    The same photograph must give the same bits wherever and whenever it is done.

    A folder of pairs is swept by one photograph of each, such as the follow-up: the work finds the
    other by its name, and says of what size and time that is if it may change.
    """

    is_merged: ClassVar[bool] = False
    """Whether records of several photographs have their bytes merged."""

    commits_each: ClassVar[bool] = False
    """Whether each photograph is committed on its own, as it takes long; else each batch."""

    @property
    @abstractmethod
    def key(self) -> str:
        """Settings as text: what was done with others is not found."""

    @property
    @abstractmethod
    def state(self) -> Path:
        """Absolute path of the folder of the records, which exists and every worker sees."""

    @property
    def root(self) -> Path:
        """Folder that the files of records lie in."""
        return self.state

    def state_of(self, item: SweepItem) -> str:
        """Say on what else the answer for a photograph depends, as ASCII text."""
        return ""

    def mark_of(self, path: Path) -> int | str:
        """Return by what a file of a record is known again: its size, unless a work says more."""
        return path.stat().st_size

    def answer(self, item: SweepItem, batch: Batch, commit: Commit) -> Record:
        """Answer for one photograph; ``commit`` takes what must not be lost meanwhile.

        A RefusedPhotographError or ValueError refuses it. A work that does whole batches has none.
        """
        raise NotImplementedError

    def merged(self, parts: Sequence[Stored]) -> bytes:
        """Return the bytes of several records together."""
        raise NotImplementedError

    def do(self, batch: Batch, commit: Commit) -> None:
        """Answer for the photographs of a batch, and commit what they gave."""
        records = []
        for item in batch.items:
            if batch.overwritten and item.hash in batch.overwritten:
                # A kill among the files must not leave the earlier answer.
                commit([Record(items=(item,), rows=({},), is_final=False)])
            records.append(self.answer_or_refusal(item, batch, commit))
            if self.commits_each:
                commit(records)
                records = []
        if records:
            commit(records)

    def answer_or_refusal(self, item: SweepItem, batch: Batch, commit: Commit) -> Record:
        """Answer for one photograph, or say why it gives nothing."""
        try:
            return self.answer(item, batch, commit)
        except (RefusedPhotographError, ValueError) as error:
            return refusal(item, error)


def refusal(item: SweepItem, error: Exception) -> Record:
    """Return the record of a photograph that gave nothing.

    One that could not be read, though it is there, is tried again by a later run.
    """
    is_unread = isinstance(error, RefusedPhotographError) and error.is_unread
    name, text = on_one_line(item.path), on_one_line(error)
    line = text if name in text else f"{name}: {text}"
    return Record(
        items=(item,), rows=({},), refused=line, is_final=not (is_unread and item.is_there)
    )


def do_batch(work: SweepWork, batch: Batch) -> list[Written]:
    """Do a batch in this process; return where its records are."""
    written: list[Written] = []
    writer = writer_for(work.state, batch.run)
    work.do(batch, lambda records: written.extend(writer.append(batch.digests, records)))
    return written


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
        """Make records durable; the disk is waited for once. ``digests`` are as of a `Batch`."""
        return self.append_texts(
            [(_text_of(record, digests).lines, record.data) for record in records]
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
            at = file.tell()
            for text, data in texts:
                written.append(Written(segment=name, at=at))
                head = b"%s %s %d %d\n" % (_FORMAT, _digest(text, data), len(text), len(data))
                at += file.write(head) + file.write(text) + file.write(data)
            file.flush()
            os.fsync(file.fileno())
        if is_new:
            fsync_directory(self._folder)
        if at < SEGMENT_BYTES:
            self._name = name
        return written


def writer_for(folder: Path, run: str) -> Writer:
    """Return this thread's writer for a run."""
    return _writer(folder, run, os.getpid(), threading.get_ident())


@lru_cache(maxsize=16)
def _writer(folder: Path, run: str, process: int, thread: int) -> Writer:
    return Writer(folder)


def read_record(file: BinaryIO) -> tuple[RecordText, bytes] | None:
    """Read a record, and its bytes; None if it is torn."""
    try:
        kind, digest, *sizes = file.readline(200).split()
        text_size, data_size = map(int, sizes)
        if not 0 <= text_size + data_size <= os.fstat(file.fileno()).st_size:
            return None
        text, data = file.read(text_size), file.read(data_size)
        if kind != _FORMAT or _digest(text, data) != digest:
            return None
        line, *rows = text.split(b"\n")[:-1]
        head = json.loads(line)
        pairs = bytes.fromhex(head.pop("photographs"))
        if len(pairs) != _PAIR_BYTES * len(rows):
            return None
    except (ValueError, LookupError, TypeError, AttributeError, RecursionError):
        return None
    return RecordText(pairs=pairs, head=head, rows=rows), data


def vanished(path: Path) -> ResultsFileError:
    """Return the error of records that were there before."""
    return ResultsFileError(f"{path} vanished or was damaged; run the same command again")


def _text_of(record: Record, digests: Mapping[int, int]) -> RecordText:
    hashes = [item.hash for item in record.items]
    head: dict[str, Any] = {}
    if record.refused is not None:
        head["refused"] = record.refused
    if record.notes:
        head["notes"] = dict(record.notes)
    if record.files:
        head["files"] = dict(record.files)
    if not record.is_final:
        head["is_begun"] = True
    return RecordText(
        pairs=b"".join(b"%b%b" % (_eight(one), _eight(digests[one])) for one in hashes),
        head=head,
        rows=[json.dumps(row).encode("ascii") for row in record.rows],
    )


def _eight(number: int) -> bytes:
    return number.to_bytes(_PAIR_BYTES // 2, "big")


def _digest(text: bytes, data: bytes) -> bytes:
    digest = hashlib.sha256(text)
    digest.update(data)
    return digest.hexdigest().encode("ascii")
