"""A data set of the benchmark as it is read: its manifest, its tasks and truth, and its pictures.

Fields that are not needed are ignored, so that a later version may add some.
"""

import re
from hashlib import sha256
from pathlib import Path
from typing import Annotated, Generic, Literal, Self, TypeVar

import cv2
import numpy as np
from pydantic import AfterValidator, BaseModel, Field, model_validator

from acquisition.files import StoredModel
from acquisition.regular_files import LARGEST_IMAGE_BYTES, read_regular_file
from acquisition.untrusted import TiffDamageError, parse_json, read_tiff
from analysis.errors import ResultsFileError
from calibration.documents import fitted
from simulation.arrays import Float32Array

Track = Literal["psf", "simulation", "alignment", "changes", "things"]
TRACKS: tuple[Track, ...] = ("psf", "simulation", "alignment", "changes", "things")
FREQUENCIES = ("0.1", "0.2", "0.3", "0.4", "0.5")
"""Of the MTF, in cycles/px, as they are written in the names of columns."""

_MOST_PLACES = 100_000
_MOST_SIDE_PX = 20_000
_FARTHEST = 1e9
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9._-]{0,120}", re.ASCII)


def _plain_name(name: str) -> str:
    if _NAME.fullmatch(name) is None:
        raise ValueError(f"{name[:60]!r} is no name of letters, digits and ._-")
    return name


def _printable(text: str) -> str:
    if not text.isprintable():
        raise ValueError("holds letters that cannot be printed")
    return text


Name = Annotated[str, AfterValidator(_plain_name)]
_Printable = Annotated[str, AfterValidator(_printable)]
Label = Annotated[_Printable, Field(min_length=1, max_length=60)]
Coordinate = Annotated[float, Field(ge=-_FARTHEST, le=_FARTHEST)]
Place = tuple[Coordinate, Coordinate]
Matrix = tuple[
    tuple[Coordinate, Coordinate, Coordinate],
    tuple[Coordinate, Coordinate, Coordinate],
    tuple[Coordinate, Coordinate, Coordinate],
]
Places = Annotated[list[Place], Field(max_length=_MOST_PLACES)]
Side = Annotated[int, Field(ge=1, le=_MOST_SIDE_PX)]


class _Stored(StoredModel, allow_inf_nan=False):
    """Whose numbers are finite."""


class _ManifestFile(_Stored):
    """Content of one file of a data set."""

    sha256: str
    bytes: int


class Manifest(_Stored):
    """manifest.json: which data set this is, and what its files hold."""

    format: Literal["standoff benchmark"]
    version: Literal["1.0", "1.1"]
    size: Label
    seed: int
    sha256: _Printable = Field(max_length=200)
    files: dict[str, _ManifestFile]


class Lens(_Stored):
    """The kind of a camera's lens."""

    kind: Label


class TrueEdge(_Stored):
    """Contrast along an edge's normal, or along x or y of a photograph."""

    mtf50: float | None = Field(default=None, gt=0)
    mtf: dict[str, float] = {}  # noqa: RUF012 - pydantic copies it

    @model_validator(mode="before")
    @classmethod
    def _gather(cls, content: object) -> object:
        if not isinstance(content, dict):
            return content
        columns = {name: content.get(f"mtf_{name}") for name in FREQUENCIES}
        return content | {"mtf": {key: one for key, one in columns.items() if one is not None}}


class TrueChart(_Stored):
    """What a chart shows."""

    kind: Literal["edges", "photographs"]
    lens: Lens
    condition: Label
    edges: dict[str, TrueEdge]


class PsfTruth(_Stored):
    """truth/psf.json."""

    charts: dict[Name, TrueChart]


class SimulationTask(_Stored):
    """A photograph to simulate from another pose."""

    task: Name
    reference: str
    followup_shape: tuple[Side, Side]
    homography_to_reference: Matrix


class TrueSimulation(_Stored):
    """What a simulated photograph is of."""

    kind: Label
    zoom: float = Field(gt=0, le=_FARTHEST)
    scene: str
    lens: Lens
    condition: Label


class SimulationTruth(_Stored):
    """truth/simulation.json."""

    levels_per_dn: float = Field(gt=0, le=_FARTHEST)
    tasks: dict[Name, TrueSimulation]


class AlignmentTask(_Stored):
    """A pair of photographs to align."""

    task: Name
    followup_points: Places


class TrueAlignment(_Stored):
    """Where points of the follow-up are in the reference."""

    related: bool
    kind: Label
    scene: str
    points: Annotated[
        list[tuple[Coordinate, Coordinate, Coordinate, Coordinate]], Field(max_length=_MOST_PLACES)
    ] = []  # noqa: RUF012 - pydantic copies it


