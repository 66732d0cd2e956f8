"""Track ``changes``: two photographs of a scene on which, or not, faint spots were painted."""

from dataclasses import asdict, dataclass, replace
from math import pi, sqrt

import numpy as np
from numpy.typing import NDArray

from hil_mocks.benchmark_set.alignment_track import pose_facts, pose_of
from hil_mocks.benchmark_set.exposures import BLACK_LEVEL_DN, WHITE_DN, Condition, truth_tiff
from hil_mocks.benchmark_set.frames import Grid, pixels, spot_series
from hil_mocks.benchmark_set.lenses import LENSES, Lens, falls_to
from hil_mocks.benchmark_set.poses import Pose
from hil_mocks.benchmark_set.simulation_track import calibration_chart
from hil_mocks.benchmark_set.streams import stream
from hil_mocks.benchmark_set.tasks import (
    NOISY,
    RenderedTask,
    SetSize,
    Task,
    View,
    chart_light,
    gradient,
    numbered,
    spread,
)

KINDS = ("frontal", "tilted", "light", "relief", "distortion", "jpeg", "clipped", "turned")
WIDTHS_PX = (0.8, 1.2, 2.0, 3.0)
FAINTEST, STRONGEST = 0.5, 30.0
"""Peak of a spot behind the camera's blur, over the noise of one pixel."""

MOST_SPOTS = 8
_FROM_BORDER_PX = 14.0
_APART_PX = 22.0
_TRIES = 400
_TYPICAL_LIGHT = 0.42
CONDITIONS = (NOISY, Condition(name="much noise", gain_e_per_dn=1.5, read_noise_e=14.0))

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class PaintedSpot:
    """A Gaussian spot before the camera's blur, in pixels of the follow-up and linear DN."""

    x_px: float
    y_px: float
    sigma_px: float
    amplitude_dn: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ChangedPair:
    """A pair, and its twin of the same ``pair`` number without a change."""

    name: str
    pair: str
    is_changed: bool
    seed: int
    shape: tuple[int, int]
    chart_shape: tuple[int, int]
    scene_name: str
    kind: str
    lens: Lens
    condition: Condition
    track: str = "changes"

    def rendered(self) -> RenderedTask:
        """See `Task.rendered`."""
        shared, rng = (
            stream(self.seed, self.track, self.pair),
            stream(self.seed, self.track, self.name),
        )
        pose = pose_of(shared, self.kind, self.shape, largest_zoom=2.0)
        condition = self._condition(shared)
        lit = self._light(shared)
        view = View(scene=self.scene_name, seed=self.seed, lens=self.lens, pose=pose)
        chart = calibration_chart(shared, self.chart_shape)
        spots = self._spots(rng, pose, condition) if self.is_changed else ()
        before = view.followup_light() * lit
        after = before + spots_light(spots, self.lens, view.followup_grid(), condition)
        folder, suffix = f"changes/{self.name}", condition.suffix
        paths = {of: f"{folder}/{of}{suffix}" for of in ("reference", "followup", "chart")}
        files = {
            paths["reference"]: condition.stored(view.reference_light(), rng),
            paths["followup"]: condition.stored(after, rng),
            paths["chart"]: condition.stored(
                # A chart that is white as a whole would show no edge.
                chart_light(chart, self.lens) * min(1.0, 1 / condition.exposure),
                rng,
            ),
        }
        if self.is_changed:
            change = condition.expected_dn(after) - condition.expected_dn(before)
            files[f"truth/changes/{self.name}.tif"] = truth_tiff(change, np.int16)
        return RenderedTask(
            files=files,
            task={
                "task": self.name,
                **paths,
                "chart_edges": chart.task_edges(),
                **condition.facts(),
                "homography_to_reference": pose.matrix.tolist(),
            },
            truth={
                "changed": self.is_changed,
                "kind": self.kind,
                "pair": self.pair,
                "scene": self.scene_name,
                "lens": self.lens.facts(),
                "condition": condition.name,
                **pose_facts(pose),
                "spots": [asdict(spot) for spot in spots],
            },
        )

    def _condition(self, rng: np.random.Generator) -> Condition:
        if self.kind == "jpeg":
            quality = int(rng.choice([85, 95]))
            return replace(self.condition, name=f"jpeg{quality}", jpeg_quality=quality)
        if self.kind == "clipped":
            exposure = float(rng.uniform(1.7, 2.3))
            return replace(self.condition, name="clipped", exposure=exposure)
        return self.condition

    def _light(self, rng: np.random.Generator) -> FloatArray:
        if self.kind != "light":
            return np.ones(self.shape)
        slope, bearing_deg = float(rng.uniform(0.1, 0.4)), float(rng.uniform(0, 360))
        return float(rng.uniform(0.7, 1.25)) * gradient(self.shape, slope, bearing_deg)

    def _spots(
        self, rng: np.random.Generator, pose: Pose, condition: Condition
    ) -> tuple[PaintedSpot, ...]:
        """Spots apart from one another and from the borders of both frames."""
        rows, cols = self.shape
        typical_dn = BLACK_LEVEL_DN + _TYPICAL_LIGHT * WHITE_DN * condition.exposure
        noise_dn = sqrt(condition.variance_dn2(typical_dn))
        spots: list[PaintedSpot] = []
        for _ in range(_TRIES):
            x = float(rng.uniform(_FROM_BORDER_PX, cols - 1 - _FROM_BORDER_PX))
            y = float(rng.uniform(_FROM_BORDER_PX, rows - 1 - _FROM_BORDER_PX))
            width = float(rng.choice(WIDTHS_PX))
            strength = FAINTEST * (STRONGEST / FAINTEST) ** float(rng.uniform())
            sign = float(rng.choice([-1.0, 1.0]))
            is_apart = all((x - s.x_px) ** 2 + (y - s.y_px) ** 2 > _APART_PX**2 for s in spots)
            if not (is_apart and _is_within(pose, x, y)):
                continue
            peak = strength * noise_dn / behind_blur(self.lens, width)
            spots.append(PaintedSpot(x_px=x, y_px=y, sigma_px=width, amplitude_dn=sign * peak))
            if len(spots) == MOST_SPOTS:
                break
        return tuple(spots)


