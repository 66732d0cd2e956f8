"""The commit of one shard of pairs: what was made of each photograph, and how large the files are.

A record is the one thing of a shard that is synchronised with the disk. The files of its pairs are
written before and left to the operating system: after a power cut some that were written in the
last half minute may be missing, empty or short. Their sizes are in the record, so that the next run
makes such a shard again; whoever reads pairs after a power cut runs the command once more first.
"""

from typing import Literal

from pydantic import BaseModel

from analysis.sr_dataset.settings import Split
from analysis.sweep import CommittedRecord, ShardDone


class PairRecord(BaseModel, frozen=True, extra="forbid"):
    """One pair: the files that hold it, with the path in the dataset or the name in a tar file."""

    high: str
    low: str
    high_bytes: int
    low_bytes: int
    top_px: int
    left_px: int


class ImageRecord(BaseModel, frozen=True, extra="forbid"):
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


class TarRecord(BaseModel, frozen=True, extra="forbid"):
    """A tar file with the pairs of a shard in one split."""

    split: Split
    name: str
    size_bytes: int


class ShardRecord(CommittedRecord):
    """What was made of a shard; ``settings`` is the hash of the work's key."""

    format: Literal["standoff.sr-shard/1"] = "standoff.sr-shard/1"
    key: str
    settings: str
    images: tuple[ImageRecord, ...]
    tars: tuple[TarRecord, ...] = ()

    @property
    def done(self) -> ShardDone:
        """Summary for the sweep."""
        return ShardDone.of((image.refused, image.notes) for image in self.images)
