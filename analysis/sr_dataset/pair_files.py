"""Where the pairs of a shard are written: image files in folders, or a tar file for each split."""

import json
import tarfile
from contextlib import ExitStack
from io import BytesIO
from pathlib import Path
from types import TracebackType
from typing import Any, Protocol, Self

from acquisition.session import whole_file
from analysis.sr_dataset.encoded_pairs import EncodedPair
from analysis.sr_dataset.record import ImageRecord, PairRecord, ShardRecord, TarRecord
from analysis.sr_dataset.settings import SPLITS, Split


class PairFiles(Protocol):
    """Takes the pairs of one shard; a context, in which an error leaves no half of a tar file."""

    def add(self, split: Split, pair: EncodedPair, facts: dict[str, Any]) -> PairRecord:
        """Write a pair; ``facts`` is what the dataset's manifest says of it, but for its files."""
        ...

    def copy(self, image: ImageRecord, record: ShardRecord) -> None:
        """Take the pairs of a photograph over from an earlier commit that has them."""
        ...

    def finished(self) -> tuple[TarRecord, ...]:
        """Give the files their names; called once, when all pairs are written."""
        ...

    def __enter__(self) -> Self: ...

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None: ...


class ImageFiles(PairFiles):
    """Two image files for each pair, ``split/high/key.png`` and ``split/low/key.png``.

    They are written in place: no manifest lists one before its shard is committed.
    """

    def __init__(self, out: Path) -> None:
        self._out = out

    def add(self, split: Split, pair: EncodedPair, facts: dict[str, Any]) -> PairRecord:
        """Write both images."""
        high, low = (f"{split}/{side}/{pair.key}{pair.suffix}" for side in ("high", "low"))
        (self._out / high).write_bytes(pair.high)
        (self._out / low).write_bytes(pair.low)
        return _record(pair, high, low)

    def copy(self, image: ImageRecord, record: ShardRecord) -> None:
        """Leave them where they are."""

    def finished(self) -> tuple[TarRecord, ...]:
        """Return no tar file."""
        return ()

    def __exit__(self, *_: object) -> None:
        """Leave all as it is."""

    def __enter__(self) -> Self:
        return self


class TarFiles(PairFiles):
    """A tar file for each split, as the library webdataset reads them.

    A pair has the members ``key.high.png``, ``key.low.png`` and ``key.json``. The headers hold
    neither time nor owner, so that the same pairs are the same bytes.
    """

    def __init__(self, folder: Path, name: str) -> None:
        self._folder = folder
        self._names: dict[Split, str] = {split: f"{name}-{split}.tar" for split in SPLITS}
        self._sources: dict[str, tarfile.TarFile] = {}
        self._open: dict[Split, tarfile.TarFile] = {}
        self._files = ExitStack()

    def add(self, split: Split, pair: EncodedPair, facts: dict[str, Any]) -> PairRecord:
        """Append the members of a pair."""
        # What follows the first dot of a member's name is its extension.
        key = pair.key.replace(".", "_")
        high, low = (f"{key}.{side}{pair.suffix}" for side in ("high", "low"))
        self._append(split, high, pair.high)
        self._append(split, f"{key}.json", json.dumps(facts).encode("ascii"))
        self._append(split, low, pair.low)
        return _record(pair, high, low)

    def copy(self, image: ImageRecord, record: ShardRecord) -> None:
        """Append the members of its pairs as the earlier tar file has them."""
        (name,) = (tar.name for tar in record.tars if tar.split == image.split)
        if name not in self._sources:
            opened = tarfile.TarFile.open(self._folder / name, mode="r:")
            self._sources[name] = self._files.enter_context(opened)
        source = self._sources[name]
        for pair in image.pairs:
            key = pair.high.partition(".")[0]
            for member in (pair.high, f"{key}.json", pair.low):
                stored = source.extractfile(member)
                assert stored is not None  # a file, as `add` wrote it
                self._append(image.split, member, stored.read())

    def _append(self, split: Split, name: str, data: bytes) -> None:
        if split not in self._open:
            file = self._files.enter_context(whole_file(self._folder / self._names[split]))
            self._open[split] = self._files.enter_context(
                tarfile.TarFile(fileobj=file, mode="w", format=tarfile.GNU_FORMAT)
            )
        member = tarfile.TarInfo(name)
        member.size = len(data)
        self._open[split].addfile(member, BytesIO(data))

    def finished(self) -> tuple[TarRecord, ...]:
        """Return the tar files."""
        self._files.close()
        return tuple(
            TarRecord(
                split=split,
                name=self._names[split],
                size_bytes=(self._folder / self._names[split]).stat().st_size,
            )
            for split in SPLITS
            if split in self._open
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._files.__exit__(kind, error, trace)


def _record(pair: EncodedPair, high: str, low: str) -> PairRecord:
    return PairRecord(
        high=high,
        low=low,
        high_bytes=len(pair.high),
        low_bytes=len(pair.low),
        top_px=pair.top_px,
        left_px=pair.left_px,
    )
