"""Artefact statistics of very many photographs, as sums: one file a block of a thousand.

A photograph draws no random number and sums are exact, so that the results are the same bits for
any number of workers, after any interruption, and for photographs that came one after the other.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from itertools import product
from math import ceil, sqrt
from pathlib import Path

import numpy as np

from acquisition.printable import on_one_line
from acquisition.session import commit_file
from analysis.detectability.compared import scene_residual
from analysis.detectability.dprime import scene_artefact
from analysis.detectability.kept_sums import KeptSums, joined, sums_path
from analysis.detectability.scenario import Scenario
from analysis.detectability.sums import (
    ArtefactSums,
    KeptPhotographs,
    MeasuredPhotograph,
    SummedPhotographs,
    SumsFile,
    sums_bytes,
)
from analysis.errors import RefusedPhotographError
from analysis.sweep import Finder, Manifest, Shard, ShardDone, ShardWork, refusal_line, shard_key
from simulation import Model
from simulation.arrays import FloatArray

_VERSION = 5
"""Version of the sums; older ones are measured again."""

_TILES_WANTED = 16
"""Tiles in all that a bootstrap can draw from; sixteen photographs need no tiles."""


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
    colours
        Makes the red, green and blue levels, shape ``(rows, cols, 3)``, linear in light; None of
        a grey photograph, or where grey levels alone are measured.
    """

    grey_dn: FloatArray
    sha256: str
    encoding: str = "linear"
    notes: Mapping[str, str] = field(default_factory=dict)
    colours: Callable[[], FloatArray] | None = None


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

    @property
    def key_hash(self) -> str:
        """Hash of the key, which files of sums state."""
        return shard_key((), self.key)

    def found(self, shard: Shard) -> ShardDone | None:
        """See `ShardWork.found`; `finder` is asked in its place, as files may hold a part of it."""
        return None

    def finder(self, manifest: Manifest) -> Finder:
        """See `ShardWork.finder`: whatever files of sums hold, however they were cut."""
        kept = KeptSums(manifest, self.folder, self.key_hash)

        def find(shard: Shard) -> tuple[ShardDone | None, Shard | None]:
            done, left = kept.of(shard)
            if len(left) == len(shard.items):
                return None, shard
            if not left:
                return done, None
            return done, replace(shard, items=left, key=shard_key(left, self.key))

        return find

    def __call__(self, shard: Shard) -> ShardDone:
        """See `ShardWork.__call__`."""
        sums = SummedPhotographs()
        measured: list[MeasuredPhotograph] = []
        refused: dict[int, str] = {}
        given: list[tuple[str | None, Mapping[str, str]]] = []
        for item in shard.items:
            try:
                scene = self.load(item.path)
                own = scene_sums(scene.grey_dn, self.plan)
            except (RefusedPhotographError, ValueError) as error:
                refused[item.digest] = refusal_line(item.path, str(error))
                given.append((refused[item.digest], {}))
                continue
            sums.add(own)
            given.append((None, scene.notes))
            measured.append(
                MeasuredPhotograph(
                    path=on_one_line(item.path),
                    sha256=scene.sha256,
                    encoding=scene.encoding,
                    mean_dn=float(scene.grey_dn.mean()),
                    item=item.digest,
                )
            )
        done = ShardDone.of(given)
        kept = KeptPhotographs(
            work=self.key_hash,
            group=shard.group,
            measured=measured,
            refused=refused,
            notes=done.notes,
        )
        commit_file(self._file(shard.key), sums_bytes(sums, kept))
        return done

    def commit_block(self, shards: Sequence[Shard], fresh: Sequence[Shard]) -> None:
        """See `ShardWork.commit_block`: join what was measured; below 128 each stays alone."""
        if len(shards) > 1 and len(fresh) > 1:
            files = [SumsFile.found(self._file(shard.key)) for shard in fresh]
            joined(self.folder, [file for file in files if file is not None])

    def _file(self, key: str) -> Path:
        return sums_path(self.folder, key)
