"""The work on one shard: its photographs are read, cut into pairs, written and committed."""

import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import Any

from acquisition.printable import on_one_line
from analysis.errors import RefusedPhotographError
from analysis.sr_dataset.encoded_pairs import encoded_pairs
from analysis.sr_dataset.pair_files import ImageFiles, PairFiles, TarFiles
from analysis.sr_dataset.photograph import PairPhotograph, PairReader
from analysis.sr_dataset.record import ImageRecord, PairRecord, ShardRecord
from analysis.sr_dataset.settings import Split, SrDatasetSettings, split_of
from analysis.sweep import Shard, ShardDone, ShardWork, SweepItem, refusal_line, size_of

STATE_NAME = "shards"
RECORD_SUFFIX = ".json"


@dataclass(frozen=True)
class PairShards(ShardWork):
    """Makes the pairs of a dataset, in any process.

    Parameters
    ----------
    out
        Folder of the dataset, absolute.
    settings, read
        How pairs are made, and what reads photographs.
    committed
        File in which the numbers of the sweep's committed shards are listed, one a line.
    """

    out: Path
    settings: SrDatasetSettings
    read: PairReader
    committed: Path

    @property
    def key(self) -> str:
        """The dataset's settings as text."""
        return json.dumps(self.settings.document(), sort_keys=True)

    @property
    def state(self) -> Path:
        """Folder of the records and tar files."""
        return self.out / STATE_NAME

    def found(self, shard: Shard) -> ShardDone | None:
        """What was committed, if its files are still there and every photograph could be read."""
        record = ShardRecord.read(record_path(self.state, shard.name))
        if record is None or record.key != shard.key:
            return None
        if any(image.is_unread for image in record.images):
            return None
        if not tars_are_there(self.state, record):
            return None
        if not all(map(self._files_are_there, record.images)):
            return None
        return record.done

    def __call__(self, shard: Shard) -> ShardDone:
        """Make the pairs that no earlier commit has, however that was cut."""
        earlier = self._earlier(shard)
        found_done = 0
        with self._files(shard.name) as files:
            images = []
            for item in shard.items:
                kept = earlier.get(item.state)
                if kept is None:
                    images.append(self._image(item, files))
                else:
                    files.copy(*kept)
                    images.append(kept[0])
                    found_done += 1
            tars = files.finished()
        record = ShardRecord(
            key=shard.key, settings=self._settings_hash, images=tuple(images), tars=tars
        )
        record.write(record_path(self.state, shard.name))
        return replace(record.done, found_done=found_done)

    def commit_block(self, shards: Sequence[Shard], fresh: Sequence[Shard]) -> None:
        """List the shards of the sweep; their records stay."""
        with self.committed.open("a", encoding="ascii") as file:
            file.writelines(f"{shard.name}\n" for shard in shards)

    @property
    def _settings_hash(self) -> str:
        return hashlib.sha256(self.key.encode()).hexdigest()

    def _files(self, name: str) -> PairFiles:
        if self.settings.format == "webdataset":
            return TarFiles(self.state, name)
        return ImageFiles(self.out)

    def _earlier(self, shard: Shard) -> dict[str, tuple[ImageRecord, ShardRecord]]:
        """Photographs that earlier runs did, by their states, each with the record that it is in.

        Commits of the same photographs cut in another way have other names.
        """
        wanted = {item.state for item in shard.items}
        found = {}
        for name in (*shard.others(_names_in(self.state, self.committed)), shard.name):
            record = ShardRecord.read(record_path(self.state, name))
            if record is None or record.settings != self._settings_hash:
                continue
            if not tars_are_there(self.state, record):
                continue
            for image in record.images:
                if image.item in wanted and image.pairs and self._files_are_there(image):
                    found[image.item] = image, record
        return found

    def _files_are_there(self, image: ImageRecord) -> bool:
        if self.settings.format == "webdataset":
            return True
        return all(
            size_of(self.out / name) == size
            for pair in image.pairs
            for name, size in ((pair.high, pair.high_bytes), (pair.low, pair.low_bytes))
        )

    def _image(self, item: SweepItem, files: PairFiles) -> ImageRecord:
        image = ImageRecord(
            order=json.dumps(os.fspath(item.path)), item=item.state, name=item.path.name
        )
        try:
            photograph = self.read(item.path)
            split = split_of(photograph.sha256, self.settings.seed, self.settings.test_fraction)
            pairs = self._pairs(photograph, split, files)
        except (RefusedPhotographError, ValueError) as error:
            is_unread = isinstance(error, RefusedPhotographError) and error.is_unread
            return image.model_copy(
                update={
                    "refused": refusal_line(item.path, str(error)),
                    "is_unread": is_unread and item.is_there,
                }
            )
        return image.model_copy(
            update={
                "sha256": photograph.sha256,
                "encoding": photograph.encoding,
                "split": split,
                "notes": {**photograph.notes, **self._note_on_field(photograph)},
                "pairs": tuple(pairs),
            }
        )

    def _pairs(
        self, photograph: PairPhotograph, split: Split, files: PairFiles
    ) -> list[PairRecord]:
        facts: dict[str, Any] = {
            "split": split,
            "image": photograph.path.name,
            "image_sha256": photograph.sha256,
            "encoding": photograph.encoding,
        }
        # All are made before one is written: a photograph gives all of its pairs, or none.
        return [
            files.add(split, pair, {**facts, "top_px": pair.top_px, "left_px": pair.left_px})
            for pair in list(encoded_pairs(photograph, self.settings))
        ]

    def _note_on_field(self, photograph: PairPhotograph) -> dict[str, str]:
        field = self.settings.field
        if field is None or self.settings.psf_of(photograph.stored) is field:
            return {}
        sentence = (
            f"{on_one_line(photograph.path)}: the PSF's field belongs to frames of "
            f"{field.width_px} x {field.height_px} px; one PSF is used"
        )
        return {"field": sentence}


def record_path(state: Path, name: str) -> Path:
    """Path of the record of the shard with this name."""
    return state / f"{name}{RECORD_SUFFIX}"


def tars_are_there(state: Path, record: ShardRecord) -> bool:
    """Whether the tar files of a record are as they were written."""
    return all(size_of(state / tar.name) == tar.size_bytes for tar in record.tars)


@lru_cache(maxsize=1)
def _names_in(state: Path, run: Path) -> tuple[str, ...]:
    """Names of the shards that were there when this process began with the run."""
    return tuple(path.stem for path in state.glob(f"*{RECORD_SUFFIX}"))
