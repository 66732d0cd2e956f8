"""Artefact statistics of very many photographs, as sums: one file a block of a thousand.

A photograph draws no random number and sums are exact, so that the results are the same bits for
any number of workers, after any interruption, and for photographs that came one after the other.

A file holds the SHA-256 of all that follows, one line of JSON, the sums model by model as float64,
and a line for each photograph. It is read one model at a time.
"""

import hashlib
import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from functools import lru_cache
from itertools import groupby, product
from math import ceil, prod, sqrt
from pathlib import Path

import numpy as np

from acquisition.printable import on_one_line
from acquisition.session import clear_parts, commit_file
from acquisition.untrusted import parse_json
from analysis.detectability.artefact import ArtefactTiles
from analysis.detectability.compared import scene_residual
from analysis.detectability.dprime import scene_artefact
from analysis.detectability.scenario import Scenario
from analysis.errors import AnalysisError, RefusedPhotographError
from analysis.sweep import (
    ExactSum,
    Finder,
    KeptItems,
    Manifest,
    Shard,
    ShardDone,
    ShardWork,
    SweepItem,
    is_few,
    on_own_grid,
    refusal_line,
    shard_key,
    sorted_lines,
)
from simulation import Model
from simulation.arrays import FloatArray

_SCHEMA = "standoff.artefact-sums/2"
_NUMBER = np.dtype("<f8")


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

    def add_file(self, file: "SumsFile", model: int | None = None) -> None:
        """Add a file: one model of it, or all."""
        if file.images:
            self._add(file.images, *file.sums(model))

    def terms(self) -> tuple[FloatArray, FloatArray]:
        """Products, of shape (models, terms, ...) whose terms add up to the sums, and pixels."""
        if self._alone is not None:
            return self._alone.products_dn2[:, None], self._alone.pixels
        return np.stack(self._products_dn2.terms(), axis=1), np.asarray(self._pixels)

    def rounded(self) -> ArtefactSums | None:
        """Return the sums as nearest numbers; None if there is no photograph."""
        if self.images == 0 or self._alone is not None:
            return self._alone
        return ArtefactSums(
            products_dn2=self._products_dn2.rounded(), pixels=np.asarray(self._pixels)
        )

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


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredPhotograph:
    """What is kept of each photograph by name; ``item`` is the digest of it as it was on disk."""

    path: str
    sha256: str
    encoding: str
    mean_dn: float
    item: int


@dataclass(frozen=True, slots=True, kw_only=True)
class KeptPhotographs:
    """The photographs of a file of sums.

    ``refused`` has, by their digests, the lines of those that gave nothing, ``notes`` what is
    worth saying of the others.
    """

    work: str
    group: int
    measured: Sequence[MeasuredPhotograph] = ()
    refused: Mapping[int, str] = field(default_factory=dict)
    notes: Mapping[str, str] = field(default_factory=dict)

    @property
    def items(self) -> list[int]:
        """Digests of all."""
        return [*(one.item for one in self.measured), *self.refused]


@dataclass(frozen=True, slots=True, kw_only=True)
class SumsFile:
    """A file of sums: what is in it and where.

    ``work``: hash of what was measured. ``images``: the number of photographs that the sums are
    over. ``shape``: of the products: models, terms, zooms, tiles, n, 2 n - 1. ``first_byte``: where
    the products begin.
    """

    path: Path
    work: str
    group: int
    images: int
    shape: tuple[int, ...]
    first_byte: int

    @classmethod
    def found(cls, path: Path) -> "SumsFile | None":
        """Look for a file; a damaged one, or one of an earlier form, counts as none."""
        try:
            with path.open("rb") as file:
                digest = file.readline()
                whole = file.read()
        except FileNotFoundError:
            return None
        if digest != _digest(whole):
            return None
        line = whole.partition(b"\n")[0]
        header = parse_json(line)
        if header["schema"] != _SCHEMA:
            return None
        return cls(
            path=path,
            work=header["work"],
            group=header["group"],
            images=header["images"],
            shape=tuple(header["shape"]),
            first_byte=len(digest) + len(line) + 1,
        )

    def sums(self, model: int | None = None) -> tuple[list[FloatArray], FloatArray]:
        """Read the terms of the products, and the pixels, of one model or of all."""
        models, _, *rest = self.shape
        first, count = (0, models) if model is None else (model, 1)
        products = self._floats(first * prod(self.shape[1:]), (count, *self.shape[1:]))
        after = prod(self.shape) + first * prod(rest[:2])
        terms = [products[:, number] for number in range(self.shape[1])]
        return terms, self._floats(after, (count, *rest[:2]))

    def photographs(self) -> KeptPhotographs:
        """Read what is kept of each photograph."""
        measured, refused = [], {}
        with self.path.open("rb") as file:
            file.readline()
            notes = json.loads(file.readline())["notes"]
            numbers = prod(self.shape) + self.shape[0] * prod(self.shape[2:4])
            file.seek(self.first_byte + numbers * _NUMBER.itemsize)
            for line in file:
                told = json.loads(line)
                if "refused" in told:
                    refused[told["item"]] = told["refused"]
                else:
                    measured.append(MeasuredPhotograph(**told))
        return KeptPhotographs(
            work=self.work, group=self.group, measured=measured, refused=refused, notes=notes
        )

    def _floats(self, first: int, shape: tuple[int, ...]) -> FloatArray:
        offset = self.first_byte + first * _NUMBER.itemsize
        found = np.fromfile(self.path, dtype=_NUMBER, count=prod(shape), offset=offset)
        return np.asarray(found.reshape(shape), np.float64)


