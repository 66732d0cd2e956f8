"""Tasks of the benchmark as programs want them, and a program that takes part."""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Literal, TypeAlias, cast, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from simulation.arrays import FloatArray

Track: TypeAlias = Literal["psf", "simulation", "alignment", "changes", "things"]
TRACKS: tuple[Track, ...] = get_args(Track)

LINEAR_MAX_DN = 4095.0
"""Levels of linear pictures, and of what is decoded, end here."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Task:
    """One task of the benchmark in the folder ``data``; ``facts`` is its entry in tasks.json."""

    track: Track
    data: Path
    facts: dict[str, Any]

    @property
    def name(self) -> str:
        """Unique in its track."""
        return str(self.facts["chart" if self.track == "psf" else "task"])

    @property
    def is_linear(self) -> bool:
        """Whether its pictures are linear in light as they are stored."""
        return bool(self.facts["encoding"] == "linear")

    @property
    def homography(self) -> FloatArray:
        """Follow-up pixels (x, y, 1) to those of the reference."""
        return np.array(self.facts["homography_to_reference"], dtype=np.float64)

    def path(self, key: str) -> Path:
        """The file that an entry names."""
        return self.data / str(self.facts[key])

    def stored(self, key: str) -> NDArray[np.uint16] | NDArray[np.uint8]:
        """Levels of a picture as the file holds them."""
        image = cv2.imread(str(self.path(key)), cv2.IMREAD_UNCHANGED)
        if image is None:
            raise FileNotFoundError(f"{self.path(key)}: no picture")
        return cast("NDArray[np.uint16] | NDArray[np.uint8]", image)

    def linear(self, key: str) -> FloatArray:
        """Levels linear in light, to 4095."""
        stored = self.stored(key).astype(np.float64)
        if self.is_linear:
            return stored
        return LINEAR_MAX_DN * srgb_decoded(stored / float(self.facts["max_level"]))

    def in_8_bits(self, key: str) -> NDArray[np.uint8]:
        """A picture as features are looked for in it; a linear one by its percentiles."""
        stored = self.stored(key)
        if stored.dtype == np.uint8:
            return cast("NDArray[np.uint8]", stored)
        return stretched(stored.astype(np.float64))

    def noise_dn(self, level_dn: float) -> float:
        """Standard deviation of a pixel of the linear picture at a level."""
        noise = self.facts["noise"]
        light_dn = max(level_dn - float(self.facts["black_level"]), 0.0)
        variance = noise["variance_at_black_dn2"] + noise["variance_per_dn"] * light_dn
        return float(np.sqrt(variance))


def tasks_of(data: Path, track: Track) -> Iterator[Task]:
    """Yield the tasks of one track, in the order of tasks.json."""
    for facts in json.loads((data / track / "tasks.json").read_text("utf-8"))["tasks"]:
        yield Task(track=track, data=data, facts=facts)


def stretched(image: FloatArray) -> NDArray[np.uint8]:
    """Eight bits between the 0.5 % and 99.5 % percentiles."""
    low, high = np.percentile(image, (0.5, 99.5))
    return np.asarray(np.clip(255 * (image - low) / max(high - low, 1e-9), 0, 255).astype(np.uint8))


def srgb_decoded(encoded: FloatArray) -> FloatArray:
    """Light of sRGB codes, both from 0 to 1 (IEC 61966-2-1:1999, 5.2)."""
    low = encoded / 12.92
    return np.where(encoded <= 0.04045, low, ((encoded + 0.055) / 1.055) ** 2.4)


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """Something listed: where, whether as moved by how much, in a word, and of how many parts."""

    x_px: float
    y_px: float
    is_moved: bool = False
    shift_px: tuple[float, float] | None = None
    what: str | None = None
    parts: int = 1


@dataclass(frozen=True, slots=True, kw_only=True)
class ListedThings:
    """What happened between two photographs, entry by entry."""

    entries: tuple[Entry, ...]


Answer: TypeAlias = list[EdgeContrast] | FloatArray | AlignedPoints | ChangeScore | ListedThings
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
