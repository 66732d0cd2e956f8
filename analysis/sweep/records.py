"""The records of a folder, found again: what was done to the photographs of a sweep, once each.

A commit appends records to the writer's own segment and makes them durable; what is torn is no
record, and nobody locks anything. A record is of one photograph, or of several whose bytes were
merged. All segments of a folder together are what is known; a nameless database finds it again.
"""

import hashlib
import json
import os
import sqlite3
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import groupby, islice
from pathlib import Path
from typing import TYPE_CHECKING, BinaryIO
from uuid import uuid4

from analysis.sweep.items import (
    GROUP_HASHES,
    GROUPS,
    HASH_BITS,
    Manifest,
    SweepItem,
    batch_number,
    first_bits,
    group_of,
    is_few,
    item_of,
    signed,
    unsigned,
)
from analysis.sweep.segments import (
    SEGMENT_BYTES,
    SUFFIX,
    Batch,
    Record,
    Row,
    Segments,
    Stored,
    Written,
    json_line,
    read_record,
    vanished,
    writer_for,
)

if TYPE_CHECKING:
    from analysis.sweep.work import SweepWork

_MERGED_MOST = 1024
"""Photographs of merged bytes, which one changed photograph makes useless."""

_PAGE = 1000
"""Rows of the database that are held at once."""

_MOVED_AT_ONCE = 16
"""Records with their bytes in memory."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Answer:
    """What a photograph gave: its row, why it gave nothing, and where the record's bytes are."""

    item: SweepItem
    row: Row
    refused: str | None
    data: Stored


_TABLES = """
drop table if exists records; drop table if exists lines; drop table if exists wanted;
drop table if exists answers;
create table records(
    id integer primary key, segment text, at integer, size integer, data_at integer,
    data_size integer, photographs integer, refused text, notes text, files text, is_final integer
);
create table lines(
    id integer primary key, record integer, digest integer, hash integer, at integer, size integer
);
create index lines_by_digest on lines(digest);
create index lines_by_hash on lines(hash);
create index lines_by_record on lines(record);
create table wanted(digest integer primary key, hash integer);
create index wanted_by_hash on wanted(hash);
create table answers(digest integer primary key, line integer);
"""

_ANSWERS = """
from items join wanted using(hash) join answers using(digest) join lines on lines.id = answers.line
join records on records.id = lines.record
"""


