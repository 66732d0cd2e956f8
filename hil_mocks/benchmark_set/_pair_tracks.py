"""Tracks of two photographs: ``alignment``, and ``changes``, with faint painted spots or not."""

from dataclasses import asdict, dataclass, replace
from math import pi, sqrt
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil_mocks.benchmark_set._camera_tracks import calibration_chart
from hil_mocks.benchmark_set._depth import (
    DEEP_KINDS,
    DeepView,
    Visibility,
    drawn_depths,
    drawn_pose,
)
from hil_mocks.benchmark_set._lenses import LENSES, Lens, falls_to
from hil_mocks.benchmark_set._photographs import (
    BLACK_LEVEL_DN,
    WHITE_DN,
    Condition,
    Grid,
    labels_tiff,
    pixels,
    spot_series,
    truth_tiff,
)
from hil_mocks.benchmark_set._scenes import Bump, Pose, stream
from hil_mocks.benchmark_set._tasks import (
    NOISY,
    PairTask,
    RenderedTask,
    SetSize,
    Task,
    View,
    chart_light,
    gradient,
    numbered,
    spread,
    twins,
)

ALIGNMENT_KINDS = ("frontal", "turned", "tilted", "far", "light", "relief", "distortion", "jpeg")
POINTS = (24, 18)
"""Along x and along y, evenly over the follow-up."""

CONDITIONS = (NOISY, Condition(name="much noise", gain_e_per_dn=1.5, read_noise_e=14.0))
_RELIEF_MM = 12.0
"""Largest elevation; 4 % of the reference's distance."""

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Alignment(PairTask):
    """A reference and a follow-up from a pose that is not told."""

    track = "alignment"
    other_scene: str | None

    def rendered(self) -> RenderedTask:
        """See `Task.rendered`."""
        rng = self.draws()
        pose = _pose_of(rng, self.kind, self.shape)
        view = self.seen_from(pose)
        condition = self.drawn_condition(rng)
        light = self._light(rng)
        other = view if self.other_scene is None else replace(view, scene=self.other_scene)
        paths = [
            f"alignment/{self.name}/{of}{condition.suffix}" for of in ("reference", "followup")
        ]
        files = {
            paths[0]: condition.stored(view.reference_light(), rng),
            paths[1]: condition.stored(other.followup_light() * light, rng),
        }
        points = _grid(self.shape)
        is_related = self.other_scene is None
        return RenderedTask(
            files=files,
            task={
                "task": self.name,
                "reference": paths[0],
                "followup": paths[1],
                **condition.facts(),
                "followup_points": points.tolist(),
            },
            truth={
                "related": is_related,
                "kind": self.kind,
                "scene": self.scene_name,
                "lens": self.lens.facts(),
                "condition": condition.name,
                **({} if is_related else {"followup_scene": self.other_scene}),
                **pose_facts(pose),
                "points": _seen_points(pose, points) if is_related else [],
            },
        )

    def _light(self, rng: np.random.Generator) -> FloatArray:
        if self.kind != "light":
            return np.ones(self.shape)
        gain = float(rng.uniform(0.5, 0.85) if rng.uniform() < 0.5 else rng.uniform(1.1, 1.3))
        return gain * gradient(self.shape, float(rng.uniform(0.2, 0.6)), float(rng.uniform(0, 360)))


