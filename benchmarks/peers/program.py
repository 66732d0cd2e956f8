"""A program that takes part, and what it may answer."""

from collections.abc import Callable
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from typing import TypeAlias

from benchmarks.peers.tasks import TRACKS, Task, Track
from simulation.arrays import FloatArray

CONTRAST_FREQ_CY_PER_PX = (0.1, 0.2, 0.3, 0.4, 0.5)


class PeerError(Exception):
    """A program cannot be run here, or not on this task."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeContrast:
    """Contrast by frequency across one edge, or along x or y; None where it was not measured."""

    edge: str
    mtf50: float | None
    mtf50_standard_error: float | None = None
    contrasts: tuple[float | None, ...] = (None,) * len(CONTRAST_FREQ_CY_PER_PX)


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignedPoints:
    """A homography from follow-up to reference, or where the follow-up's points lie in it."""

    homography: FloatArray | None = None
    points: FloatArray | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChangeScore:
    """Score of every follow-up pixel, NaN where none, and places (x, y) declared changed."""

    score: FloatArray = field(repr=False)
    places: FloatArray | None = None


Answer: TypeAlias = list[EdgeContrast] | FloatArray | AlignedPoints | ChangeScore
Answerer: TypeAlias = Callable[[Task], Answer]


@dataclass(frozen=True, slots=True, kw_only=True)
class Program:
    """One program with what it answers, by track.

    ``given`` says in a sentence what it is, and what it was given; ``packages`` are distributions
    that have to be installed and whose versions are stated, ``modules`` what it imports where no
    distribution tells. A slow one gets only some of the tasks unless one says otherwise.
    """

    name: str
    given: str
    answers: dict[Track, Answerer]
    packages: tuple[str, ...] = ()
    modules: tuple[str, ...] = ()
    is_slow: bool = False

    def __post_init__(self) -> None:
        if unknown := set(self.answers) - set(TRACKS):
            raise ValueError(f"unknown tracks: {', '.join(sorted(unknown))}")

    def missing(self) -> str | None:
        """What has to be installed first, if anything."""
        for package in self.packages:
            try:
                version(package)
            except PackageNotFoundError:
                return package
        return next((name for name in self.modules if find_spec(name) is None), None)

    @property
    def version(self) -> str:
        """Versions of its packages, in words."""
        return ", ".join(f"{package} {version(package)}" for package in self.packages)