class AlignmentTruth(_Stored):
    """truth/alignment.json."""

    tasks: dict[Name, TrueAlignment]


class _PixelNoise(_Stored):
    """Variance of a level in DN², at the black level and for each DN above it."""

    variance_at_black_dn2: float = Field(ge=0, le=_FARTHEST)
    variance_per_dn: float = Field(ge=0, le=_FARTHEST)


class ChangesTask(_Stored):
    """A pair of photographs, half of which have changes."""

    task: Name
    followup: str
    encoding: Literal["linear", "srgb"]
    max_level: float = Field(gt=0, le=_FARTHEST)
    black_level: float = Field(default=0.0, ge=0, le=_FARTHEST)
    noise: _PixelNoise


Task = TypeVar("Task", SimulationTask, AlignmentTask, ChangesTask)


class TaskList(_Stored, Generic[Task]):
    """tasks.json of a track."""

    track: Track
    tasks: list[Task]

    @model_validator(mode="after")
    def _check(self) -> Self:
        names = [one.task for one in self.tasks]
        if len(set(names)) < len(names):
            raise ValueError("two tasks have one name")
        return self

    @property
    def by_name(self) -> dict[str, Task]:
        """The tasks, each by its name."""
        return {one.task: one for one in self.tasks}


class TrueSpot(_Stored):
    """A painted Gaussian spot, in follow-up pixels and linear DN before the camera's blur."""

    x_px: Coordinate
    y_px: Coordinate
    sigma_px: float = Field(gt=0, le=1000)
    amplitude_dn: float


class TrueChanges(_Stored):
    """What changed between two photographs.

    ``unseen`` is a picture of the set, 1 where the reference does not show what the follow-up does.
    """

    changed: bool
    kind: Label
    scene: str
    unseen: str | None = None
    spots: Annotated[list[TrueSpot], Field(max_length=_MOST_PLACES)] = []  # noqa: RUF012 - as above

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.spots and not self.changed:
            raise ValueError("a pair that is not changed has no spots")
        return self


class ChangesTruth(_Stored):
    """truth/changes.json."""

    levels_per_dn: float = Field(default=16.0, gt=0, le=_FARTHEST)
    tasks: dict[Name, TrueChanges]


class TrueThing(_Stored):
    """What happened to a thing."""

    what: Literal["gone", "new", "moved", "colour"]


class TrueThings(_Stored):
    """What happened between two photographs.

    ``labels`` is a picture of the set: the number of the thing, from 1, at the follow-up's pixels
    where it was or is, and 0 elsewhere. ``mirrored``: no camera sees both photographs.
    """

    changed: bool
    mirrored: bool = False
    kind: Label
    scene: str
    labels: str | None = None
    things: Annotated[list[TrueThing], Field(max_length=255)] = []  # noqa: RUF012 - as above

    @model_validator(mode="after")
    def _check(self) -> Self:
        if not self.changed == bool(self.things) == (self.labels is not None):
            raise ValueError("only changed pairs have things and labels, and they must have both")
        return self


class ThingsTruth(_Stored):
    """truth/things.json."""

    tasks: dict[Name, TrueThings]


class GivenEntry(_Stored):
    """An entry of a program's list: a place in the follow-up, and what happened there."""

    x_px: Coordinate
    y_px: Coordinate
    what: Literal["gone", "new", "moved", "colour", "brighter", "darker"] | None = None


class GivenThings(_Stored):
    """A program's answer to a pair: its list, or that the two cannot be compared."""

    entries: Annotated[list[GivenEntry], Field(max_length=_MOST_PLACES)] | None = None
    refused: bool | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        if (self.entries is not None) == bool(self.refused):
            raise ValueError('give one of "entries" and "refused": true')
        return self


class GivenAlignment(_Stored):
    """A program's answer to a pair: a homography, places of the points, or that there is none."""

    homography_to_reference: Matrix | None = None
    reference_points: Places | None = None
    refused: bool | None = None

    @model_validator(mode="after")
    def _check(self) -> Self:
        given = (self.homography_to_reference, self.reference_points, self.refused or None)
        if sum(one is not None for one in given) != 1:
            raise ValueError(
                'give one of "homography_to_reference", "reference_points" and "refused": true'
            )
        return self


class About(_Stored):
    """about.json: the program that wrote a folder of results."""

    name: Label
    version: _Printable = Field(default="", max_length=60)
    note: _Printable = Field(default="", max_length=500)


Shape = tuple[int, int]


def file_bytes(path: Path, most_bytes: int = LARGEST_IMAGE_BYTES) -> bytes:
    """Read a file.

    Raises
    ------
    ResultsFileError
        If it cannot be read.
    """
    try:
        return read_regular_file(path, most_bytes)
    except OSError as error:
        raise ResultsFileError(f"cannot read {path}: {error.strerror}", source=str(path)) from error