def _pose_of(
    rng: np.random.Generator, kind: str, shape: tuple[int, int], largest_zoom: float = 2.6
) -> Pose:
    """Draw a pose of a kind; all kinds are shifted, and turned a little."""
    rows, cols = shape
    pose = Pose(
        reference_shape=shape,
        followup_shape=shape,
        zoom=float(rng.uniform(1.1, largest_zoom)),
        roll_deg=float(rng.uniform(-5, 5)),
        shift_px=(float(rng.uniform(-0.1, 0.1) * cols), float(rng.uniform(-0.1, 0.1) * rows)),
    )
    bearing_deg = float(rng.uniform(0, 360))
    if kind == "turned":
        return replace(pose, roll_deg=float(rng.uniform(10, 180) * rng.choice([-1, 1])))
    if kind == "tilted":
        return replace(pose, tilt_deg=float(rng.uniform(5, 25)), bearing_deg=bearing_deg)
    if kind == "far":
        return replace(pose, zoom=float(rng.uniform(3.2, 4.4)))
    if kind == "distortion":
        k1 = float(rng.uniform(0.02, 0.06) * rng.choice([-1, 1]))
        return replace(pose, k1=k1)
    if kind == "relief":
        # An upright camera straight above would see no parallax of what is at its axis.
        tilt_deg = float(rng.uniform(6, 14))
        return replace(pose, tilt_deg=tilt_deg, bearing_deg=bearing_deg, relief=_relief(rng, shape))
    if kind in DEEP_KINDS:
        return drawn_pose(rng, kind, pose)
    return pose


def pose_facts(pose: Pose) -> dict[str, Any]:
    """Return what the truth says of a pose."""
    return {
        "zoom": pose.zoom,
        "tilt_deg": pose.tilt_deg,
        "roll_deg": pose.roll_deg,
        "k1": pose.k1,
        "homography_to_reference": pose.matrix.tolist(),
        "relief": [
            {"x_px": b.x_px, "y_px": b.y_px, "sigma_px": b.sigma_px, "height_mm": b.height_mm}
            for b in pose.relief
        ],
    }


def _relief(rng: np.random.Generator, shape: tuple[int, int]) -> tuple[Bump, ...]:
    rows, cols = shape
    return tuple(
        Bump(
            x_px=float(rng.uniform(0.15, 0.85) * cols),
            y_px=float(rng.uniform(0.15, 0.85) * rows),
            sigma_px=float(rng.uniform(0.06, 0.12) * cols),
            height_mm=float(rng.uniform(0.35, 1.0) * _RELIEF_MM),
        )
        for _ in range(3)
    )


def _grid(shape: tuple[int, int]) -> FloatArray:
    """Points (x, y), shape (n, 2)."""
    (across, down), (rows, cols) = POINTS, shape
    x = (np.arange(across) + 0.5) * (cols / across) - 0.5
    y = (np.arange(down) + 0.5) * (rows / down) - 0.5
    return np.stack([each.ravel() for each in np.meshgrid(x, y)], axis=1)


def _seen_points(pose: Pose, points: FloatArray) -> list[list[float]]:
    """Points that the reference shows, with their positions there."""
    u, v = pose.reference_points(points[:, 0], points[:, 1])
    rows, cols = pose.reference_shape
    inside = (u >= 0) & (u <= cols - 1) & (v >= 0) & (v <= rows - 1)
    seen: list[list[float]] = np.column_stack([points, u, v])[inside].tolist()
    return seen


def alignment_tasks(size: SetSize, seed: int) -> list[Task]:
    """Tasks of the track."""
    rng, count = stream(seed, "alignment", size.name), size.alignments
    related = spread(rng, ALIGNMENT_KINDS, count - size.unrelated)
    kinds = [*related, *["unrelated"] * size.unrelated]
    seen = spread(rng, size.scenes, count)
    lenses, conditions = spread(rng, LENSES, count), spread(rng, CONDITIONS, count)
    tasks: list[Task] = []
    for number, index in enumerate(rng.permutation(count).tolist()):
        name, kind = numbered("alignment", count)[number], kinds[index]
        others = [other for other in size.scenes if other != seen[number]]
        tasks.append(
            Alignment(
                name=name,
                seed=seed,
                shape=size.frame,
                scene_name=seen[number],
                other_scene=None if kind != "unrelated" else others[index % len(others)],
                kind=kind,
                lens=lenses[number],
                condition=conditions[number],
            )
        )
    return tasks


CHANGE_KINDS = ("frontal", "tilted", "light", "relief", "distortion", "jpeg", "clipped", "turned")
WIDTHS_PX = (0.8, 1.2, 2.0, 3.0)
FAINTEST, STRONGEST = 0.5, 30.0
"""Peak of a spot behind the camera's blur, over the noise of one pixel."""