class Records:
    """The records of a folder that answer for the photographs of a sweep.

    A photograph's answer depends on the work's key, the photograph as it was on disk, and what the
    work says of it. Answers with files hold only as long as those have their sizes and no later
    record is of the same photograph, whose files lie there then.

    Parameters
    ----------
    manifest
        The photographs.
    work
        What is asked.

    Raises
    ------
    OSError
        If a segment is there and cannot be read.
    """

    def __init__(self, manifest: Manifest, work: "SweepWork") -> None:
        self.manifest, self.work = manifest, work
        self.run = uuid4().hex
        self._database = manifest.database
        self._database.executescript(_TABLES)
        self._database.executemany("insert or ignore into wanted values(?, ?)", self._wanted())
        self._sizes: dict[str, int] = {}
        self._last_segments: dict[str, str] = {}
        for path in sorted(work.state.glob(f"*{SUFFIX}")):
            self._read_segment(path)
        self._has_earlier = bool(self._sizes)
        self._span = [signed(0), signed(2**HASH_BITS - 1)]
        """Least and largest hash of the part, if it has any."""
        self._choose()

    @property
    def is_whole(self) -> bool:
        """Whether every photograph has an answer, of this run or an earlier one."""
        (answers,) = self._database.execute("select count(*) from answers").fetchone()
        return bool(answers == len(self.manifest))

    def batches(self, part: tuple[int, int] = (1, 1)) -> Iterator[tuple[list[str | None], Batch]]:
        """Yield the batches of a part, with the answers that are there and what is left.

        An answer is why the photograph gave nothing, or None. Parts have about equally many
        photographs.
        """
        first, total = 0, len(self.manifest)
        self._span = []
        for number, run in groupby(self._states(), lambda one: batch_number(one[1], total)):
            states = list(run)
            if first * part[1] // total == part[0] - 1:
                self._span = [*self._span[:1], signed(states[0][1]), signed(states[-1][1])]
                done = [refused for _, _, _, line, refused in states if line is not None]
                yield done, self._batch(number, [one[:3] for one in states if one[3] is None])
            first += len(states)

    def notes(self) -> Iterator[dict[str, str]]:
        """Yield what records of answers say, once each."""
        for (text,) in self._database.execute(
            f"select distinct notes {_ANSWERS} where notes <> '{{}}'"
        ):
            yield json.loads(text)

    def take(self, written: Iterable[Written]) -> list[tuple[str | None, dict[str, str]]]:
        """Take what a worker wrote as answers; of two on one photograph the later.

        Returns why each photograph gave nothing, or None, and the notes on it.

        Raises
        ------
        ResultsFileError
            If it is gone.
        """
        taken: dict[int, tuple[str | None, dict[str, str]]] = {}
        for place in written:
            path = self.work.state / place.segment
            record = None
            with suppress(FileNotFoundError), path.open("rb") as file:
                file.seek(place.at)
                record = self._read_record(place.segment, file)
            if record is None:
                raise vanished(path)
            self._last_segments[_writer_of(place.segment)] = place.segment
            self._sizes[place.segment] = max(
                self._sizes.get(place.segment, 0), place.at + place.size
            )
            self._answer_with(record)
            refused, notes = self._database.execute(
                "select refused, notes from records where id = ?", (record,)
            ).fetchone()
            for (digest,) in self._database.execute(
                "select digest from lines where record = ?", (record,)
            ):
                taken[digest] = refused, json.loads(notes)
        return list(taken.values())

    def answers(self, *, by_path: bool = False) -> Iterator[Answer]:
        """Yield the answers of the part that was done, in the order of the hashes, or of the paths.

        Raises
        ------
        ResultsFileError
            If one is gone.
        """
        least, largest = (self._span[0], self._span[-1]) if self._span else (0, -1)
        # As JSON, states come in the order of their paths.
        found = self._database.execute(
            f"select state, refused, segment, lines.at, lines.size, data_at, data_size {_ANSWERS} "
            f"where items.hash between ? and ? order by {'state' if by_path else 'items.hash'}",
            (least, largest),
        )
        with Segments(self.work.state) as segments:
            for state, refused, segment, at, length, data_at, data_size in found:
                yield Answer(
                    item=item_of(state),
                    row=json.loads(segments.read(segment, at, length))[2],
                    refused=refused,
                    data=Stored(path=self.work.state / segment, at=data_at, size=data_size),
                )

    def commit(self, records: Sequence[Record]) -> None:
        """Write records, which take the place of the answers for their photographs."""
        hashes = (item.hash for record in records for item in record.items)
        find = "select digest from wanted where hash = ?"
        digests = {
            one: self._database.execute(find, (signed(one),)).fetchone()[0] for one in hashes
        }
        self.take(writer_for(self.work.state, self.run).append(digests, records))

    def superseded_files(self) -> set[str]:
        """Return the files of records that other answers for the same photographs replaced."""
        replaced = self._database.execute(
            "select distinct files from lines join answers using(digest) "
            "join records on record = records.id where line <> lines.id"
        )
        return {name for (files,) in replaced for name in json.loads(files)}

    def merged(self, group: int | None = None) -> Iterator[tuple[int, int, int, Stored]]:
        """Yield of each record with bytes its first photograph's hash, their number, and itself.

        They are of all groups or of one, in the order of the hashes.
        """
        first, last = (0, GROUPS - 1) if group is None else (group, group)
        for path_hash, images, id_, segment, at, size in self._database.execute(
            "select min(items.hash), photographs, records.id, segment, data_at, data_size "
            f"{_ANSWERS} where data_size > 0 and items.hash between ? and ? "
            "group by records.id order by min(items.hash)",
            (
                signed(first * GROUP_HASHES),
                signed((last + 1) * GROUP_HASHES - 1),
            ),
        ):
            stored = Stored(path=self.work.state / segment, at=at, size=size)
            yield unsigned(path_hash), images, id_, stored

    def merge(self, group: int | None = None) -> None:
        """Merge the bytes of records of few photographs, in one group or in each."""
        if not self.work.is_merged or is_few(len(self.manifest)):
            return
        for _, run in groupby(list(self.merged(group)), lambda one: group_of(one[0])):
            few: list[tuple[int, Stored]] = []
            total = 0
            for _, images, id_, stored in sorted(run, key=lambda one: one[1:3]):
                if total + images > _MERGED_MOST:
                    self._merge(few)
                    few, total = [], 0
                few.append((id_, stored))
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
        writer = writer_for(self.work.state, self.run)
        moved = self._database.execute(
            f"select distinct records.id, segment {_ANSWERS} order by records.id"
        ).fetchall()
        ids = [id_ for id_, segment in moved if segment in worn]
        for some in _pages(ids):
            for id_, place in zip(some, writer.append_texts(map(self._text, some)), strict=True):
                self._replace([id_], place)
        self._drop_dead(is_all=True)

    def _wanted(self) -> Iterator[tuple[int, int]]:
        """Yield of each photograph a digest of what its answer depends on, and its hash."""
        key = hashlib.sha256(self.work.key.encode()).hexdigest()
        for path_hash, state in self._database.execute("select hash, state from items"):
            asked = f"{key}{state}{self.work.state_of(item_of(state))}"
            yield signed(first_bits(asked.encode("ascii"))), path_hash

    def _states(self) -> Iterator[tuple[SweepItem, int, int, int | None, str | None]]:
        """Yield each item, its hash and digest, and its answer: a line and why it is refused."""
        first = signed(0)
        while some := self._database.execute(
            "select items.hash, state, wanted.digest, line, refused "
            "from items join wanted using(hash) left join answers using(digest) "
            "left join lines on lines.id = line left join records on records.id = record "
            "where items.hash >= ? order by items.hash limit ?",
            (first, _PAGE),
        ).fetchall():
            for path_hash, state, digest, line, refused in some:
                yield item_of(state), unsigned(path_hash), digest, line, refused
            first = some[-1][0] + 1

    def _batch(self, number: int, left: Sequence[tuple[SweepItem, int, int]]) -> Batch:
        begun: dict[int, Stored] = {}
        overwritten = set()
        for _, path_hash, digest in left if self._has_earlier else ():
            found = self._database.execute(
                "select segment, data_at, data_size from lines join records on record = records.id "
                "where digest = ? and not is_final and data_size order by lines.id desc limit 1",
                (digest,),
            ).fetchone()
            if found is not None:
                path = self.work.state / found[0]
                begun[path_hash] = Stored(path=path, at=found[1], size=found[2])
            if self._database.execute(
                "select 1 from lines join records on record = records.id "
                "where hash = ? and digest <> ? and files <> '{}' limit 1",
                (signed(path_hash), digest),
            ).fetchone():
                overwritten.add(path_hash)
        return Batch(
            number=number,
            run=self.run,
            items=tuple(item for item, _, _ in left),
            digests={path_hash: digest for _, path_hash, digest in left},
            begun=begun,
            overwritten=frozenset(overwritten),
        )

    def _read_segment(self, path: Path) -> None:
        with suppress(FileNotFoundError), path.open("rb") as file:
            self._sizes[path.name] = os.fstat(file.fileno()).st_size
            while self._read_record(path.name, file) is not None:
                pass

    def _read_record(self, segment: str, file: BinaryIO) -> int | None:
        """Take the next record into the database; None if there is none, or it is torn."""
        at = file.tell()
        found = read_record(file)
        if found is None:
            return None
        text, data_size = found
        head, *lines = text.splitlines(keepends=True)
        line_at = file.tell() - data_size - len(text) + len(head)
        try:
            told = json.loads(head)
            values = (
                *(segment, at, file.tell() - at, file.tell() - data_size, data_size, len(lines)),
                *(told["refused"], json.dumps(told["notes"]), json.dumps(told["files"])),
                bool(told["is_final"]),
            )
            hashes = [
                (signed(path_hash), digest) for path_hash, digest, _ in map(json.loads, lines)
            ]
            cursor = self._database.execute(
                "insert into records values(null, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)", values
            )
        except (ValueError, LookupError, TypeError, RecursionError, sqlite3.Error):
            return None
        record = cursor.lastrowid
        for (path_hash, digest), line in zip(hashes, lines, strict=True):
            self._database.execute(
                "insert into lines values(null, ?, ?, ?, ?, ?)",
                (record, digest, path_hash, line_at, len(line)),
            )
            line_at += len(line)
        return record

    def _choose(self) -> None:
        """Find the answers among the records, those of most photographs first.

        A merge that was killed leaves its parts beside the whole.
        """
        if not is_few(len(self.manifest)):
            for (record,) in self._database.execute(
                "select id from records where photographs > 1 and is_final "
                "order by photographs desc, id"
            ).fetchall():
                (others,) = self._database.execute(
                    "select count(*) from lines left join wanted using(digest) "
                    "left join answers using(digest) "
                    "where record = ? and (wanted.digest is null or line is not null)",
                    (record,),
                ).fetchone()
                if not others:
                    self._answer_with(record)
        self._database.execute(
            "insert or ignore into answers select digest, max(lines.id) from lines "
            "join wanted using(digest) join records on record = records.id "
            "where photographs = 1 and is_final group by digest"
        )
        root = self.work.root
        for digest, line, path_hash, files in self._database.execute(
            "select answers.digest, line, lines.hash, files from answers "
            "join lines on line = lines.id join records on record = records.id where files <> '{}'"
        ).fetchall():
            (last,) = self._database.execute(
                "select max(id) from lines where hash = ?", (path_hash,)
            ).fetchone()
            sizes = json.loads(files)
            if last != line or any(_size_of(root / name) != size for name, size in sizes.items()):
                self._database.execute("delete from answers where digest = ?", (digest,))

    def _answer_with(self, record: int) -> None:
        self._database.execute(
            "insert or replace into answers select digest, id from lines where record = ?",
            (record,),
        )

    def _merge(self, records: Sequence[tuple[int, Stored]]) -> None:
        """Replace several by one, whose lines and notes are theirs and whose bytes are merged."""
        if len(records) < 2:
            return
        notes: dict[str, str] = {}
        lines = b""
        for id_, _ in records:
            head, *own = self._text(id_)[0].splitlines(keepends=True)
            lines += b"".join(own)
            merge_notes(notes, json.loads(head)["notes"])
        head = json_line({"refused": None, "notes": notes, "files": {}, "is_final": True})
        data = self.work.merged([stored for _, stored in records])
        writer = writer_for(self.work.state, self.run)
        (place,) = writer.append_texts([(head + lines, data)])
        self._replace([id_ for id_, _ in records], place)

    def _text(self, record: int) -> tuple[bytes, bytes]:
        """Return the lines and the bytes of a record."""
        segment, at = self._database.execute(
            "select segment, at from records where id = ?", (record,)
        ).fetchone()
        path = self.work.state / segment
        with path.open("rb") as file:
            file.seek(at)
            found = read_record(file)
            if found is None:
                raise vanished(path)
            text, data_size = found
            file.seek(-data_size, os.SEEK_CUR)
            return text, file.read(data_size)

    def _replace(self, records: Sequence[int], place: Written) -> None:
        self.take([place])
        for record in records:
            self._database.execute("delete from lines where record = ?", (record,))
            self._database.execute("delete from records where id = ?", (record,))

    def _live(self) -> dict[str, int]:
        """Segments with answers, and how many bytes of each are records of answers."""
        live: dict[str, int] = {}
        for _, segment, size in self._database.execute(
            f"select distinct records.id, segment, records.size {_ANSWERS}"
        ):
            live[segment] = live.get(segment, 0) + size
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
            if is_own or (is_all and _size_of(path) == self._sizes[name]):
                path.unlink(missing_ok=True)
                del self._sizes[name]


def _writer_of(segment: str) -> str:
    return segment.partition("-")[2]


def _pages(ids: Sequence[int]) -> Iterator[Sequence[int]]:
    each = iter(ids)
    while some := tuple(islice(each, _MOVED_AT_ONCE)):
        yield some


def merge_notes(notes: dict[str, str], others: Mapping[str, str]) -> None:
    """Add notes to others; of two of a kind the first by its letters stays."""
    for kind, text in others.items():
        notes[kind] = min(text, notes.get(kind, text))


def _size_of(path: Path) -> int | None:
    """Return the size of a file in bytes; None if there is none."""
    try:
        return path.stat().st_size
    except (OSError, ValueError):  # a name with a zero byte
        return None