def grey_levels(data: bytes, path: Path, shape: Shape | None = None) -> Float32Array:
    """Return the levels of a grey TIFF; NaN are pixels without one.

    Parameters
    ----------
    data
        Content of the file.
    path
        Its name, for errors.
    shape
        The shape that it must have, (rows, cols); any if None.

    Raises
    ------
    ResultsFileError
        If it is damaged, in colour, of another shape, or holds infinite levels.
    """
    try:
        levels = read_tiff(data, first_alone=True, shape=shape).images[0]
    except TiffDamageError as error:
        raise ResultsFileError(
            f"{path}: {error}; write a grey TIFF of the follow-up's shape", source=str(path)
        ) from error
    if levels.ndim != 2 or levels.dtype.kind not in "fiu":
        raise ResultsFileError(
            f"{path}: shape {levels.shape} of {levels.dtype.name}, expected rows and columns of "
            "grey levels, float32 or integers",
            source=str(path),
        )
    with np.errstate(over="ignore"):  # is infinite then, and refused
        grey = levels.astype(np.float32)
    if np.isinf(grey).any():
        raise ResultsFileError(
            f"{path}: contains infinite levels; write NaN where there is none", source=str(path)
        )
    return grey


MANIFEST_NAME = "manifest.json"

_REMEDY = "make the data set again with standoff benchmark make"
_Model = TypeVar("_Model", bound=BaseModel)


class _Named(BaseModel):
    """A truth, as far as its tasks are counted."""

    tasks: dict[str, object]


class BenchmarkData:
    """The folder of a data set.

    Parameters
    ----------
    folder
        With its manifest.json.

    Raises
    ------
    ResultsFileError
        If the manifest cannot be read, or is none.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        path = folder / MANIFEST_NAME
        self.manifest = document(file_bytes(path), path, Manifest)

    def has(self, track: Track) -> bool:
        """Whether there are tasks of a track."""
        return f"truth/{track}.json" in self.manifest.files

    def tasks_of(self, track: Track) -> int:
        """Return how many tasks a track has.

        Raises
        ------
        ResultsFileError
            If their truth is not that of the manifest, or does not fit.
        """
        return len(self.read(f"truth/{track}.json", _Named).tasks)

    def read(self, name: str, model: type[_Model]) -> _Model:
        """Read one of its JSON files.

        Raises
        ------
        ResultsFileError
            If it is not that of the manifest, or does not fit.
        """
        return document(self._bytes(name), self.folder / name, model)

    def levels(self, name: str, shape: Shape | None = None) -> Float32Array:
        """Read one of its linear pictures, shape (rows, cols), in the levels of its file.

        Raises
        ------
        ResultsFileError
            If it is not that of the manifest, or of another shape.
        """
        return grey_levels(self._bytes(name), self.folder / name, shape)

    def encoded(self, name: str) -> Float32Array:
        """Read one of its sRGB pictures, shape (rows, cols), in the levels of its file.

        Raises
        ------
        ResultsFileError
            If it is not that of the manifest, or no picture.
        """
        data = np.frombuffer(self._bytes(name), np.uint8)
        levels = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE)
        if levels is None:
            raise self._refused(name, f"is not a picture; {_REMEDY}")
        return np.asarray(levels, np.float32)

    def _bytes(self, name: str) -> bytes:
        stated = self.manifest.files.get(name)
        if stated is None:
            raise self._refused(name, f"is not in {MANIFEST_NAME}; {_REMEDY}")
        # A name that leaves the folder could name any file of the machine.
        if Path(name).is_absolute() or ".." in Path(name).parts:
            raise self._refused(name, f"lies outside of the data set; {_REMEDY}")
        data = file_bytes(self.folder / name)
        if sha256(data).hexdigest() != stated.sha256:
            raise self._refused(name, f"is not the file that {MANIFEST_NAME} names; {_REMEDY}")
        return data

    def _refused(self, name: str, problem: str) -> ResultsFileError:
        return ResultsFileError(f"{self.folder / name} {problem}", source=str(self.folder / name))


def document(data: bytes, path: Path, model: type[_Model]) -> _Model:
    """Return the content of a JSON file as its model.

    Raises
    ------
    ResultsFileError
        If it is no JSON, repeats a key, or does not fit.
    """
    try:
        content = parse_json(data, has_single_keys=True)
    except ValueError as error:
        raise ResultsFileError(f"{path}: not JSON: {error}", source=str(path)) from error
    return fitted(content, model, ResultsFileError, str(path))
