"""Track ``alignment``: where the follow-up's pixels are in the reference, or that they are not."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hil_mocks.benchmark_set.exposures import Condition
from hil_mocks.benchmark_set.lenses import LENSES, Lens
from hil_mocks.benchmark_set.poses import Bump, Pose
from hil_mocks.benchmark_set.streams import stream
from hil_mocks.benchmark_set.tasks import (
    NOISY,
    RenderedTask,
    SetSize,
    Task,
    View,
    gradient,
    numbered,
    spread,
)

KINDS = ("frontal", "turned", "tilted", "far", "light", "relief", "distortion", "jpeg")
POINTS = (24, 18)
"""Along x and along y, evenly over the follow-up."""

CONDITIONS = (NOISY, Condition(name="much noise", gain_e_per_dn=1.5, read_noise_e=14.0))
_RELIEF_MM = 12.0
"""Largest elevation; 4 % of the reference's distance."""

FloatArray = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Alignment:
    """A reference and a follow-up from a pose that is not told."""

    name: str
    seed: int
    shape: tuple[int, int]
    scene_name: str
    other_scene: str | None
    kind: str
    lens: Lens
    condition: Condition
    track: str = "alignment"

    def rendered(self) -> RenderedTask:
        """See `Task.rendered`."""
        rng = stream(self.seed, self.track, self.name)
        pose = pose_of(rng, self.kind, self.shape)
        view = View(scene=self.scene_name, seed=self.seed, lens=self.lens, pose=pose)
        condition = self._condition(rng)
        light = self._light(rng)
        other = view if self.other_scene is None else replace(view, scene=self.other_scene)
        paths = [f"alignment/{self.name}/{of}{condition.suffix}" for of in ("reference", "followup")]
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

    def _condition(self, rng: np.random.Generator) -> Condition:
        if self.kind != "jpeg":
            return self.condition
        quality = int(rng.choice([85, 95]))
        return replace(self.condition, name=f"jpeg{quality}", jpeg_quality=quality)

    def _light(self, rng: np.random.Generator) -> FloatArray:
        if self.kind != "light":
            return np.ones(self.shape)
        gain = float(rng.uniform(0.5, 0.85) if rng.uniform() < 0.5 else rng.uniform(1.1, 1.3))
        return gain * gradient(self.shape, float(rng.uniform(0.2, 0.6)), float(rng.uniform(0, 360)))


def pose_of(
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
    return np.column_stack([points, u, v])[inside].tolist()


def alignment_tasks(size: SetSize, seed: int) -> list[Task]:
    """Tasks of the track."""
    rng, count = stream(seed, "alignment", size.name), size.alignments
    related = spread(rng, KINDS, count - size.unrelated)
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