def _is_within(pose: Pose, x_px: float, y_px: float) -> bool:
    u, v = pose.reference_points(np.array([x_px]), np.array([y_px]))
    rows, cols = pose.reference_shape
    margin = _FROM_BORDER_PX
    return bool(margin < u[0] < cols - 1 - margin and margin < v[0] < rows - 1 - margin)


def behind_blur(lens: Lens, sigma_px: float) -> float:
    """About which part of a spot's peak the camera leaves, by a Gaussian with the same MTF50."""
    sigmas = [0.5 * sqrt(2 * np.log(2)) / (pi * falls_to(lens, 0.5, at)) for at in (0.0, 90.0)]
    return float(np.prod([sigma_px / sqrt(sigma_px**2 + s * s) for s in sigmas]))


def spots_light(
    spots: tuple[PaintedSpot, ...], lens: Lens, grid: Grid, condition: Condition
) -> FloatArray:
    """Light that spots add to a follow-up's pixels; exact."""
    if not spots:
        return np.zeros(grid.shape)
    unit_dn = WHITE_DN * condition.exposure
    series = sum(
        spot_series(grid, spot.x_px, spot.y_px, spot.sigma_px, spot.amplitude_dn / unit_dn)
        for spot in spots
    )
    return pixels(np.asarray(series), lens, grid)


def change_tasks(size: SetSize, seed: int) -> list[Task]:
    """Tasks of the track."""
    rng, pairs = stream(seed, "changes", size.name), size.changes // 2
    choices = zip(
        numbered("pair", pairs),
        spread(rng, size.scenes, pairs),
        spread(rng, KINDS, pairs),
        spread(rng, LENSES, pairs),
        spread(rng, CONDITIONS, pairs),
        strict=True,
    )
    names = iter(numbered("changes", size.changes))
    return [
        ChangedPair(
            name=next(names),
            pair=pair,
            is_changed=is_changed,
            seed=seed,
            shape=size.frame,
            chart_shape=size.chart_frame,
            scene_name=seen,
            kind=kind,
            lens=lens,
            condition=condition,
        )
        for pair, seen, kind, lens, condition in choices
        for is_changed in ((True, False) if rng.uniform() < 0.5 else (False, True))
    ]
