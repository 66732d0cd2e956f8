"""Artefact statistics of very many photographs, as sums: one file a block of a thousand.

A photograph draws no random number and sums are made in the order of the shards, so that the
results are the same bits for any number of workers, and after any interruption.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import groupby, product
from math import ceil, sqrt
from pathlib import Path

import numpy as np

from acquisition.printable import on_one_line
from acquisition.session import atomic_write
from analysis.detectability.artefact import ArtefactTiles
from analysis.detectability.compared import scene_residual
from analysis.detectability.dprime import scene_artefact
from analysis.detectability.scenario import Scenario
from analysis.detectability.sums import (
    ArtefactSums,
    MeasuredPhotograph,
    SumsFile,
    added,
    joined_files,
    sums_bytes,
)
from analysis.errors import AnalysisError, RefusedPhotographError
from analysis.sweep import (
    Manifest,
    Shard,
    ShardDone,
    ShardWork,
    blocks_of,
    commit_file,
    is_few,
    refusal_line,
    sorted_lines,
)
from simulation import Model
from simulation.arrays import FloatArray

_VERSION = 5
"""Version of the sums; older ones are measured again."""

_TILES_WANTED = 16
"""Tiles in all that a bootstrap can draw from; sixteen photographs need no tiles."""

_SUFFIX = ".sums"
_KEY_LETTERS = 32


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepPlan:
    """What is measured on every image; ``reading`` states how the files are read.

    ``is_compared`` asks for what a comparison leaves as well, for observer ``changes``: its sums
    follow those of the artefact, model by model.
    """

    scenario: Scenario
    models: tuple[Model, ...]
    zooms: tuple[float, ...]
    tiles_per_side: int
    reading: str = ""
    is_compared: bool = False

    @property
    def key(self) -> str:
        """The plan as text, the same for equal plans."""
        stated = asdict(self)
        if not self.is_compared:  # of which sums of before know nothing
            del stated["is_compared"]
        return json.dumps({"version": _VERSION, **stated}, sort_keys=True)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SceneImage:
    """A photograph as it is measured.

    Parameters
    ----------
    grey_dn
        The image c, shape ``(rows, cols)``, finite.
    sha256
        Of its file.
    encoding
        How its levels were read.
    notes
        What is worth saying of that, by kind.
    """

    grey_dn: FloatArray
    sha256: str
    encoding: str = "linear"
    notes: Mapping[str, str] = field(default_factory=dict)


def tiles_per_side(images: int) -> int:
    """Return the number of tiles along each axis of an image, given the number of images."""
    return ceil(sqrt(_TILES_WANTED / images)) if images < _TILES_WANTED else 1


def scene_sums(scene_dn: FloatArray, plan: SweepPlan) -> ArtefactSums:
    """Measure one image: the artefact of every model and zoom of a plan.

    Parameters
    ----------
    scene_dn
        The image c, grey, shape ``(rows, cols)``, finite.
    plan
        What is measured.

    Raises
    ------
    ValueError
        If the image is too small for a zoom and the window.
    """
    n = plan.scenario.window_px
    products, pixels = [], []
    kinds = (scene_artefact, scene_residual) if plan.is_compared else (scene_artefact,)
    for measured, model in product(kinds, plan.models):
        tiles = [
            measured(scene_dn, plan.scenario, model, zoom, plan.tiles_per_side)
            for zoom in plan.zooms
        ]
        products.append([one.products_dn2[:, :n] for one in tiles])
        pixels.append([one.pixels for one in tiles])
    return ArtefactSums(products_dn2=np.array(products), pixels=np.array(pixels))


@dataclass(frozen=True, slots=True, kw_only=True)
class ArtefactWork(ShardWork):
    """Measures shards and keeps their sums; those of a finished block become one.

    Parameters
    ----------
    plan
        What is measured.
    load
        Photograph of a file, or a RefusedPhotographError; a function that a worker can import.
    folder
        Absolute path of the folder of the sums.
    """

    plan: SweepPlan
    load: Callable[[Path], SceneImage]
    folder: Path

    @property
    def key(self) -> str:
        """See `ShardWork.key`."""
        return self.plan.key

    @property
    def state(self) -> Path:
        """See `ShardWork.state`."""
        return self.folder

    def found(self, shard: Shard) -> ShardDone | None:
        """See `ShardWork.found`."""
        file = SumsFile.found(self._file(shard.block_key)) or SumsFile.found(self._file(shard.key))
        return None if file is None else file.shards().get(shard.number)

    def __call__(self, shard: Shard) -> ShardDone:
        """See `ShardWork.__call__`."""
        sums: ArtefactSums | None = None
        photographs: list[MeasuredPhotograph] = []
        given: list[tuple[str | None, Mapping[str, str]]] = []
        for item in shard.items:
            try:
                scene = self.load(item.path)
                own = scene_sums(scene.grey_dn, self.plan)
            except (RefusedPhotographError, ValueError) as error:
                given.append((refusal_line(item.path, str(error)), {}))
                continue
            sums = added((sums, own))
            given.append((None, scene.notes))
            photographs.append(
                MeasuredPhotograph(
                    path=on_one_line(item.path),
                    sha256=scene.sha256,
                    encoding=scene.encoding,
                    mean_dn=float(scene.grey_dn.mean()),
                )
            )
        done = ShardDone.of(given)
        commit_file(self._file(shard.key), sums_bytes({shard.number: done}, sums, photographs))
        return done

    def commit_block(self, shards: Sequence[Shard]) -> None:
        """See `ShardWork.commit_block`."""
        if len(shards) == 1:
            return
        block = self._file(shards[0].block_key)
        if SumsFile.found(block) is None:
            atomic_write(block, joined_files([self._committed(shard.key) for shard in shards]))
        for shard in shards:
            self._file(shard.key).unlink(missing_ok=True)

    def file_of(self, block: Sequence[Shard]) -> SumsFile:
        """Return the sums of a block that is done."""
        only = len(block) == 1
        return self._committed(block[0].key if only else block[0].block_key)

    def _committed(self, key: str) -> SumsFile:
        path = self._file(key)
        file = SumsFile.found(path)
        if file is None:
            raise AnalysisError(f"{path} vanished or was damaged; run the same command again")
        return file

    def _file(self, key: str) -> Path:
        return self.folder / (key[:_KEY_LETTERS] + _SUFFIX)


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

    def __init__(self, manifest: Manifest, work: ArtefactWork) -> None:
        self._groups: list[list[SumsFile]] = []
        blocks = blocks_of(manifest, work.key)
        if is_few(len(manifest)):
            # As they are listed in a folder; their shards are in no order that one knows.
            alone = sorted(blocks, key=lambda block: block[0].items[0].path)
            self._groups = [[work.file_of(block)] for block in alone]
        else:
            for _, group in groupby(blocks, lambda block: block[0].group):
                self._groups.append([work.file_of(block) for block in group])
        self.images = sum(file.images for file in self._files())
        if self.images == 0:
            raise AnalysisError("no photograph could be measured")

    def artefacts(self, model: int) -> list[ArtefactTiles]:
        """Artefact of a model of the plan at each zoom: tiles in a fixed order.

        Beyond the models come the residuals of their comparisons.
        """
        groups = [
            sums
            for files in self._groups
            if (sums := added(file.sums(model) for file in files)) is not None
        ]
        zooms = groups[0].pixels.shape[1]
        return [
            ArtefactTiles.joined([sums.artefact(0, zoom) for sums in groups])
            for zoom in range(zooms)
        ]

    def photographs(self) -> Iterator[MeasuredPhotograph]:
        """Read what is kept of each photograph, in a fixed order."""
        for file in self._files():
            yield from file.photographs()

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

    def drop_others(self, folder: Path) -> None:
        """Delete sums of photographs or settings that are not in the sweep, and broken writes."""
        own = {file.path for file in self._files()}
        for path in folder.iterdir():
            if path.suffix in {_SUFFIX, ".part"} and path not in own:
                path.unlink(missing_ok=True)

    def _files(self) -> Iterator[SumsFile]:
        for files in self._groups:
            yield from files
