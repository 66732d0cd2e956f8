"""Makes the pairs of photographs, shard by shard, a file for each photograph."""

import hashlib
import json
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

from pydantic import BaseModel

from acquisition.printable import on_one_line
from acquisition.session import commit_file
from analysis.detectability import SceneImage
from analysis.errors import RefusedPhotographError
from analysis.evaluation.change_pairs.pair_file import pairs_bytes
from analysis.evaluation.change_pairs.random_conditions import ChangePairsTask, labelled_pairs
from analysis.sr_dataset import Split, split_of
from analysis.sweep import (
    CommittedRecord,
    Shard,
    ShardDone,
    ShardWork,
    SweepItem,
    refusal_line,
    size_of,
)
from simulation import Psf

STATE_NAME = "shards"
_NAME_LETTERS = 24
_VERSION = 2
"""Of the pairs; files of others are made again."""


class PairsOfPhotograph(BaseModel, frozen=True, extra="forbid"):
    """What was made of one photograph; ``order`` sorts photographs by their paths.

    ``item`` is the photograph as it was on disk. ``refused`` says why there are no pairs;
    ``is_unread`` that this may be another time.
    """

    order: str
    item: str = ""
    name: str
    sha256: str = ""
    encoding: str = "linear"
    split: Split = "train"
    file: str | None = None
    size_bytes: int = 0
    pairs: int = 0
    refused: str | None = None
    is_unread: bool = False
    notes: dict[str, str] = {}


class PairsRecord(CommittedRecord):
    """The commit of a shard; ``settings`` is the hash of the work's key."""

    format: Literal["standoff.change-pairs-shard/1"] = "standoff.change-pairs-shard/1"
    key: str
    settings: str = ""
    photographs: tuple[PairsOfPhotograph, ...]

    @property
    def done(self) -> ShardDone:
        """Summary for the sweep."""
        return ShardDone.of((one.refused, one.notes) for one in self.photographs)


@dataclass(frozen=True, slots=True, kw_only=True)
class ChangePairsWork(ShardWork):
    """Makes pairs, in any process.

    Parameters
    ----------
    out
        Folder of the data set, absolute.
    task, psf
        What pairs, and the camera's total PSF.
    load
        Photograph of a file, or a RefusedPhotographError; a function that a worker can import.
    reading
        How ``load`` reads, as text.
    """

    out: Path
    task: ChangePairsTask
    psf: Psf | None
    load: Callable[[Path], SceneImage]
    reading: str

    @property
    def key(self) -> str:
        """See `ShardWork.key`."""
        return json.dumps([_VERSION, self.task.model_dump(), repr(self.psf), self.reading])

    @property
    def state(self) -> Path:
        """See `ShardWork.state`."""
        return self.out / STATE_NAME

    def record(self, shard: Shard) -> PairsRecord | None:
        """What was committed of a shard; None if nothing was, or with other settings."""
        record = PairsRecord.read(self._path(shard))
        return record if record is not None and record.key == shard.key else None

    def found(self, shard: Shard) -> ShardDone | None:
        """See `ShardWork.found`."""
        record = self.record(shard)
        if record is None or any(one.is_unread for one in record.photographs):
            return None
        return record.done if all(map(self._is_there, record.photographs)) else None

    def __call__(self, shard: Shard) -> ShardDone:
        """See `ShardWork.__call__`; what an earlier commit has, however cut, is taken from it."""
        earlier = self._earlier(shard)
        photographs = tuple(
            earlier.get(item.state) or self._photograph(item) for item in shard.items
        )
        record = PairsRecord(key=shard.key, settings=self._settings_hash, photographs=photographs)
        record.write(self._path(shard))
        return replace(record.done, found_done=len(earlier))

    @property
    def _settings_hash(self) -> str:
        return hashlib.sha256(self.key.encode()).hexdigest()

    def _earlier(self, shard: Shard) -> dict[str, PairsOfPhotograph]:
        wanted = {item.state for item in shard.items}
        names = (path.stem for path in self.state.glob("*.json"))
        found = {}
        for name in (*shard.others(names), shard.name):
            record = PairsRecord.read(self.state / f"{name}.json")
            if record is not None and record.settings == self._settings_hash:
                for one in record.photographs:
                    if one.item in wanted and one.file is not None and self._is_there(one):
                        found[one.item] = one
        return found

    def _is_there(self, one: PairsOfPhotograph) -> bool:
        return one.file is None or size_of(self.out / one.file) == one.size_bytes

    def _path(self, shard: Shard) -> Path:
        return self.state / f"{shard.name}.json"

    def _photograph(self, item: SweepItem) -> PairsOfPhotograph:
        order, name = json.dumps(os.fspath(item.path)), on_one_line(item.path.name)
        try:
            scene = self.load(item.path)
            levels_dn = scene.grey_dn if scene.colours is None else scene.colours()
            made = list(labelled_pairs(levels_dn, scene.sha256, self.task, self.psf))
        except (RefusedPhotographError, ValueError) as error:
            is_unread = isinstance(error, RefusedPhotographError) and error.is_unread
            return PairsOfPhotograph(
                order=order,
                item=item.state,
                name=name,
                refused=refusal_line(item.path, str(error)),
                is_unread=is_unread and item.is_there,
            )
        split = split_of(scene.sha256, self.task.seed, self.task.test_fraction)
        # Copies of a photograph share its file.
        file = f"{split}/{scene.sha256[:_NAME_LETTERS]}-{self._settings_hash[:8]}.npz"
        content = pairs_bytes(made)
        commit_file(self.out / file, content)
        return PairsOfPhotograph(
            order=order,
            item=item.state,
            name=name,
            sha256=scene.sha256,
            encoding=scene.encoding,
            split=split,
            file=file,
            size_bytes=len(content),
            pairs=len(made),
            notes=dict(scene.notes),
        )
