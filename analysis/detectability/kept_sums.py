"""Which files of sums a sweep of many photographs can use, and the sums of all."""

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from functools import lru_cache
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from acquisition.session import clear_parts, commit_file
from analysis.detectability.artefact import ArtefactTiles
from analysis.detectability.sums import (
    ArtefactSums,
    KeptPhotographs,
    MeasuredPhotograph,
    SummedPhotographs,
    SumsFile,
    joined_files,
)
from analysis.errors import AnalysisError
from analysis.sweep import (
    KeptItems,
    Manifest,
    Shard,
    ShardDone,
    SweepItem,
    is_few,
    shard_key,
    sorted_lines,
)

if TYPE_CHECKING:
    from analysis.detectability.sweep import ArtefactWork

_IMAGES_MOST = 1024
"""Of one file of sums, which one changed photograph makes useless."""

_SUFFIX = ".sums"
_KEY_LETTERS = 32


def sums_path(folder: Path, key: str) -> Path:
    """Path of the file of sums with this key."""
    return folder / (key[:_KEY_LETTERS] + _SUFFIX)


def joined(folder: Path, files: Sequence[SumsFile]) -> SumsFile:
    """Replace files of one group by one.

    Raises
    ------
    AnalysisError
        If it vanishes at once.
    """
    names = sorted(file.path.name for file in files)
    path = sums_path(folder, shard_key((), "\n".join(names)))
    commit_file(path, joined_files(files))
    for file in files:
        file.path.unlink(missing_ok=True)
    found = SumsFile.found(path)
    if found is None:
        raise AnalysisError(f"{path} vanished or was damaged; run the same command again")
    return found


class KeptSums:
    """The files of sums that a sweep can use, and the photographs in them.

    Parameters
    ----------
    manifest
        The photographs of the sweep.
    folder, work
        Folder of the files, and hash of what is measured.
    """

    def __init__(self, manifest: Manifest, folder: Path, work: str) -> None:
        paths = sorted(folder.glob(f"*{_SUFFIX}"))
        found = [file for path in paths if (file := SumsFile.found(path)) is not None]
        own = [file for file in found if file.work == work]
        items = [np.array(file.photographs().items, np.uint64) for file in own]
        if is_few(len(manifest)):  # each is a group of its own
            alone = [number for number, one in enumerate(items) if len(one) == 1]
            own, items = [own[one] for one in alone], [items[one] for one in alone]
        self._kept = KeptItems.of(manifest, items)
        self._files = own

    def __len__(self) -> int:
        """Number of photographs, refused ones among them."""
        return len(self._kept)

    @property
    def files(self) -> list[SumsFile]:
        """The files, of which no two hold the same photograph."""
        return [self._files[number] for number in self._kept.usable]

    def of(self, shard: Shard) -> tuple[ShardDone, tuple[SweepItem, ...]]:
        """Return what is kept of a shard, and the photographs that are left to do."""
        given: list[tuple[str | None, Mapping[str, str]]] = []
        left = []
        for item, number in zip(shard.items, self._kept.commits_of(shard.items), strict=True):
            if number is None:
                left.append(item)
            else:
                kept = _photographs(self._files[number])
                line = kept.refused.get(item.digest)
                given.append((line, kept.notes if line is None else {}))
        return ShardDone.of(given), tuple(left)


@lru_cache(maxsize=4)  # a file is asked for by each of its photographs
def _photographs(file: SumsFile) -> KeptPhotographs:
    return file.photographs()


class SweepSums:
    """The sums of a finished sweep: tiles of each of few photographs, 64 groups of many.

    Parameters
    ----------
    manifest, work
        As in the sweep.

    Raises
    ------
    AnalysisError
        If every photograph was refused.
    """

    def __init__(self, manifest: Manifest, work: "ArtefactWork") -> None:
        kept = KeptSums(manifest, work.folder, work.key_hash)
        if len(kept) < len(manifest):
            raise AnalysisError(
                f"sums in {work.folder} vanished or were damaged; run the same command again"
            )
        self._folder = work.folder
        self.images = sum(file.images for file in kept.files)
        if self.images == 0:
            raise AnalysisError("no photograph could be measured")
        self._groups: list[list[SumsFile]]
        if is_few(len(manifest)):
            # As they are listed in a folder.
            paths = {item.digest: item.path for item in manifest}
            by_path = {paths[file.photographs().items[0]]: file for file in kept.files}
            self._groups = [[by_path[path]] for path in sorted(by_path)]
        else:
            in_order = sorted(kept.files, key=lambda file: file.group)
            self._groups = [list(same) for _, same in groupby(in_order, lambda file: file.group)]

    def artefacts(self, model: int) -> list[ArtefactTiles]:
        """Artefact of a model of the plan at each zoom: tiles in a fixed order.

        Beyond the models come the residuals of their comparisons.
        """
        groups = [sums for files in self._groups if (sums := _added(files, model)) is not None]
        zooms = groups[0].pixels.shape[1]
        return [
            ArtefactTiles.joined([sums.artefact(0, zoom) for sums in groups])
            for zoom in range(zooms)
        ]

    def photographs(self) -> Iterator[MeasuredPhotograph]:
        """Read what is kept of each photograph, in the order of their names."""
        lines = (
            f"{json.dumps(asdict(one))}\n".encode("ascii")
            for file in self._files()
            for one in file.photographs().measured
        )
        for line in sorted_lines(lines, self._folder):
            yield MeasuredPhotograph(**json.loads(line))

    def list_copies(self, path: Path) -> int:
        """List the photographs with the content of another one; return how many are too many.

        There is no list of none. Each counts as often as it comes.
        """
        lines = (f"{one.sha256}  {one.path}\n".encode() for one in self.photographs())
        copies = 0
        with path.open("wb") as file:
            by_content = groupby(sorted_lines(lines, path.parent), lambda line: line.split(b" ")[0])
            for _, same in by_content:
                found = list(same)
                if len(found) > 1:
                    copies += len(found) - 1
                    file.writelines(found)
        if copies == 0:
            path.unlink()
        return copies

    def tidy(self) -> None:
        """Join the files of runs that did little, and delete what no photograph needs any more."""
        self._groups = [self._joined(files) for files in self._groups]
        own = {file.path for file in self._files()}
        for path in self._folder.glob(f"*{_SUFFIX}"):
            if path not in own:
                path.unlink(missing_ok=True)
        clear_parts(self._folder)

    def _joined(self, files: list[SumsFile]) -> list[SumsFile]:
        """Join a group's files from the smallest on, as long as they hold few photographs."""
        by_size = sorted(files, key=lambda file: file.images)
        few: list[SumsFile] = []
        while by_size and sum(file.images for file in few) + by_size[0].images <= _IMAGES_MOST:
            few.append(by_size.pop(0))
        if len(few) < 2:
            return files
        return [joined(self._folder, few), *by_size]

    def _files(self) -> Iterator[SumsFile]:
        for files in self._groups:
            yield from files


def _added(files: Sequence[SumsFile], model: int) -> ArtefactSums | None:
    sums = SummedPhotographs()
    for file in files:
        sums.add_file(file, model)
    return sums.rounded()
