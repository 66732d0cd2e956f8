"""The work on a shard of follow-ups: each is read, compared with the reference and committed.

A follow-up takes about a second. So each has a commit of its own: whatever is killed, at most one
is lost, and a folder that grew is not done anew.
"""

import hashlib
import json
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar, Generic, Protocol, TypeVar

from acquisition.files import InputFile, Provenance, utc_now
from acquisition.printable import on_one_line
from analysis.errors import AnalysisError, RefusedPhotographError
from analysis.followup_series.record import FollowupRecord
from analysis.results_file import StoredValues
from analysis.sweep import Shard, ShardDone, ShardWork, SweepItem, refusal_line, size_of
from calibration.errors import CalibrationError

STATE_NAME = "followups.sweep"
"""Folder of the commits, in the folder of the results."""


class PhotographEncoding(Protocol):
    """How the levels of a photograph follow from light."""

    @property
    def name(self) -> str:
        """Name of the encoding."""
        ...


class FollowupPhotograph(Protocol):
    """What a series needs to know of a photograph."""

    @property
    def path(self) -> Path:
        """Its file."""
        ...

    @property
    def sha256(self) -> str | None:
        """Of its file."""
        ...

    @property
    def encoding(self) -> PhotographEncoding:
        """How its levels were read."""
        ...

    @property
    def remarks(self) -> dict[str, str]:
        """What is worth saying of that, by kind."""
        ...


Taken = TypeVar("Taken", bound=FollowupPhotograph)
Found = TypeVar("Found")


@dataclass(frozen=True, slots=True, kw_only=True)
class References(ABC, Generic[Taken]):
    """Finds the reference of a follow-up, in any process, and reads follow-ups.

    Parameters
    ----------
    path
        The reference, or the folder of references, absolute.
    name
        The same as it was named by the user, for people.
    kinds
        Kinds of remarks that were made already.
    """

    path: Path
    name: str
    kinds: frozenset[str] = frozenset()

    @property
    @abstractmethod
    def how_read(self) -> str:
        """How photographs are read, as text."""

    @abstractmethod
    def of(self, followup: Path) -> Taken:
        """Read the reference of a follow-up; a `RefusedPhotographError` refuses this one."""

    @abstractmethod
    def followup(self, path: Path) -> Taken:
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

    row: dict[str, Any]
    files: tuple[Path, ...] = ()
    notes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class FollowupWork(ShardWork, Generic[Taken, Found]):
    """Compares follow-ups with their references, in any process.

    Parameters
    ----------
    out
        Folder of the results, absolute.
    references
        What they are compared with.
    provenance
        Of what all follow-ups share.
    """

    listed: ClassVar[type[StoredValues]]
    """A line of the summary; it has at least ``followup``, ``sha256`` and ``refused``."""

    out: Path
    references: References[Taken]
    provenance: Provenance

    @property
    @abstractmethod
    def settings(self) -> dict[str, Any]:
        """What is done, apart from the contents of the files that all follow-ups share."""

    @abstractmethod
    def find(self, near: Taken, photograph: Taken) -> Found:
        """Compare; an `AnalysisError` or `CalibrationError` refuses it."""

    @abstractmethod
    def write(self, photograph: Taken, found: Found) -> Written:
        """Write what was found."""

    def is_current(self, item: SweepItem, record: FollowupRecord) -> bool:
        """Whether what was written still has the right place."""
        return True

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
        """Folder of the commits."""
        return self.out / STATE_NAME

    def found(self, shard: Shard) -> ShardDone | None:
        """What was committed, if of every photograph of the shard."""
        records = [self.record(item) for item in shard.items]
        there = [record for record in records if record is not None]
        if len(there) < len(records) or any(record.is_unread for record in there):
            return None
        return _done(there)

    def __call__(self, shard: Shard) -> ShardDone:
        """Do the photographs of the shard that lack a commit."""
        return _done([self._done_once(item) for item in shard.items])

    def record(self, item: SweepItem) -> FollowupRecord | None:
        """Return the commit of a follow-up, if it is of these very files and settings."""
        record = FollowupRecord.read(self._commit(item))
        if record is None or record.settings != self._settings_hash:
            return None
        if record.item != self._state(item):
            return None
        is_whole = all(size_of(self.out / name) == size for name, size in record.files.items())
        return record if is_whole and self.is_current(item, record) else None

    def provenance_with(self, *photographs: Taken) -> Provenance:
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

    def _state(self, item: SweepItem) -> str:
        """The files as one line, the same only for the same paths, sizes and times."""
        return item.state + self.references.state_for(item.path)

    @property
    def _settings_hash(self) -> str:
        return hashlib.sha256(self.key.encode()).hexdigest()

    def _commit(self, item: SweepItem) -> Path:
        return self.state / f"{item.hash:016x}.json"

    def _done_once(self, item: SweepItem) -> FollowupRecord:
        record = self.record(item)
        if record is None or record.is_unread:
            commit = self._commit(item)
            # Maps of other settings have the same size: a kill among them must not leave this one.
            commit.unlink(missing_ok=True)
            record = self._record_of(item)
            record.write(commit)
        return record

    def _record_of(self, item: SweepItem) -> FollowupRecord:
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
        known = self.references.kinds
        remarks = near.remarks | photograph.remarks | dict(written.notes)
        return FollowupRecord(
            settings=self._settings_hash,
            item=self._state(item),
            row=written.row,
            notes={kind: text for kind, text in remarks.items() if kind not in known},
            files={str(path.relative_to(self.out)): path.stat().st_size for path in written.files},
        )

    def _refusal(self, item: SweepItem, digest: str | None, error: Exception) -> FollowupRecord:
        row = self.listed.model_validate(
            {
                "followup": on_one_line(item.path),
                "sha256": digest,
                "refused": refusal_line(item.path, on_one_line(error)),
            }
        )
        is_unread = isinstance(error, RefusedPhotographError) and error.is_unread
        return FollowupRecord(
            settings=self._settings_hash,
            item=self._state(item),
            row=row.model_dump(mode="json"),
            is_refused=True,
            is_unread=is_unread and item.is_there,
        )


def _done(records: list[FollowupRecord]) -> ShardDone:
    return ShardDone.of(
        (record.row["refused"] if record.is_refused else None, record.notes) for record in records
    )
