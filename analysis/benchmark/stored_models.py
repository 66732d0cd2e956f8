"""The files of the benchmark, as far as scores need them: tasks, truths, programs' answers.

Fields that are not needed are ignored, so that a later version may add some.
"""

import re
from typing import Annotated, Generic, Literal, Self, TypeVar

from pydantic import AfterValidator, Field, model_validator

from acquisition.files import StoredModel

Track = Literal["psf", "simulation", "alignment", "changes"]
TRACKS: tuple[Track, ...] = ("psf", "simulation", "alignment", "changes")
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
Printable = Annotated[str, AfterValidator(_printable)]
Label = Annotated[Printable, Field(min_length=1, max_length=60)]
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


class ManifestFile(_Stored):
    """Content of one file of a data set."""

    sha256: str
    bytes: int


class Manifest(_Stored):
    """manifest.json: which data set this is, and what its files hold."""

    format: Literal["standoff benchmark"]
    version: Literal["1.0"]
    size: Label
    seed: int
    sha256: Printable = Field(max_length=200)
    files: dict[str, ManifestFile]


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


class PixelNoise(_Stored):
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
    noise: PixelNoise


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
    """What changed between two photographs."""

    changed: bool
    kind: Label
    scene: str
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
    version: Printable = Field(default="", max_length=60)
    note: Printable = Field(default="", max_length=500)