MOST_SPOTS = 8
_FROM_BORDER_PX = 14.0
_APART_PX = 22.0
_ON_ONE_PX, _ON_ONE_SIGMAS = 4.0, 1.0
"""A spot is on one surface, which both photographs show, within so many px and widths of it."""

_TRIES = 400
_TYPICAL_LIGHT = 0.42


@dataclass(frozen=True, slots=True, kw_only=True)
class _PaintedSpot:
    """A Gaussian spot before the camera's blur, in pixels of the follow-up and linear DN."""

    x_px: float
    y_px: float
    sigma_px: float
    amplitude_dn: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ChangedPair(PairTask):
    """A pair, and its twin of the same ``pair`` number without a change."""

    track = "changes"
    pair: str
    is_changed: bool
    chart_shape: tuple[int, int]

    def rendered(self) -> RenderedTask:
        """See `Task.rendered`."""
        shared, rng = stream(self.seed, self.track, self.pair), self.draws()
        pose = _pose_of(shared, self.kind, self.shape, largest_zoom=2.0)
        condition = self.drawn_condition(shared)
        lit = self._light(shared)
        view = self.seen_from(pose)
        chart = calibration_chart(shared, self.chart_shape)
        seen = view.visibility() if isinstance(view, DeepView) else None
        spots = (
            self._spots(rng, condition, _Canvas(pose=pose, visibility=seen))
            if self.is_changed
            else ()
        )
        before = view.followup_light() * lit
        after = before + _spots_light(spots, self.lens, view.followup_grid(), condition)
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
        depths: dict[str, Any] = {}
        if isinstance(view, DeepView) and seen is not None:
            unseen = f"truth/changes/{self.name}-unseen.tif"
            depths = {"unseen": unseen, "depths": view.facts()}
            files[unseen] = labels_tiff(seen.is_unseen)
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
                **depths,
                "spots": [asdict(spot) for spot in spots],
            },
        )

    def drawn_condition(self, rng: np.random.Generator) -> Condition:
        """See `PairTask.drawn_condition`."""
        if self.kind == "clipped":
            exposure = float(rng.uniform(1.7, 2.3))
            return replace(self.condition, name="clipped", exposure=exposure)
        return PairTask.drawn_condition(self, rng)

    def _light(self, rng: np.random.Generator) -> FloatArray:
        if self.kind != "light":
            return np.ones(self.shape)
        slope, bearing_deg = float(rng.uniform(0.1, 0.4)), float(rng.uniform(0, 360))
        return float(rng.uniform(0.7, 1.25)) * gradient(self.shape, slope, bearing_deg)

    def _spots(
        self, rng: np.random.Generator, condition: Condition, canvas: "_Canvas"
    ) -> tuple[_PaintedSpot, ...]:
        """Spots apart from one another, where both photographs show what they are painted on."""
        rows, cols = self.shape
        typical_dn = BLACK_LEVEL_DN + _TYPICAL_LIGHT * WHITE_DN * condition.exposure
        noise_dn = sqrt(condition.variance_dn2(typical_dn))
        spots: list[_PaintedSpot] = []
        for _ in range(_TRIES):
            x = float(rng.uniform(_FROM_BORDER_PX, cols - 1 - _FROM_BORDER_PX))
            y = float(rng.uniform(_FROM_BORDER_PX, rows - 1 - _FROM_BORDER_PX))
            width = float(rng.choice(WIDTHS_PX))
            strength = FAINTEST * (STRONGEST / FAINTEST) ** float(rng.uniform())
            sign = float(rng.choice([-1.0, 1.0]))
            is_apart = all((x - s.x_px) ** 2 + (y - s.y_px) ** 2 > _APART_PX**2 for s in spots)
            if not (is_apart and canvas.shows(x, y, width)):
                continue
            peak = strength * noise_dn / behind_blur(self.lens, width)
            spots.append(_PaintedSpot(x_px=x, y_px=y, sigma_px=width, amplitude_dn=sign * peak))
            if len(spots) == MOST_SPOTS:
                break
        return tuple(spots)


