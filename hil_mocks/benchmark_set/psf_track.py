"""Track ``psf``: photographs of slanted edges, and of scenes without an edge."""

from dataclasses import dataclass
from typing import Any

from hil_mocks.benchmark_set.charts import Chart, chart_of, truth_along
from hil_mocks.benchmark_set.exposures import Condition
from hil_mocks.benchmark_set.lenses import LENSES, Lens
from hil_mocks.benchmark_set.poses import Pose
from hil_mocks.benchmark_set.streams import stream
from hil_mocks.benchmark_set.tasks import (
    CLEAN,
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

CHART_FRAME = (288, 384)
"""Of edge charts, except in the tiny set."""

LAYOUT = (2, 3)
SIDE_OVER_HEIGHT = 0.22
"""Side of a square over the chart's height."""

CONDITIONS = (
    CLEAN,
    NOISY,
    Condition(name="much noise", gain_e_per_dn=0.8, read_noise_e=16.0),
    Condition(name="gradient"),
    Condition(name="clipped", exposure=1.28),
    Condition(name="jpeg95", jpeg_quality=95),
    Condition(name="jpeg85", jpeg_quality=85),
)
_SLOPES = {"gradient": 0.35, "clipped": 0.25}
"""Light's relative rise over the frame's width: of a clipped chart one part is white."""

PHOTOGRAPH_CONDITIONS = (
    CLEAN,
    NOISY,
    Condition(name="little noise", gain_e_per_dn=12.0),
    Condition(name="jpeg95", gain_e_per_dn=12.0, jpeg_quality=95),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeChart:
    """A photograph of slanted dark squares."""

    name: str
    seed: int
    shape: tuple[int, int]
    lens: Lens
    condition: Condition
    track: str = "psf"
    scene_name: str = ""

    @property
    def chart(self) -> Chart:
        """The squares."""
        rng = stream(self.seed, self.track, self.name, "chart")
        return chart_of(rng, self.shape, LAYOUT, SIDE_OVER_HEIGHT * self.shape[0])

    def rendered(self) -> RenderedTask:
        """See `Task.rendered`."""
        rng = stream(self.seed, self.track, self.name)
        chart = self.chart
        slope = _SLOPES.get(self.condition.name, 0.0)
        lit = gradient(self.shape, slope, float(rng.uniform(0, 360)))
        light = chart_light(chart, self.lens) * lit
        path = f"psf/{self.name}{self.condition.suffix}"
        return RenderedTask(
            files={path: self.condition.stored(light, rng)},
            task={
                "chart": self.name,
                "file": path,
                **self.condition.facts(),
                "kind": "edges",
                "edges": chart.task_edges(),
            },
            truth={
                "kind": "edges",
                "lens": self.lens.facts(),
                "condition": self.condition.name,
                "edges": chart.truth_edges(self.lens),
            },
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class PhotographsWithoutEdge:
    """A photograph of a scene, and a nearer one, by one camera."""

    name: str
    seed: int
    shape: tuple[int, int]
    scene_name: str
    lens: Lens
    condition: Condition
    track: str = "psf"

    @property
    def view(self) -> View:
        """The scene from both poses; the nearer one is the reference."""
        rng = stream(self.seed, self.track, self.name, "pose")
        pose = Pose(
            reference_shape=self.shape,
            followup_shape=self.shape,
            zoom=float(rng.uniform(1.5, 2.4)),
            roll_deg=float(rng.uniform(-4, 4)),
            shift_px=(float(rng.uniform(-8, 8)), float(rng.uniform(-8, 8))),
        )
        return View(scene=self.scene_name, seed=self.seed, lens=self.lens, pose=pose)

    def rendered(self) -> RenderedTask:
        """See `Task.rendered`."""
        rng, view = stream(self.seed, self.track, self.name), self.view
        further, nearer = (f"psf/{self.name}{way}{self.condition.suffix}" for way in ("", "-nearer"))
        truth: dict[str, Any] = {
            "kind": "photographs",
            "lens": self.lens.facts(),
            "condition": self.condition.name,
            "scene": self.scene_name,
            "zoom": view.pose.zoom,
            "edges": {"x": truth_along(self.lens, 0.0), "y": truth_along(self.lens, 90.0)},
        }
        return RenderedTask(
            files={
                further: self.condition.stored(view.followup_light(), rng),
                nearer: self.condition.stored(view.reference_light(), rng),
            },
            task={
                "chart": self.name,
                "file": further,
                "nearer_file": nearer,
                **self.condition.facts(),
                "kind": "photographs",
                "zoom": view.pose.zoom,
                "homography_to_nearer": view.pose.matrix.tolist(),
                "directions": ["x", "y"],
            },
            truth=truth,
        )


def psf_tasks(size: SetSize, seed: int) -> list[Task]:
    """Tasks of the track."""
    rng = stream(seed, "psf", size.name)
    shape = size.frame if size.name == "tiny" else CHART_FRAME
    charts = zip(
        numbered("edges", size.edge_charts),
        spread(rng, LENSES, size.edge_charts),
        spread(rng, CONDITIONS, size.edge_charts),
        strict=True,
    )
    pairs = zip(
        numbered("photographs", size.photographs),
        spread(rng, LENSES, size.photographs),
        spread(rng, PHOTOGRAPH_CONDITIONS, size.photographs),
        spread(rng, size.scenes, size.photographs),
        strict=True,
    )
    return [
        *(
            EdgeChart(name=name, seed=seed, shape=shape, lens=lens, condition=condition)
            for name, lens, condition in charts
        ),
        *(
            PhotographsWithoutEdge(
                name=name,
                seed=seed,
                shape=shape,
                scene_name=seen,
                lens=lens,
                condition=condition,
            )
            for name, lens, condition, seen in pairs
        ),
    ]