def sums_bytes(sums: SummedPhotographs, kept: KeptPhotographs) -> bytes:
    """Return a file of sums."""
    body, shape = b"", (0,) * 6
    if sums.images:
        products_dn2, pixels = sums.terms()
        body, shape = _stored(products_dn2) + _stored(pixels), products_dn2.shape
    told = [
        *map(asdict, kept.measured),
        *({"item": item, "refused": line} for item, line in kept.refused.items()),
    ]
    body += b"".join(json.dumps(one).encode("ascii") + b"\n" for one in told)
    header = {
        "schema": _SCHEMA,
        "work": kept.work,
        "group": kept.group,
        "images": sums.images,
        "shape": shape,
        "notes": dict(kept.notes),
    }
    whole = json.dumps(header).encode("ascii") + b"\n" + body
    return _digest(whole) + whole


def _joined_files(files: Sequence[SumsFile]) -> bytes:
    """Return the file of several files of one group together."""
    sums, kept = SummedPhotographs(), [file.photographs() for file in files]
    for file in files:
        sums.add_file(file)
    notes: dict[str, str] = {}
    for one in kept:
        notes |= {kind: min(text, notes.get(kind, text)) for kind, text in one.notes.items()}
    return sums_bytes(
        sums,
        KeptPhotographs(
            work=files[0].work,
            group=files[0].group,
            measured=[each for one in kept for each in one.measured],
            refused={item: line for one in kept for item, line in one.refused.items()},
            notes=notes,
        ),
    )


def _digest(data: bytes) -> bytes:
    return hashlib.sha256(data).hexdigest().encode("ascii") + b"\n"


def _stored(values: FloatArray) -> bytes:
    return np.ascontiguousarray(values, dtype=_NUMBER).tobytes()


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
class ArtefactWork(ShardWork):
    """Measures shards and keeps their sums; those of a finished block become one.

    ``load``: photograph of a file, or a RefusedPhotographError; a function that a worker can
    import. ``folder``: absolute path of the folder of the sums.
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
        kept = _KeptSums(manifest, self.folder, self.key_hash)

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
        return _sums_path(self.folder, key)


_IMAGES_MOST = 1024
"""Of one file of sums, which one changed photograph makes useless."""

_SUFFIX = ".sums"
_KEY_LETTERS = 32


def _sums_path(folder: Path, key: str) -> Path:
    """Path of the file of sums with this key."""
    return folder / (key[:_KEY_LETTERS] + _SUFFIX)


def joined(folder: Path, files: Sequence[SumsFile]) -> SumsFile:
    """Replace files of one group by one."""
    names = sorted(file.path.name for file in files)
    path = _sums_path(folder, shard_key((), "\n".join(names)))
    commit_file(path, _joined_files(files))
    for file in files:
        file.path.unlink(missing_ok=True)
    found = SumsFile.found(path)
    if found is None:
        raise AnalysisError(f"{path} vanished or was damaged; run the same command again")
    return found


class _KeptSums:
    """The files of sums that a sweep can use, and the photographs in them.

    ``manifest``: the photographs of the sweep. ``folder, work``: folder of the files, and hash of
    what is measured.
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
    """The sums of a finished sweep: tiles of each of few photographs, 64 groups of many."""

    def __init__(self, manifest: Manifest, work: "ArtefactWork") -> None:
        kept = _KeptSums(manifest, work.folder, work.key_hash)
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
