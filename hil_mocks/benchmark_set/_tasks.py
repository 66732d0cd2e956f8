"""What the tracks share: sizes of the set, a task that renders itself, photographs of scenes."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import cos, radians, sin
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from hil_mocks.benchmark_set._lenses import Lens
from hil_mocks.benchmark_set._photographs import Chart, Condition, Grid, Series, pixels, sampled
from hil_mocks.benchmark_set._scenes import SCENES, Pose, Positions, scene, stream

FloatArray = NDArray[np.float64]
T = TypeVar("T")

SAMPLES_PER_PX = {2.2: 8, 3.2: 12, 5.0: 16}
"""By the largest zoom: the detail of a scene is finer from further away."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SetSize:
    """How large a set is.

    ``frame`` and ``chart_frame`` are ``(rows, cols)`` of photographs and of the charts beside them;
    ``variants`` is the number of scenes of a kind, ``kinds`` that of the kinds; ``deep_changes`` is
    that of the pairs with depth beyond the ``changes``, ``lone_things`` that of the pairs without a
    twin beyond the ``things``.
    """

    name: str
    frame: tuple[int, int]
    chart_frame: tuple[int, int]
    kinds: int
    variants: int
    edge_charts: int
    photographs: int
    simulations: int
    alignments: int
    unrelated: int
    changes: int
    deep_changes: int
    things: int
    lone_things: int

    @property
    def scenes(self) -> list[str]:
        """Names of all scenes."""
        kinds = list(SCENES)[: self.kinds]
        return [f"{kind}-{n}" for n in range(1, self.variants + 1) for kind in kinds]


SIZES = {
    "tiny": SetSize(
        name="tiny",
        frame=(112, 144),
        chart_frame=(112, 144),
        kinds=3,
        variants=1,
        edge_charts=3,
        photographs=1,
        simulations=3,
        alignments=7,
        unrelated=1,
        changes=6,
        deep_changes=4,
        things=4,
        lone_things=2,
    ),
    "small": SetSize(
        name="small",
        frame=(240, 320),
        chart_frame=(192, 256),
        kinds=len(SCENES),
        variants=2,
        edge_charts=40,
        photographs=24,
        simulations=72,
        alignments=90,
        unrelated=12,
        changes=96,
        deep_changes=32,
        things=64,
        lone_things=12,
    ),
    "full": SetSize(
        name="full",
        frame=(384, 512),
        chart_frame=(240, 320),
        kinds=len(SCENES),
        variants=6,
        edge_charts=160,
        photographs=96,
        simulations=288,
        alignments=360,
        unrelated=48,
        changes=384,
        deep_changes=128,
        things=128,
        lone_things=24,
    ),
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RenderedTask:
    """A task as the set holds it: its files by path, what it says, and the truth."""

    files: dict[str, bytes] = field(repr=False)
    task: dict[str, Any]
    truth: dict[str, Any]


def spread(rng: np.random.Generator, values: Sequence[T], count: int) -> list[T]:
    """Values in random order, each as often as the others but for one."""
    made: list[T] = []
    while len(made) < count:
        made.extend(values[index] for index in rng.permutation(len(values)).tolist())
    return made[:count]


def numbered(prefix: str, count: int) -> list[str]:
    """Names of a track's tasks."""
    return [f"{prefix}-{number:03d}" for number in range(1, count + 1)]


def twins(rng: np.random.Generator) -> tuple[bool, bool]:
    """Which of two twins is changed."""
    return (True, False) if rng.uniform() < 0.5 else (False, True)


def chart_light(chart: Chart, lens: Lens) -> FloatArray:
    """Light on the pixels of a chart's photograph."""
    grid = Grid(rows=chart.shape[0], cols=chart.shape[1], band_cy_per_px=lens.band_cy_per_px)
    return pixels(chart.series(grid), lens, grid)


@dataclass(frozen=True, slots=True, kw_only=True)
class View:
    """A scene before a lens, seen from a pose; ``seed`` is that of the set."""

    scene: str
    seed: int
    lens: Lens
    pose: Pose

    def reference_light(self) -> FloatArray:
        """Light on the reference's pixels."""
        grid = self._grid(self.pose.reference_shape, 1.0)
        return pixels(self._series(grid, self.pose.seen_by_reference), self.lens, grid)

    def followup_grid(self) -> Grid:
        """Frequencies of the follow-up."""
        return self._grid(self.pose.followup_shape, self.pose.zoom)

    def series_on(self, grid: Grid) -> Series:
        """Fourier series of what the follow-up's camera looks at."""
        return self._series(grid, self.pose.seen_by_followup)

    def followup_light(self) -> FloatArray:
        """Light on the follow-up's pixels."""
        grid = self.followup_grid()
        return pixels(self.series_on(grid), self.lens, grid)

    def _grid(self, shape: tuple[int, int], zoom: float) -> Grid:
        return Grid(
            rows=shape[0],
            cols=shape[1],
            band_cy_per_px=self.lens.band_cy_per_px,
            per_px=next(count for most, count in SAMPLES_PER_PX.items() if zoom <= most),
        )

    def _series(self, grid: Grid, seen: Callable[[FloatArray, FloatArray], Positions]) -> Series:
        known = scene(self.scene, self.pose.reference_shape, self.seed)
        return sampled(lambda x, y: known.at(*seen(x, y)), grid)


@dataclass(frozen=True, slots=True, kw_only=True)
class Task(ABC):
    """One task of a track, whose name is unique there; ``shape`` is ``(rows, cols)`` of a frame."""

    track: ClassVar[str]
    name: str
    seed: int
    shape: tuple[int, int]
    lens: Lens
    condition: Condition
    scene_name: str = ""  # what is seen, by which tasks are ordered

    @abstractmethod
    def rendered(self) -> RenderedTask:
        """Render all files."""

    def draws(self, *names: str) -> np.random.Generator:
        """Random numbers of the task, or of a part of it."""
        return stream(self.seed, self.track, self.name, *names)

    def seen_from(self, pose: Pose) -> View:
        """The scene from both poses."""
        return View(scene=self.scene_name, seed=self.seed, lens=self.lens, pose=pose)


@dataclass(frozen=True, slots=True, kw_only=True)
class PairTask(Task):
    """A task on a reference and a follow-up of some kind."""

    kind: str

    def drawn_condition(self, rng: np.random.Generator) -> Condition:
        """The condition as the kind has it."""
        if self.kind != "jpeg":
            return self.condition
        quality = int(rng.choice([85, 95]))
        return replace(self.condition, name=f"jpeg{quality}", jpeg_quality=quality)


def gradient(shape: tuple[int, int], slope: float, bearing_deg: float) -> FloatArray:
    """Light that rises by ``slope`` over the frame's width, and is 1 at its middle."""
    rows, cols = shape
    y, x = np.arange(rows)[:, None] - (rows - 1) / 2, np.arange(cols)[None] - (cols - 1) / 2
    along = cos(radians(bearing_deg)) * x + sin(radians(bearing_deg)) * y
    return np.asarray(1 + slope / cols * along)


NOISY = Condition(name="noise")
CLEAN = Condition(name="clean", gain_e_per_dn=None)
"""No noise but that of rounding."""
