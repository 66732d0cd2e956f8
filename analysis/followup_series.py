"""Many follow-ups of one reference: each done once, by this process or others, and listed.

A follow-up takes about a second. So each has a commit of its own: whatever is killed, at most one
is lost, and a folder that grew is not done anew.
"""

import csv
import hashlib
import json
import os
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from heapq import nlargest
from io import TextIOWrapper
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar, Generic, Self, TypeVar

import numpy as np

from acquisition.dataframe import dataframe
from acquisition.files import InputFile, Provenance, utc_now
from acquisition.photographs import Photograph
from acquisition.printable import beginning_of, on_one_line
from acquisition.session import whole_file
from analysis.errors import AnalysisError, ResultsFileError
from analysis.parquet_table import column_kinds, require_parquet, write_parquet
from analysis.results_file import ResultsDocument, StoredValues
from analysis.sweep import (
    Batch,
    Commit,
    Manifest,
    Record,
    Records,
    Row,
    SweepCall,
    SweepItem,
    SweepOptions,
    SweepSummary,
    SweepWork,
    announced_sweep,
    refusal,
)
from calibration.documents import json_object
from calibration.errors import CalibrationError
from simulation.notebook import Shown

if TYPE_CHECKING:
    from pandas import DataFrame

SUMMARY_NAME = "summary.json"
STATE_NAME = "followups.sweep"
"""Folder of the records, in the folder of the results."""

_LIST_KEY = "followups"
"""The one list of a summary that is as long as the sweep."""

_SHOWN_WHOLE, _SHOWN_OF_MANY = 20, 5
_HASH_DIGITS = 12
_LONGEST_STEM_BYTES = 200
"""Before a hash; a name has 255 at most."""

Found = TypeVar("Found")
Listed = TypeVar("Listed", bound=StoredValues)
Document = TypeVar("Document", bound=ResultsDocument)


