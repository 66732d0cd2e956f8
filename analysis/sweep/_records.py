"""The records of a folder, found again: what was done to the photographs of a sweep, once each.

A commit appends records to the writer's own segment and makes them durable; what is torn is no
record, and nobody locks anything. A record is of one photograph, or of several whose bytes were
merged. All segments of a folder together are what is known; arrays in memory find it again.
"""

import hashlib
import json
import os
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import groupby, islice, pairwise
from pathlib import Path
from typing import BinaryIO, Self
from uuid import uuid4

import numpy as np
from numpy.typing import NDArray

from analysis.sweep._items import (
    Manifest,
    SweepItem,
    batch_number,
    first_bits,
    group_of,
    is_few,
    places_in,
    sorted_lines,
)
from analysis.sweep._work import (
    SEGMENT_BYTES,
    SUFFIX,
    Batch,
    Record,
    RecordText,
    Row,
    Stored,
    SweepWork,
    Writer,
    Written,
    read_record,
    vanished,
    writer_for,
)

Numbers = NDArray[np.int64]

_MERGED_MOST = 1024
"""Photographs of merged bytes, which one changed photograph makes useless."""

_MOVED_AT_ONCE = 16
"""Records with their bytes in memory."""

_OPEN_FILES = 64

_BEGUN, _REFUSED, _NOTES, _FILES = 1, 2, 4, 8
_FLAGS = {"is_begun": _BEGUN, "refused": _REFUSED, "notes": _NOTES, "files": _FILES}


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What a photograph gave: its row, why it gave nothing, and where the record's bytes are."""

    item: SweepItem
    row: Row
    refused: str | None
    data: Stored


class _Table:
    """Where records and their rows are, column by column: 60 bytes for a record of one row."""

    def __init__(self) -> None:
        # Of records: segment, first byte, size, size of the bytes at the end, first row, flags.
        self.segment, self.flags = array("i"), array("B")
        self.at, self.size, self.data_size = array("q"), array("q"), array("q")
        self.first_row = array("q")
        # Of rows: record, first byte in the segment, size.
        self.record, self.row_size, self.row_at = array("i"), array("i"), array("q")

    def add(self, segment: int, at: int, end: int, found: tuple[RecordText, bytes]) -> int:
        """Add a record; return its number."""
        text, data = found
        number = len(self.segment)
        self.segment.append(segment)
        self.flags.append(sum(flag for name, flag in _FLAGS.items() if text.head.get(name)))
        self.at.append(at)
        self.size.append(end - at)
        self.data_size.append(len(data))
        self.first_row.append(len(self.record))
        row_at = end - len(data) - sum(map(len, text.rows)) - len(text.rows)
        for row in text.rows:
            self.record.append(number)
            self.row_at.append(row_at)
            self.row_size.append(len(row))
            row_at += len(row) + 1
        return number

    def rows_of(self, record: int) -> range:
        """Numbers of the rows of a record."""
        last = len(self.segment) - 1
        end = len(self.record) if record == last else self.first_row[record + 1]
        return range(self.first_row[record], end)


