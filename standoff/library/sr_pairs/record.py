"""The commit of one shard of pairs: what was made of each photograph, and how large the files are.

A record is the one thing of a shard that is synchronised with the disk. The files of its pairs are
written before and left to the operating system: after a power cut some that were written in the
last half minute may be missing, empty or short. Their sizes are in the record, so that the next run
makes such a shard again; whoever reads pairs after a power cut runs the command once more first.
"""

import json
from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, ValidationError

from acquisition.regular_files import read_regular_file
from acquisition.untrusted import parse_json
from analysis.sweep import ShardDone, commit_file
from standoff.library.sr_pairs.settings import Split


class _Stored(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")


class PairRecord(_Stored):
    """One pair: the files that hold it, with the path in the dataset or the name in a tar file."""

    high: str
    low: str
    high_bytes: int
    low_bytes: int
    top_px: int
    left_px: int


class ImageRecord(_Stored):
    """What was made of one photograph.

    ``order`` sorts photographs by their paths; ``item`` is the photograph as it was on disk.
    ``refused`` says why there are no pairs; ``is_unread`` that this may be another time.
    """

    order: str
    item: str
    name: str
    sha256: str | None = None
    encoding: str | None = None
    split: Split = "train"
    refused: str | None = None
    is_unread: bool = False
    notes: dict[str, str] = {}
    pairs: tuple[PairRecord, ...] = ()


class TarRecord(_Stored):
    """A tar file with the pairs of a shard in one split."""

    split: Split
    name: str
    size_bytes: int


class ShardRecord(_Stored):
    """What was made of a shard; ``settings`` is the hash of the work's key."""

    format: Literal["standoff.sr-shard/1"] = "standoff.sr-shard/1"
    key: str
    settings: str
    images: tuple[ImageRecord, ...]
    tars: tuple[TarRecord, ...] = ()

    @property
    def done(self) -> ShardDone:
        """Summary for the sweep."""
        notes: dict[str, str] = {}
        for image in self.images:
            notes = image.notes | notes
        refused = tuple(image.refused for image in self.images if image.refused is not None)
        return ShardDone(images=len(self.images) - len(refused), refused=refused, notes=notes)

    def write(self, path: Path) -> None:
        """Commit: the contents reach the disk before the name does."""
        # Names of files may hold what UTF-8 does not.
        commit_file(path, json.dumps(self.model_dump()).encode("ascii"))

    @classmethod
    def read(cls, path: Path) -> "ShardRecord | None":
        """Read a record; None if there is none, or none that can be believed."""
        try:
            document: Any = parse_json(read_regular_file(path), has_file_names=True)
            return cls.model_validate(document)
        except (OSError, ValidationError, ValueError):
            return None