@dataclass(frozen=True, slots=True, kw_only=True)
class References(ABC):
    """Finds the reference of a follow-up, in any process, and reads follow-ups.

    ``path`` is the reference, or the folder of references, absolute; ``name`` the same as the user
    named it. ``kinds`` are those of remarks that were made already.
    """

    path: Path
    name: str
    kinds: frozenset[str] = frozenset()

    @property
    @abstractmethod
    def how_read(self) -> str:
        """How photographs are read, as text."""

    @abstractmethod
    def of(self, followup: Path) -> Photograph:
        """Read the reference of a follow-up; a `RefusedPhotographError` refuses this one."""

    @abstractmethod
    def followup(self, path: Path) -> Photograph:
        """Read a follow-up; a `RefusedPhotographError` refuses it."""

    @abstractmethod
    def name_for(self, followup: Path) -> str | None:
        """Name the reference of this follow-up alone; None where all share one."""

    @abstractmethod
    def state_for(self, followup: Path) -> str:
        """Say what may change of the reference of this follow-up alone, as text."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Written:
    """What a follow-up gave: its line in the summary, and files below the folder of results."""

    row: Row
    files: tuple[Path, ...] = ()
    notes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class FollowupWork(SweepWork, Generic[Found]):
    """Compares follow-ups with their references, in any process.

    ``out`` is the folder of the results, absolute; ``provenance`` that of what all share.
    """

    listed: ClassVar[type[StoredValues]]
    """A line of the summary; it has at least ``followup``, ``sha256`` and ``refused``."""

    commits_each = True

    out: Path
    references: References
    provenance: Provenance

    @property
    @abstractmethod
    def settings(self) -> dict[str, Any]:
        """What is done, apart from the contents of the files that all follow-ups share."""

    @abstractmethod
    def find(self, near: Photograph, photograph: Photograph) -> Found:
        """Compare; an `AnalysisError` or `CalibrationError` refuses it."""

    @abstractmethod
    def write(self, photograph: Photograph, found: Found) -> Written:
        """Write what was found."""

    def discard(self, item: SweepItem) -> None:
        """Remove what an earlier photograph of this name gave, as this one gave nothing."""
        return

    @property
    def key(self) -> str:
        """What is done, and with which reference, PSF and so on, as text."""
        shared = [file.sha256 for file in self.provenance.inputs]
        settings = {"reading": self.references.how_read, **self.settings}
        return json.dumps([shared, settings], sort_keys=True)

    @property
    def state(self) -> Path:
        """Folder of the records."""
        return self.out / STATE_NAME

    @property
    def root(self) -> Path:
        """Folder of the results."""
        return self.out

    def state_of(self, item: SweepItem) -> str:
        """Say which reference the follow-up has, if it is its own."""
        return self.references.state_for(item.path)

    def answer(self, item: SweepItem, batch: Batch, commit: Commit) -> Record:
        """Read, compare and write one follow-up."""
        digest = None
        try:
            near = self.references.of(item.path)
            photograph = self.references.followup(item.path)
            digest = photograph.sha256
            found = self.find(near, photograph)
        except (AnalysisError, CalibrationError) as error:
            self.discard(item)
            return self._refusal(item, digest, error)
        written = self.write(photograph, found)
        remarks = near.remarks | photograph.remarks | dict(written.notes)
        known = self.references.kinds
        return Record(
            items=(item,),
            rows=(written.row,),
            notes={kind: text for kind, text in remarks.items() if kind not in known},
            files={str(path.relative_to(self.out)): path.stat().st_size for path in written.files},
        )

    def provenance_with(self, *photographs: Photograph) -> Provenance:
        """Return the provenance of what one follow-up gave, and its reference if it is its own."""
        shared = self.provenance.encoding
        encodings = dict.fromkeys([shared] if isinstance(shared, str) else shared)
        inputs = {file.path: file for file in self.provenance.inputs}
        for each in photographs:
            path = on_one_line(each.path)
            inputs[path] = InputFile(path=path, sha256=each.sha256 or "")
            encodings[each.encoding.name] = None
        return self.provenance.model_copy(
            update={
                "created": utc_now(),
                "inputs": tuple(inputs.values()),
                "encoding": next(iter(encodings)) if len(encodings) == 1 else tuple(encodings),
            }
        )

    def _refusal(self, item: SweepItem, digest: str | None, error: Exception) -> Record:
        record = refusal(item, error)
        row = {"followup": on_one_line(item.path), "sha256": digest, "refused": record.refused}
        listed = self.listed.model_validate(row).model_dump(mode="json")
        return replace(record, rows=(listed,))


@dataclass(frozen=True, slots=True)
class FolderNames:
    """A photograph's folder is named by its stem, or by stem and path where the stem is taken.

    The same where a letter of the stem is not printable, which no document and no page may hold.

    ``taken`` holds the hashes of stems that several photographs have, or that are not to be used.
    Whether a file system tells capitals from small letters does not matter.
    """

    taken: frozenset[int]

    @classmethod
    def of(cls, photographs: Manifest, reserved: Iterable[str]) -> Self:
        """Find the stems that several photographs have; ``reserved`` are names of other files."""
        stems = (_hash(item.path.stem) for item in photographs)
        hashes = np.fromiter(stems, dtype=np.uint64, count=len(photographs))
        values, counts = np.unique(hashes, return_counts=True)
        # pathlib takes the stem of "...tif" for "..".
        unusable = {_hash(name) for name in (".", "..", *reserved)}
        return cls(frozenset(values[counts > 1].tolist()) | unusable)

    def name_of(self, path: Path) -> str:
        """Return the name of the folder for a photograph's results."""
        stem = path.stem
        if stem.isprintable() and _hash(stem) not in self.taken:
            return stem
        shown = "".join(letter if letter.isprintable() else "_" for letter in stem)
        digest = hashlib.sha256(os.fsencode(path)).hexdigest()
        return f"{beginning_of(shown, _LONGEST_STEM_BYTES)}-{digest[:_HASH_DIGITS]}"


def _hash(name: str) -> int:
    return int.from_bytes(hashlib.sha256(os.fsencode(name.casefold())).digest()[:8], "big")


@dataclass(frozen=True, slots=True)
class FollowupRows:
    """The lines of a summary, in the order of the follow-ups' paths; they are read each time."""

    records: Records

    def __iter__(self) -> Iterator[Row]:
        return (answer.row for answer in self.records.answers(by_path=True))

    def count(self, is_counted: Callable[[Row], bool]) -> int:
        """Return the number of lines of some kind."""
        return sum(map(is_counted, self))


def is_refused(row: Row) -> bool:
    """Whether a follow-up gave nothing."""
    return row["refused"] is not None


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class SeriesResult(Shown, Generic[Document, Listed]):
    """Result of processing a series of follow-ups.

    Parameters
    ----------
    sweep
        Counts of follow-ups done by this run and by earlier ones, in the part of this run.
    summary
        Path of the summary.json with all follow-ups.
    document
        The summary without its follow-ups; None until all parts of the work are done.
    first, worst
        Of up to 20 follow-ups, ``first`` has all and ``worst`` none; of more, the first and the
        worst 5.
    """

    sweep: SweepSummary
    summary: Path
    document: Document | None = None
    first: tuple[Listed, ...] = ()
    worst: tuple[Listed, ...] = ()
    notes: tuple[str, ...] = ()

    def to_dataframe(self) -> "DataFrame":
        """Return the follow-ups as a pandas table, one row per follow-up.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.
        """
        return dataframe(self.to_json()["followups"])

    def to_json(self) -> dict[str, Any]:
        """Return the whole summary.json, as ``--json`` prints it; it must fit into memory."""
        summary: dict[str, Any] = json.loads(self.summary.read_bytes())
        return summary