class _Segments:
    """Segments of a folder that are open to be read, a few at a time."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._files: dict[str, BinaryIO] = {}

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        while self._files:
            self._files.popitem()[1].close()

    def file(self, segment: str) -> BinaryIO:
        """Return an open segment."""
        if segment not in self._files:
            if len(self._files) == _OPEN_FILES:
                self._files.pop(next(iter(self._files))).close()
            try:
                self._files[segment] = (self._folder / segment).open("rb")
            except OSError as error:
                raise vanished(self._folder / segment) from error
        return self._files[segment]

    def line(self, segment: str, at: int, size: int) -> Row:
        """Read a line of JSON."""
        file = self.file(segment)
        file.seek(at)
        try:
            row: Row = json.loads(file.read(size))
        except ValueError as error:
            raise vanished(self._folder / segment) from error
        return row


class Records:
    """The records of a folder that answer for the photographs of a sweep.

    A photograph's answer depends on the work's key, the photograph as it was on disk, and what the
    work says of it. Answers with files hold only as long as those have their sizes and no later
    record is of the same photograph, whose files lie there then. An OSError says that a segment
    is there and cannot be read.
    """

    def __init__(self, manifest: Manifest, work: SweepWork) -> None:
        self.manifest, self.work = manifest, work
        self.run = uuid4().hex
        self._digests = np.fromiter(self._wanted(), np.uint64, len(manifest))
        self._by_digest = np.argsort(self._digests)
        self._table = _Table()
        self._names: list[str] = []
        self._numbers: dict[str, int] = {}
        self._sizes: dict[str, int] = {}
        self._last_segments: dict[str, str] = {}
        self._first, self._last = 0, len(manifest)
        """The part that was asked for."""
        self._by_path = array("q")
        pairs = bytearray()
        for path in sorted(work.state.glob(f"*{SUFFIX}")):
            with suppress(FileNotFoundError), path.open("rb") as file:
                self._sizes[path.name] = os.fstat(file.fileno()).st_size
                while (found := self._read_record(path.name, file)) is not None:
                    pairs += found[1].pairs
        self._rows = self._chosen(pairs)
        """The row that answers for each photograph, or -1."""

    @property
    def is_whole(self) -> bool:
        """Whether every photograph has an answer, of this run or an earlier one."""
        return bool((self._rows >= 0).all())

    def batches(self, part: tuple[int, int] = (1, 1)) -> Iterator[tuple[int, list[str], Batch]]:
        """Yield the batches of a part, each with how many are answered, why some were refused.

        Parts have about equally many photographs.
        """
        total = len(self.manifest)
        numbers = batch_number(self.manifest.hashes, total)
        first_of_each = np.flatnonzero(numbers[1:] != numbers[:-1]) + 1
        cuts = [0, *first_of_each.tolist(), total] if total else []
        inside = [
            (first, last)
            for first, last in pairwise(cuts)
            if first * part[1] // total == part[0] - 1
        ]
        self._first, self._last = (inside[0][0], inside[-1][1]) if inside else (0, 0)
        self._by_path = array("q")
        with _Segments(self.work.state) as segments:
            for first, last in inside:
                rows = self._rows[first:last]
                there = self._records_of(rows)
                refused = [
                    self._head(record, segments)["refused"]
                    for record in there.tolist()
                    if self._table.flags[record] & _REFUSED
                ]
                left = (first + np.flatnonzero(rows < 0)).tolist()
                yield len(there), refused, self._batch(int(numbers[first]), left)

    def notes(self) -> Iterator[dict[str, str]]:
        """Yield what records of answers say, once each."""
        with _Segments(self.work.state) as segments:
            for record in np.unique(self._records_of(self._rows)).tolist():
                if self._table.flags[record] & _NOTES:
                    yield self._head(record, segments)["notes"]

    def take(self, written: Iterable[Written]) -> list[tuple[str | None, dict[str, str]]]:
        """Take what a worker wrote as answers; of two on one photograph the later.

        Returns why each photograph gave nothing, or None, and the notes on it. A ResultsFileError
        says that it is gone.
        """
        taken: dict[bytes, tuple[str | None, dict[str, str]]] = {}
        with _Segments(self.work.state) as segments:
            for place in written:
                file = segments.file(place.segment)
                file.seek(place.at)
                found = self._read_record(place.segment, file)
                if found is None:
                    raise vanished(self.work.state / place.segment)
                record, text = found
                self._last_segments[_writer_of(place.segment)] = place.segment
                self._sizes[place.segment] = max(self._sizes.get(place.segment, 0), file.tell())
                self._answer_with(record, self._places(_pairs(text.pairs)[:, 1]))
                told = text.head.get("refused"), text.head.get("notes", {})
                taken |= dict.fromkeys(_split(text.pairs), told)
        return list(taken.values())

    def answers(self, *, by_path: bool = False) -> Iterator[Answer]:
        """Yield the answers of the part that was done, in the order of the hashes, or of the paths.

        A ResultsFileError says that one is gone.
        """
        places, table = range(self._first, self._last), self._table
        if by_path and len(self._by_path) != len(places):
            # As JSON, states come in the order of their paths.
            states = (b"%b\t%d\n" % (self.manifest.state(place), place) for place in places)
            in_order = sorted_lines(states, self.work.state)
            self._by_path = array("q", (int(line.rpartition(b"\t")[2]) for line in in_order))
        with _Segments(self.work.state) as segments:
            for place in self._by_path if by_path else places:
                row = int(self._rows[place])
                if row < 0:
                    continue
                record = table.record[row]
                head = self._head(record, segments) if table.flags[record] & _REFUSED else {}
                name = self._names[table.segment[record]]
                yield Answer(
                    item=self.manifest[place],
                    row=segments.line(name, table.row_at[row], table.row_size[row]),
                    refused=head.get("refused"),
                    data=self._stored(record),
                )

    def commit(self, records: Sequence[Record]) -> None:
        """Write records, which take the place of the answers for their photographs."""
        hashes = np.array([item.hash for one in records for item in one.items], np.uint64)
        digests = self._digests[places_in(self.manifest.hashes, hashes)]
        by_hash = dict(zip(hashes.tolist(), digests.tolist(), strict=True))
        self.take(writer_for(self.work.state, self.run).append(by_hash, records))

    def superseded_files(self) -> set[str]:
        """Return the files of records that other answers for the same photographs replaced."""
        places = np.array(self._places_of_rows)
        rows = np.flatnonzero(places >= 0)
        replaced = rows[self._rows[places[rows]] != rows]
        with _Segments(self.work.state) as segments:
            return {
                name
                for record in np.unique(self._records_of(replaced)).tolist()
                if self._table.flags[record] & _FILES
                for name in self._head(record, segments)["files"]
            }

    def merged(self, group: int | None = None) -> Iterator[tuple[int, int, int, Stored]]:
        """Yield of each record with bytes its first photograph's hash, their number, and itself.

        They are of all groups or of one, in the order of the hashes.
        """
        hashes, first, last = self.manifest.hashes, 0, len(self.manifest)
        if group is not None:
            first, last = np.searchsorted(group_of(hashes), [group, group + 1]).tolist()
        answered = np.arange(first, last)[self._rows[first:last] >= 0]
        records, firsts = np.unique(self._records_of(self._rows[answered]), return_index=True)
        for at in np.argsort(firsts):
            record = int(records[at])
            if self._table.data_size[record]:
                path_hash = int(hashes[answered[firsts[at]]])
                yield path_hash, len(self._table.rows_of(record)), record, self._stored(record)

    def merge(self, group: int | None = None) -> None:
        """Merge the bytes of records of few photographs, in one group or in each."""
        if not self.work.is_merged or is_few(len(self.manifest)):
            return
        for _, run in groupby(list(self.merged(group)), lambda one: group_of(one[0])):
            few: list[tuple[int, Stored]] = []
            total = 0
            for _, images, record, stored in sorted(run, key=lambda one: one[1:3]):
                if total + images > _MERGED_MOST:
                    self._merge(few)
                    few, total = [], 0
                few.append((record, stored))
                total += images
            self._merge(few)
        self._drop_dead(is_all=False)

    def tidy(self) -> None:
        """Merge what is small, and keep nothing that is no answer, in few segments.

        A segment that another process appended to meanwhile stays.
        """
        self.merge()
        live = self._live()
        is_one = len(live) == 1
        worn = {
            name
            for name, size in live.items()
            if size < self._sizes[name] or not (is_one or size >= SEGMENT_BYTES)
        }
        writer = Writer(self.work.state)  # what it moves comes from this run's segment as well
        answering = np.unique(self._records_of(self._rows)).tolist()
        moved = (one for one in answering if self._names[self._table.segment[one]] in worn)
        while some := tuple(islice(moved, _MOVED_AT_ONCE)):
            texts = map(self._text, some)
            self.take(writer.append_texts((text.lines, data) for text, data in texts))
        self._drop_dead(is_all=True)

    def _wanted(self) -> Iterator[int]:
        """Yield of each photograph a digest of what its answer depends on."""
        key = hashlib.sha256(self.work.key.encode()).hexdigest().encode("ascii")
        is_alone = type(self.work).state_of is SweepWork.state_of
        for place in range(len(self.manifest)):
            asked = key + self.manifest.state(place)
            if not is_alone:
                asked += self.work.state_of(self.manifest[place]).encode("ascii")
            yield first_bits(asked)

    def _places(self, digests: NDArray[np.uint64]) -> Numbers:
        return places_in(self._digests, digests, self._by_digest)

    def _records_of(self, rows: Numbers) -> Numbers:
        """Return the records of those rows that there are."""
        return np.asarray(self._table.record)[rows[rows >= 0]].astype(np.int64)

    def _stored(self, record: int) -> Stored:
        table = self._table
        path = self.work.state / self._names[table.segment[record]]
        size = table.data_size[record]
        return Stored(path=path, at=table.at[record] + table.size[record] - size, size=size)

    def _head(self, record: int, segments: _Segments) -> Row:
        """Return what a record says of all of its photographs."""
        file = segments.file(self._names[self._table.segment[record]])
        file.seek(self._table.at[record])
        file.readline()
        head: Row = json.loads(file.readline())
        return head

    def _batch(self, number: int, left: Sequence[int]) -> Batch:
        hashes = [int(self.manifest.hashes[place]) for place in left]
        begun = {
            path_hash: self._stored(self._table.record[self._begun[place]])
            for place, path_hash in zip(left, hashes, strict=True)
            if place in self._begun
        }
        return Batch(
            number=number,
            run=self.run,
            items=tuple(self.manifest[place] for place in left),
            digests=dict(zip(hashes, self._digests[left].tolist(), strict=True)),
            begun=begun,
            overwritten=frozenset(
                path_hash
                for place, path_hash in zip(left, hashes, strict=True)
                if self._is_written[place]
            ),
        )

    def _read_record(self, segment: str, file: BinaryIO) -> tuple[int, RecordText] | None:
        """Take the next record into the table; None if there is none, or it is torn."""
        at = file.tell()
        found = read_record(file)
        if found is None:
            return None
        number = self._numbers.setdefault(segment, len(self._names))
        if number == len(self._names):
            self._names.append(segment)
        return self._table.add(number, at, file.tell(), found), found[0]

    def _chosen(self, pairs: bytes | bytearray) -> Numbers:
        """Find the rows that answer, among those of all records, which have these pairs."""
        hashes, digests = _pairs(pairs).T
        places = self._places(digests)
        self._places_of_rows = array("q", places.tobytes())
        record_of, flags = np.array(self._table.record), np.array(self._table.flags)
        chosen = self._chosen_merged(places)
        is_begun = flags[record_of] & _BEGUN > 0
        is_used = (places >= 0) & (np.bincount(record_of)[record_of] == 1)
        alone = np.flatnonzero(is_used & ~is_begun)
        alone = alone[chosen[places[alone]] < 0]
        chosen[places[alone]] = alone  # of several the last
        has_data = np.array(self._table.data_size)[record_of] > 0
        begun = np.flatnonzero(is_used & is_begun & has_data)
        self._begun = dict(zip(places[begun].tolist(), begun.tolist(), strict=True))
        has_files = flags[record_of] & _FILES > 0
        owners = places_in(self.manifest.hashes, hashes)
        self._is_written = np.zeros(len(chosen), np.bool_)
        """Whether files of another answer may be there."""
        self._is_written[owners[(owners >= 0) & (places != owners) & has_files]] = True
        self._drop_overwritten(chosen, owners, has_files)
        return chosen

    def _chosen_merged(self, places: Numbers) -> Numbers:
        """Find the rows of records of several photographs that answer, those of most first.

        A merge that was killed leaves its parts beside the whole.
        """
        chosen = np.full(len(self.manifest), -1)
        if is_few(len(self.manifest)):
            return chosen
        images = np.bincount(np.asarray(self._table.record), minlength=1)
        several = np.flatnonzero(images > 1)
        for record in several[np.argsort(-images[several], kind="stable")].tolist():
            rows = self._table.rows_of(record)
            at = places[rows.start : rows.stop]
            is_final = not self._table.flags[record] & _BEGUN
            if is_final and (at >= 0).all() and (chosen[at] < 0).all():
                chosen[at] = rows
        return chosen

    def _drop_overwritten(
        self, chosen: Numbers, owners: Numbers, has_files: NDArray[np.bool_]
    ) -> None:
        """Drop answers whose files are not as they were, or may be those of later records."""
        last = np.full(len(chosen), -1)
        known = np.flatnonzero(owners >= 0)
        last[owners[known]] = known
        answered = np.flatnonzero(chosen >= 0)
        with _Segments(self.work.state) as segments:
            for place in answered[has_files[chosen[answered]]].tolist():
                row = int(chosen[place])
                record = self._table.record[row]
                if last[place] != row or not self._files_are_there(record, segments):
                    chosen[place] = -1

    def _files_are_there(self, record: int, segments: _Segments) -> bool:
        files = self._head(record, segments)["files"]
        mark_of, root = self.work.mark_of, self.work.root
        return all(_if_there(mark_of, root / name) == mark for name, mark in files.items())

    def _answer_with(self, record: int, places: Numbers) -> None:
        rows = np.array(self._table.rows_of(record))
        self._places_of_rows.extend(places.tolist())
        is_wanted = places >= 0
        self._rows[places[is_wanted]] = rows[is_wanted]

    def _merge(self, records: Sequence[tuple[int, Stored]]) -> None:
        """Replace several by one, whose rows and notes are theirs and whose bytes are merged."""
        if len(records) < 2:
            return
        texts = [self._text(record)[0] for record, _ in records]
        notes: dict[str, str] = {}
        for text in texts:
            merge_notes(notes, text.head.get("notes", {}))
        whole = RecordText(
            pairs=b"".join(text.pairs for text in texts),
            head={"notes": notes} if notes else {},
            rows=[row for text in texts for row in text.rows],
        )
        data = self.work.merged([stored for _, stored in records])
        writer = writer_for(self.work.state, self.run)
        self.take(writer.append_texts([(whole.lines, data)]))

    def _text(self, record: int) -> tuple[RecordText, bytes]:
        """Read a record again."""
        path = self.work.state / self._names[self._table.segment[record]]
        with path.open("rb") as file:
            file.seek(self._table.at[record])
            found = read_record(file)
        if found is None:
            raise vanished(path)
        return found

    def _live(self) -> dict[str, int]:
        """Segments with answers, and how many bytes of each are records of answers."""
        live: dict[str, int] = {}
        for record in np.unique(self._records_of(self._rows)).tolist():
            name = self._names[self._table.segment[record]]
            live[name] = live.get(name, 0) + self._table.size[record]
        return live

    def _drop_dead(self, *, is_all: bool) -> None:
        """Delete segments without an answer; unless all, only those that this run's workers left.

        Of all, one that became longer than was read is another process's at work.
        """
        live = self._live()
        current = set(self._last_segments.values())
        for name in self._sizes.keys() - live.keys():
            path = self.work.state / name
            is_own = _writer_of(name) in self._last_segments and name not in current
            if is_own or (is_all and _if_there(_size_of, path) == self._sizes[name]):
                path.unlink(missing_ok=True)
                del self._sizes[name]


def _pairs(data: bytes | bytearray) -> NDArray[np.uint64]:
    """Return the hashes and digests, shape (rows, 2)."""
    return np.frombuffer(data, ">u8").astype(np.uint64).reshape(-1, 2)


def _split(pairs: bytes) -> list[bytes]:
    return [pairs[at : at + 16] for at in range(0, len(pairs), 16)]


def _writer_of(segment: str) -> str:
    return segment.partition("-")[2]


def merge_notes(notes: dict[str, str], others: Mapping[str, str]) -> None:
    """Add notes to others; of two of a kind the first by its letters stays."""
    for kind, text in others.items():
        notes[kind] = min(text, notes.get(kind, text))


def _size_of(path: Path) -> int:
    return path.stat().st_size


def _if_there(mark_of: Callable[[Path], int | str], path: Path) -> int | str | None:
    """Return what is said of a file; None if there is none."""
    try:
        return mark_of(path)
    except (OSError, ValueError):  # a name with a zero byte
        return None
