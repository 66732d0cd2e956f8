"""Artefact statistics of very many photographs, as sums: one record for up to a thousand.

A photograph draws no random number and sums are exact, so that the results are the same bits for
any number of workers, after any interruption, and for photographs that came one after the other.
"""

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import groupby, product
from math import ceil, sqrt
from pathlib import Path

import numpy as np

from acquisition.printable import on_one_line
from analysis.detectability.artefact import ArtefactTiles
from analysis.detectability.compared import scene_residual
from analysis.detectability.dprime import scene_artefact
from analysis.detectability.scenario import Scenario
from analysis.detectability.sums import ArtefactSums, StoredSums, SummedPhotographs
from analysis.errors import AnalysisError, RefusedPhotographError
from analysis.sweep import (
    Batch,
    Commit,
    Record,
    Records,
    Stored,
    SweepItem,
    SweepWork,
    group_of,
    is_few,
    merge_notes,
    refusal,
)
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
class MeasuredPhotograph:
    """What is kept of each photograph by name."""

    path: str
    sha256: str
    encoding: str
    mean_dn: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ArtefactWork(SweepWork):
    """Measures photographs and keeps the sums of those of a batch, then of up to a thousand.

    Parameters
    ----------
    plan
        What is measured.
    load
        Photograph of a file, or a RefusedPhotographError; a function that a worker can import.
    folder
        Absolute path of the folder of the sums.
    """

    is_merged = True

    plan: SweepPlan
    load: Callable[[Path], SceneImage]
    folder: Path

    @property
    def key(self) -> str:
        """See `SweepWork.key`."""
        return self.plan.key

    @property
    def state(self) -> Path:
        """See `SweepWork.state`."""
        return self.folder

    def do(self, batch: Batch, commit: Commit) -> None:
        """Measure the photographs of a batch, whose sums are one record."""
        sums = SummedPhotographs()
        measured: list[SweepItem] = []
        rows, refused = [], []
        notes: dict[str, str] = {}
        for item in batch.items:
            try:
                scene = self.load(item.path)
                own = scene_sums(scene.grey_dn, self.plan)
            except (RefusedPhotographError, ValueError) as error:
                refused.append(refusal(item, error))
                continue
            sums.add(own)
            merge_notes(notes, scene.notes)
            measured.append(item)
            row = MeasuredPhotograph(
                path=on_one_line(item.path),
                sha256=scene.sha256,
                encoding=scene.encoding,
                mean_dn=float(scene.grey_dn.mean()),
            )
            rows.append(asdict(row))
        if measured:
            data = sums.stored_bytes()
            refused.append(Record(items=measured, rows=rows, notes=notes, data=data))
        commit(refused)

    def merged(self, parts: Sequence[Stored]) -> bytes:
        """See `SweepWork.merged`."""
        sums = SummedPhotographs()
        for part in parts:
            sums.add_stored(StoredSums.of(part))
        return sums.stored_bytes()


class SweepSums:
    """The sums of a finished sweep: tiles of each of few photographs, 64 groups of many.

    An `AnalysisError` says that every photograph was refused.
    """

    def __init__(self, records: Records) -> None:
        self._records = records
        found = [(first, images, StoredSums.of(one)) for first, images, _, one in records.merged()]
        self.images = sum(images for _, images, _ in found)
        if self.images == 0:
            raise AnalysisError("no photograph could be measured")
        if is_few(len(records.manifest)):
            # As they are listed in a folder.
            paths = {item.hash: item.path for item in records.manifest}
            by_path = sorted(found, key=lambda one: paths[one[0]])
            self._groups = [[sums] for _, _, sums in by_path]
        else:
            self._groups = [
                [sums for _, _, sums in run]
                for _, run in groupby(found, lambda one: group_of(one[0]))
            ]

    def artefacts(self, model: int) -> list[ArtefactTiles]:
        """Artefact of a model of the plan at each zoom: tiles in a fixed order.

        Beyond the models come the residuals of their comparisons.
        """
        groups = []
        for stored in self._groups:
            sums = SummedPhotographs()
            for one in stored:
                sums.add_stored(one, model)
            rounded = sums.rounded()
            assert rounded is not None  # a group has photographs
            groups.append(rounded)
        zooms = groups[0].pixels.shape[1]
        return [
            ArtefactTiles.joined([sums.artefact(0, zoom) for sums in groups])
            for zoom in range(zooms)
        ]

    def photographs(self) -> Iterator[MeasuredPhotograph]:
        """Read what is kept of each photograph, in the order of their names."""
        for answer in self._records.answers(by_path=True):
            if answer.refused is None:
                yield MeasuredPhotograph(**answer.row)

    def list_copies(self, path: Path) -> int:
        """List the photographs with the content of another one; return how many are too many.

        There is no list of none. Each counts as often as it comes.
        """
        database = self._records.manifest.database
        database.execute("drop table if exists contents")
        database.execute("create table contents(sha256 text, path text)")
        database.executemany(
            "insert into contents values(?, ?)",
            ((one.sha256, one.path) for one in self.photographs()),
        )
        copies, before = 0, None
        with path.open("wb") as file:
            for sha256, name in database.execute(
                "select sha256, path from contents where sha256 in (select sha256 from contents "
                "group by sha256 having count(*) > 1) order by sha256, path"
            ):
                copies += sha256 == before
                before = sha256
                file.write(f"{sha256}  {name}\n".encode())
        if copies == 0:
            path.unlink()
        return copies
