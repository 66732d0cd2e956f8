"""Artefact statistics of very many photographs, as sums: one record for up to a thousand.

A photograph draws no random number and sums are exact, so that the results are the same bits for
any number of workers, after any interruption, and for photographs that came one after the other.

The bytes of a sum are one line of JSON and the numbers model by model as float64; they are read one
model at a time.
"""

import json
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from itertools import groupby, product
from math import ceil, prod, sqrt
from pathlib import Path
from typing import Self

import numpy as np

from acquisition.printable import on_one_line
from analysis.detectability._artefact import ArtefactTiles
from analysis.detectability._compared import scene_residual
from analysis.detectability._dprime import scene_artefact
from analysis.detectability._scenario import Scenario
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
    sorted_lines,
)
from simulation import Model
from simulation.arrays import FloatArray

_NUMBER = np.dtype("<f8")


class ExactSum:
    """The exact sum of finite float64 arrays of one shape, as terms that do not overlap.

    References
    ----------
    J. R. Shewchuk, Adaptive Precision Floating-Point Arithmetic and Fast Robust Geometric
    Predicates, 1997, section 2.
    """

    def __init__(self, terms: Iterable[FloatArray] = ()) -> None:
        self._terms: list[FloatArray] = []
        for term in terms:
            self.add(term)

    def add(self, values: FloatArray) -> None:
        """Add an array, whose terms of no account go to further ones."""
        for number, term in enumerate(self._terms):
            self._terms[number], values = _two_sum(term, values)
        if not self._terms or values.any():
            self._terms.append(values)

    def terms(self) -> list[FloatArray]:
        """Return arrays whose sum is the exact one, each below the last bits of the one before."""
        terms = list(self._terms)
        is_changing = True
        while is_changing:
            is_changing = False
            for number in range(len(terms) - 1, 0, -1):
                upper, lower = _two_sum(terms[number - 1], terms[number])
                is_changing |= not np.array_equal(upper, terms[number - 1], equal_nan=True)
                terms[number - 1], terms[number] = upper, lower
        while len(terms) > 1 and not terms[-1].any():
            terms.pop()
        return terms

    def rounded(self) -> FloatArray:
        """Return the float64 nearest to each sum; of two as near the even one."""
        first, *rest = self.terms()
        if len(rest) < 2:  # of two terms the first is the nearest
            return first
        # Half of a last bit was rounded to even, but what follows it decides.
        twice = 2 * rest[0]
        further = first + twice
        is_further = (rest[0] * rest[1] > 0) & (further - first == twice)
        return np.where(is_further, further, first)


def on_own_grid(values: FloatArray) -> FloatArray:
    """Round to the last bits of the largest of each last two axes, so that sums have few terms."""
    largest = np.abs(values).max(axis=(-2, -1), keepdims=True)
    shift = np.ldexp(3.0, np.frexp(largest)[1])
    return np.asarray((values + shift) - shift)


