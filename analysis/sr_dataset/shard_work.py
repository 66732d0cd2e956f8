"""The work on one shard: its photographs are read, cut into pairs, written and committed."""

import hashlib
import json
import os
from collections.abc import Sequence
from dataclasses import dataclass
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
        record = ShardRecord.read(record_path(self.state, shard.number))
        if record is None or record.key != shard.key:
            return None
        if any(image.is_unread for image in record.images):
            return None
        tars_are_there = all(
            size_of(self.state / tar.name) == tar.size_bytes for tar in record.tars
        )
        if not tars_are_there or not all(map(self._files_are_there, record.images)):
            return None
        return record.done

    def __call__(self, shard: Shard) -> ShardDone:
        """Make all pairs; of a shard with further photographs those that it lacks."""
        path = record_path(self.state, shard.number)
        earlier = self._earlier(path)
        with self._files(shard.number) as files:
            images = tuple(
                earlier[item.state] if item.state in earlier else self._image(item, files)
                for item in shard.items
            )
            tars = files.finished()
        record = ShardRecord(key=shard.key, settings=self._settings_hash, images=images, tars=tars)
        record.write(path)
        return record.done

    def commit_block(self, shards: Sequence[Shard]) -> None:
        """List the shards of the sweep; their records stay."""
        with self.committed.open("a", encoding="ascii") as file:
            file.writelines(f"{shard.number:016x}\n" for shard in shards)

    @property
    def _settings_hash(self) -> str:
        return hashlib.sha256(self.key.encode()).hexdigest()

    def _files(self, number: int) -> PairFiles:
        if self.settings.format == "webdataset":
            return TarFiles(self.state, number)
        return ImageFiles(self.out)

    def _earlier(self, path: Path) -> dict[str, ImageRecord]:
        """Photographs of the shard that an earlier run did; of tar files none can be kept."""
        record = ShardRecord.read(path)
        if record is None or record.settings != self._settings_hash or record.tars:
            return {}
        return {
            image.item: image
            for image in record.images
            if image.pairs and self._files_are_there(image)
        }

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


def record_path(state: Path, number: int) -> Path:
    """Path of the record of the shard with this number."""
    return state / f"{number:016x}.json"