@dataclass(frozen=True, slots=True, kw_only=True)
class DeepPair(ChangedPair):
    """A pair of a scene with depth, whose things are cut out of another scene."""

    things_scene: str

    def seen_from(self, pose: Pose) -> View:
        """See `Task.seen_from`; twins show the same depths."""
        return DeepView(
            scene=self.scene_name,
            seed=self.seed,
            lens=self.lens,
            pose=pose,
            depths=drawn_depths(
                stream(self.seed, self.track, self.pair, "depths"), self.kind, pose
            ),
            things_scene=self.things_scene,
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Canvas:
    """What spots may be painted on; ``visibility`` is of a scene with depth."""

    pose: Pose
    visibility: Visibility | None

    def shows(self, x_px: float, y_px: float, sigma_px: float) -> bool:
        """Whether both photographs show a spot there, away from their borders."""
        seen = self.visibility
        if seen is None:
            u, v = self.pose.reference_points(np.array([x_px]), np.array([y_px]))
            at_x, at_y = float(u[0]), float(v[0])
        else:
            pixel = round(y_px), round(x_px)
            at_x, at_y = float(seen.x_px[pixel]), float(seen.y_px[pixel])
        rows, cols = self.pose.reference_shape
        margin = _FROM_BORDER_PX
        if not (margin < at_x < cols - 1 - margin and margin < at_y < rows - 1 - margin):
            return False
        return seen is None or seen.shows(x_px, y_px, _ON_ONE_PX + _ON_ONE_SIGMAS * sigma_px)


def behind_blur(lens: Lens, sigma_px: float) -> float:
    """About which part of a spot's peak the camera leaves, by a Gaussian with the same MTF50."""
    sigmas = [0.5 * sqrt(2 * np.log(2)) / (pi * falls_to(lens, 0.5, at)) for at in (0.0, 90.0)]
    return float(np.prod([sigma_px / sqrt(sigma_px**2 + s * s) for s in sigmas]))


def _spots_light(
    spots: tuple[_PaintedSpot, ...], lens: Lens, grid: Grid, condition: Condition
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
    """Tasks of the track: first those of planes and smooth reliefs, then those of deep scenes."""
    rng, pairs = stream(seed, "changes", size.name), size.changes // 2
    names = iter(numbered("changes", size.changes + size.deep_changes))
    of_pairs = iter(numbered("pair", pairs + size.deep_changes // 2))
    tasks: list[Task] = []
    for seen, kind, lens, condition in zip(
        spread(rng, size.scenes, pairs),
        spread(rng, CHANGE_KINDS, pairs),
        spread(rng, LENSES, pairs),
        spread(rng, CONDITIONS, pairs),
        strict=True,
    ):
        pair = next(of_pairs)
        tasks += [
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
            for is_changed in twins(rng)
        ]
    # Drawn by themselves: what they are changes nothing of the tasks before them.
    rng, pairs = stream(seed, "changes", "deep", size.name), size.deep_changes // 2
    for seen, kind, lens, condition in zip(
        spread(rng, size.scenes, pairs),
        spread(rng, DEEP_KINDS, pairs),
        spread(rng, LENSES, pairs),
        spread(rng, CONDITIONS, pairs),
        strict=True,
    ):
        pair = next(of_pairs)
        others = [other for other in size.scenes if other != seen]
        things_scene = others[int(rng.integers(len(others)))]
        tasks += [
            DeepPair(
                name=next(names),
                pair=pair,
                is_changed=is_changed,
                seed=seed,
                shape=size.frame,
                chart_shape=size.chart_frame,
                scene_name=seen,
                things_scene=things_scene,
                kind=kind,
                lens=lens,
                condition=condition,
            )
            for is_changed in twins(rng)
        ]
    return tasks