def _two_sum(one: FloatArray, other: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The rounded sum, and exactly what rounding took from it; D. E. Knuth, 1969, 4.2.2."""
    rounded = one + other
    of_other = rounded - one
    return rounded, (one - (rounded - of_other)) + (other - of_other)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ArtefactSums:
    """Lagged products of the artefact for every model and zoom, of one photograph or of many.

    ``products_dn2`` has the shape (models, zooms, tiles, n, 2 n - 1), the rows of lags from
    -(n - 1) to 0; ``pixels`` the shape (models, zooms, tiles).
    """

    products_dn2: FloatArray
    pixels: FloatArray

    def artefact(self, model: int, zoom: int) -> ArtefactTiles:
        """Artefact for the plan's model and zoom with these indices."""
        half = self.products_dn2[model, zoom]
        # The other half follows from evenness in the lag.
        other = half[:, -2::-1, ::-1]
        return ArtefactTiles(
            products_dn2=np.concatenate([half, other], axis=1), pixels=self.pixels[model, zoom]
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class StoredSums:
    """Sums in a record, over ``images`` photographs.

    ``shape``: of the products: models, terms, zooms, tiles, n, 2 n - 1. ``first_byte``: where the
    products begin in the file.
    """

    stored: Stored
    images: int
    shape: tuple[int, ...]
    first_byte: int

    @classmethod
    def of(cls, stored: Stored) -> Self:
        """Read the line before the numbers."""
        with stored.path.open("rb") as file:
            file.seek(stored.at)
            line = file.readline()
        header = json.loads(line)
        return cls(
            stored=stored,
            images=header["images"],
            shape=tuple(header["shape"]),
            first_byte=stored.at + len(line),
        )

    def sums(self, model: int | None = None) -> tuple[list[FloatArray], FloatArray]:
        """Read the terms of the products, and the pixels, of one model or of all."""
        models, _, *rest = self.shape
        first, count = (0, models) if model is None else (model, 1)
        products = self._floats(first * prod(self.shape[1:]), (count, *self.shape[1:]))
        after = prod(self.shape) + first * prod(rest[:2])
        terms = [products[:, number] for number in range(self.shape[1])]
        return terms, self._floats(after, (count, *rest[:2]))

    def _floats(self, first: int, shape: tuple[int, ...]) -> FloatArray:
        offset = self.first_byte + first * _NUMBER.itemsize
        found = np.fromfile(self.stored.path, dtype=_NUMBER, count=prod(shape), offset=offset)
        return np.asarray(found.reshape(shape), np.float64)


class SummedPhotographs:
    """Sums over photographs that are exact, so that no order of them matters.

    Of one alone they are its own. Those of several are sums of products that were rounded to the
    last bits of the largest, which costs less than working them out did.
    """

    def __init__(self) -> None:
        self.images = 0
        self._alone: ArtefactSums | None = None
        self._products_dn2 = ExactSum()
        self._pixels: FloatArray | float = 0.0

    def add(self, own: ArtefactSums) -> None:
        """Add a photograph."""
        self._add(1, [own.products_dn2], own.pixels)

    def add_stored(self, stored: StoredSums, model: int | None = None) -> None:
        """Add stored sums: one model of them, or all."""
        self._add(stored.images, *stored.sums(model))

    def rounded(self) -> ArtefactSums | None:
        """Return the sums as nearest numbers; None if there is no photograph."""
        if self.images == 0 or self._alone is not None:
            return self._alone
        return ArtefactSums(
            products_dn2=self._products_dn2.rounded(), pixels=np.asarray(self._pixels)
        )

    def stored_bytes(self) -> bytes:
        """Return the sums as bytes, the terms of each model's products together."""
        if self._alone is not None:
            terms, pixels = self._alone.products_dn2[:, None], self._alone.pixels
        else:
            terms = np.stack(self._products_dn2.terms(), axis=1)
            pixels = np.asarray(self._pixels)
        header = json.dumps({"images": self.images, "shape": terms.shape}).encode("ascii")
        numbers = (np.ascontiguousarray(one, dtype=_NUMBER).tobytes() for one in (terms, pixels))
        return b"\n".join([header, b"".join(numbers)])

    def _add(self, images: int, terms: Sequence[FloatArray], pixels: FloatArray) -> None:
        before, self._alone = self._alone, None
        if self.images + images == 1:
            self._alone = ArtefactSums(products_dn2=terms[0], pixels=pixels)
        else:
            for term in () if before is None else (before.products_dn2,):
                self._products_dn2.add(on_own_grid(term))
            for term in map(on_own_grid, terms) if images == 1 else terms:
                self._products_dn2.add(term)
        self._pixels = self._pixels + pixels
        self.images += images


_VERSION = 5
"""Version of the sums; older ones are measured again."""

_TILES_WANTED = 16
"""Tiles in all that a bootstrap can draw from; sixteen photographs need no tiles."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SweepPlan:
    """What is measured on every photograph; ``reading`` states how the files are read.

    With ``is_compared``, the residual of a comparison is measured as well, for observer
    ``changes``: its sums follow those of the artefact, model by model.
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

    ``grey_dn``: the image c, shape ``(rows, cols)``, finite. ``encoding``: how its levels were
    read. ``notes``: what is worth saying of that, by kind. ``colours``: makes the red, green and
    blue levels, shape ``(rows, cols, 3)``, linear in light; None of a grey photograph, or where
    grey levels alone are measured.
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

    ``scene_dn``: the image c, grey, shape ``(rows, cols)``, finite.
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

    ``load``: photograph of a file, or a RefusedPhotographError; a function that a worker can
    import. ``folder``: absolute path of the folder of the sums.
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
