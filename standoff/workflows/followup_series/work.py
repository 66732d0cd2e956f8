"""The work on a shard of follow-ups: each is read, compared with the reference and committed.

A follow-up takes about a second. So each has a commit of its own: whatever is killed, at most one
is lost, and a folder that grew is not done anew.
"""

import hashlib
import json
from abc import abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, ClassVar, Generic, TypeVar

from acquisition.printable import on_one_line
from analysis.errors import AnalysisError
from analysis.results_file import StoredValues
from analysis.sweep import Shard, ShardDone, ShardWork, SweepItem
from calibration.errors import CalibrationError
from calibration.provenance import InputFile, Provenance, utc_now
from simulation.arrays import FloatArray
from standoff.errors import ApplicationError, ImageFileError
from standoff.photographs import Inputs, Photograph, ReadOptions, read_image
from standoff.workflows.followup_series.record import FollowupRecord

STATE_NAME = "followups.sweep"
"""Folder of the commits, in the folder of the results."""

Found = TypeVar("Found")


@dataclass(frozen=True, slots=True, kw_only=True)
class Reference:
    """The photograph that all follow-ups are compared with; every process reads it once.

    Parameters
    ----------
    item
        The file.
    name
        The file as it was named by the user, for people.
    shape
        ``(rows, cols)``.
    sha256
        Hash of its bytes, which must be the same for every process.
    reading
        How it is read, and the follow-ups too.
    kinds
        Kinds of remarks that it gave rise to already.
    """

    item: SweepItem
    name: str
    shape: tuple[int, ...]
    sha256: str
    reading: ReadOptions
    kinds: frozenset[str]

    @classmethod
    def of(cls, path: Path, inputs: Inputs) -> "Reference":
        """Read and list a reference.

        Raises
        ------
        ImageFileError
            If it cannot be read.
        """
        photograph = inputs.photograph(path)
        return cls(
            item=SweepItem.on_disk(path),
            name=on_one_line(path),
            shape=photograph.grey_dn.shape,
            sha256=photograph.sha256 or "",
            reading=inputs.options,
            kinds=frozenset(photograph.remarks),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Written:
    """What a follow-up gave: its line in the summary, and files below the folder of results."""

    row: dict[str, Any]
    files: tuple[Path, ...] = ()
    notes: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True, kw_only=True)
class FollowupWork(ShardWork, Generic[Found]):
    """Compares follow-ups with one reference, in any process.

    Parameters
    ----------
    out
        Folder of the results, absolute.
    reference
        The reference.
    provenance
        Of what all follow-ups share.
    """

    listed: ClassVar[type[StoredValues]]
    """A line of the summary; it has at least ``followup``, ``sha256`` and ``refused``."""

    out: Path
    reference: Reference
    provenance: Provenance

    @property
    @abstractmethod
    def settings(self) -> dict[str, Any]:
        """What is done, apart from the contents of the files that all follow-ups share."""

    @abstractmethod
    def find(self, near: FloatArray, photograph: Photograph) -> Found:
        """Compare; an `ImageFileError`, `AnalysisError` or `CalibrationError` refuses it."""

    @abstractmethod
    def write(self, photograph: Photograph, found: Found) -> Written:
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
        settings = {"reading": str(self.reference.reading), **self.settings}
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
        if record is None or (record.settings, record.item) != (self._settings_hash, item.state):
            return None
        is_whole = all(_size_of(self.out / name) == size for name, size in record.files.items())
        return record if is_whole and self.is_current(item, record) else None

    def provenance_with(self, photograph: Photograph) -> Provenance:
        """Return the provenance of what one follow-up gave."""
        shared, own = self.provenance.encoding, photograph.encoding.name
        encodings = tuple(dict.fromkeys([*([shared] if isinstance(shared, str) else shared), own]))
        listed = InputFile(path=on_one_line(photograph.path), sha256=photograph.sha256 or "")
        return self.provenance.model_copy(
            update={
                "created": utc_now(),
                "inputs": (*self.provenance.inputs, listed),
                "encoding": encodings[0] if len(encodings) == 1 else encodings,
            }
        )

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
        near = _levels(self.reference)
        digest = None
        try:
            photograph = read_image(item.path, self.reference.reading)
            digest = photograph.sha256
            found = self.find(near, photograph)
        except (AnalysisError, CalibrationError, ImageFileError) as error:
            self.discard(item)
            return self._refusal(item, digest, error)
        written = self.write(photograph, found)
        known = self.reference.kinds
        remarks = photograph.remarks | dict(written.notes)
        return FollowupRecord(
            settings=self._settings_hash,
            item=item.state,
            row=written.row,
            notes={kind: text for kind, text in remarks.items() if kind not in known},
            files={str(path.relative_to(self.out)): path.stat().st_size for path in written.files},
        )

    def _refusal(self, item: SweepItem, digest: str | None, error: Exception) -> FollowupRecord:
        text, name = on_one_line(error), on_one_line(item.path)
        row = self.listed.model_validate(
            {
                "followup": name,
                "sha256": digest,
                "refused": text if name in text else f"{name}: {text}",
            }
        )
        return FollowupRecord(
            settings=self._settings_hash,
            item=item.state,
            row=row.model_dump(mode="json"),
            is_refused=True,
            is_unread=isinstance(error.__cause__, OSError) and item.is_there,
        )


def _done(records: list[FollowupRecord]) -> ShardDone:
    refused = tuple(record.row["refused"] for record in records if record.is_refused)
    notes: dict[str, str] = {}
    for record in records:
        notes = record.notes | notes
    return ShardDone(images=len(records) - len(refused), refused=refused, notes=notes)


@lru_cache(maxsize=1)
def _levels(reference: Reference) -> FloatArray:
    photograph = read_image(reference.item.path, reference.reading)
    if photograph.sha256 != reference.sha256:
        raise ApplicationError(f"{reference.name} is not the file that it was at the start")
    return photograph.grey_dn


def _size_of(path: Path) -> int | None:
    try:
        return path.stat().st_size
    except OSError:
        return None