@dataclass(frozen=True, slots=True, kw_only=True)
class SeriesTables(Generic[Document, Listed]):
    """Output of a series: table, order of the worst rows, document, other files and their writer.

    ``out`` is the folder that they are written to. The table has a column for each value of a row,
    except those ``left_out``; with ``has_parquet`` it is also written as Parquet.
    """

    out: Path
    table: str
    listed: Callable[[Row], Listed]
    badness: Callable[[Row], float]
    document: Callable[[FollowupRows], Document]
    left_out: tuple[str, ...] = ()
    others: tuple[str, ...] = ()
    has_parquet: bool = False
    finish: Callable[[FollowupRows, Document], None] = lambda rows, document: None


def run_series(
    call: SweepCall,
    work: FollowupWork[Any],
    manifest: Manifest,
    tables: SeriesTables[Document, Listed],
    options: SweepOptions | None,
) -> SeriesResult[Document, Listed]:
    """Do the follow-ups that no earlier run did and, once all are done, write the tables.

    A `SweepError` says that no worker is fit, or, when strict, a follow-up is refused; a
    `ResultsFileError` that results cannot be written.
    """
    out = tables.out
    summary = out / SUMMARY_NAME
    if tables.has_parquet:
        require_parquet()
    parquet = (out / tables.table).with_suffix(".parquet")
    for path in (summary, out / tables.table, parquet, *map(out.joinpath, tables.others)):
        path.unlink(missing_ok=True)  # of before: there is none until all are done
    sweep, records = announced_sweep(call, "follow-ups", manifest, work, options)
    if not records.is_whole or (options is not None and options.part != (1, 1)):
        # Whichever part ends last writes the tables, of all: others may have ended meanwhile.
        records = Records(manifest, work)
    if not records.is_whole:
        return SeriesResult(sweep=sweep, summary=summary)
    rows = FollowupRows(records)
    document = tables.document(rows)
    tables.finish(rows, document)
    columns = [name for name in work.listed.model_fields if name not in tables.left_out]
    write_csv(out / tables.table, columns, rows)
    if tables.has_parquet:
        write_parquet(parquet, column_kinds(work.listed, columns), rows)
    write_summary(summary, document, rows)
    first, worst = list(islice(rows, _SHOWN_WHOLE + 1)), []
    if len(first) > _SHOWN_WHOLE:
        given = (row for row in rows if not is_refused(row))
        first, worst = first[:_SHOWN_OF_MANY], nlargest(_SHOWN_OF_MANY, given, tables.badness)
    return SeriesResult(
        sweep=sweep,
        summary=summary,
        document=document,
        first=tuple(map(tables.listed, first)),
        worst=tuple(map(tables.listed, worst)),
    )


def write_csv(path: Path, columns: Sequence[str], rows: Iterable[Row]) -> None:
    """Write a line for each row, and the names of the columns above; None is an empty cell."""
    with _text_file(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows([row[column] for column in columns] for row in rows)


def write_summary(path: Path, document: ResultsDocument, rows: Iterable[Row]) -> None:
    """Write a document with its list of follow-ups, which need not fit into memory."""
    with _text_file(path) as file:
        separator = "{"
        for key, value in json_object(document).items():
            file.write(f"{separator}\n {json.dumps(key)}: ")
            if key == _LIST_KEY:
                _write_list(file, rows)
            else:
                file.write(json.dumps(value, allow_nan=False))
            separator = ","
        file.write("\n}\n")


def _write_list(file: TextIOWrapper, rows: Iterable[Row]) -> None:
    separator = "["
    for row in rows:
        file.write(f"{separator}\n  {json.dumps(row, allow_nan=False)}")
        separator = ","
    file.write("[]" if separator == "[" else "\n ]")


@contextmanager
def _text_file(path: Path) -> Iterator[TextIOWrapper]:
    """Open a text file that is there whole or not at all; the last of several writers wins."""
    try:
        with whole_file(path, is_synced=True) as file:
            text = TextIOWrapper(file, encoding="utf-8", newline="")
            yield text
            text.detach()  # flushed; whoever opened the file closes it
    except OSError as error:
        raise ResultsFileError(
            f"cannot write {path}: {error.strerror}", source=str(path)
        ) from error
