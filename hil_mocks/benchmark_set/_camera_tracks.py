"""Tracks ``psf``, photographs with and without edges, and ``simulation``, from further away."""

from dataclasses import dataclass
from math import floor

import numpy as np

from hil_mocks.benchmark_set._lenses import LENSES
from hil_mocks.benchmark_set._photographs import (
    STEPS_PER_DN,
    Chart,
    Condition,
    chart_of,
    truth_along,
    truth_tiff,
)
from hil_mocks.benchmark_set._scenes import Pose, stream
from hil_mocks.benchmark_set._tasks import (
    CLEAN,
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
)

CHART_FRAME = (288, 384)
"""Of edge charts, except in the tiny set."""

LAYOUT = (2, 3)
SIDE_OVER_HEIGHT = 0.22
"""Side of a square over the chart's height."""

CHART_CONDITIONS = (
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
class EdgeChart(Task):
    """A photograph of slanted dark squares."""

    track = "psf"

    @property
    def chart(self) -> Chart:
        """The squares."""
        return calibration_chart(self.draws("chart"), self.shape)

    def rendered(self) -> RenderedTask:
        """See `Task.rendered`."""
        rng, chart = self.draws(), self.chart
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
class PhotographsWithoutEdge(Task):
    """A photograph of a scene, and a nearer one, by one camera."""

    track = "psf"

    @property
    def view(self) -> View:
        """The scene from both poses; the nearer one is the reference."""
        rng = self.draws("pose")
        return self.seen_from(
            Pose(
                reference_shape=self.shape,
                followup_shape=self.shape,
                zoom=float(rng.uniform(1.5, 2.4)),
                roll_deg=float(rng.uniform(-4, 4)),
                shift_px=(float(rng.uniform(-8, 8)), float(rng.uniform(-8, 8))),
            )
        )

    def rendered(self) -> RenderedTask:
        """See `Task.rendered`."""
        rng, view = self.draws(), self.view
        further, nearer = (
            f"psf/{self.name}{way}{self.condition.suffix}" for way in ("", "-nearer")
        )
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
            truth={
                "kind": "photographs",
                "lens": self.lens.facts(),
                "condition": self.condition.name,
                "scene": self.scene_name,
                "zoom": view.pose.zoom,
                "edges": {"x": truth_along(self.lens, 0.0), "y": truth_along(self.lens, 90.0)},
            },
        )


def psf_tasks(size: SetSize, seed: int) -> list[Task]:
    """Tasks of the track."""
    rng = stream(seed, "psf", size.name)
    shape = size.frame if size.name == "tiny" else CHART_FRAME
    charts = zip(
        numbered("edges", size.edge_charts),
        spread(rng, LENSES, size.edge_charts),
        spread(rng, CHART_CONDITIONS, size.edge_charts),
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


TILTED_PART = 0.72
"""Side of a tilted follow-up over that of an upright one, so that the reference shows it all."""

SIMULATION_KINDS = ("frontal", "frontal", "tilted")
SIMULATION_CONDITIONS = (
    Condition(name="little noise", gain_e_per_dn=12.0),
    NOISY,
    Condition(name="much noise", gain_e_per_dn=1.5, read_noise_e=14.0),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulation(PairTask):
    """A reference, a chart by the same camera, and where the follow-up would stand."""

    track = "simulation"
    chart_shape: tuple[int, int]

    @property
    def view(self) -> View:
        """The scene from both poses."""
        return self.seen_from(self._pose(self.draws("pose")))

    def rendered(self) -> RenderedTask:
        """See `Task.rendered`."""
        rng, view = self.draws(), self.view
        chart, pose = calibration_chart(rng, self.chart_shape), view.pose
        folder = f"simulation/{self.name}"
        files = {
            f"{folder}/reference.tif": self.condition.stored(view.reference_light(), rng),
            f"{folder}/chart.tif": self.condition.stored(chart_light(chart, self.lens), rng),
            f"truth/simulation/{self.name}.tif": truth_tiff(
                self.condition.expected_dn(view.followup_light()), np.uint16
            ),
        }
        known = {"kind": self.kind, "zoom": pose.zoom}
        return RenderedTask(
            files=files,
            task={
                "task": self.name,
                "reference": f"{folder}/reference.tif",
                "chart": f"{folder}/chart.tif",
                "chart_edges": chart.task_edges(),
                **self.condition.facts(),
                "followup_shape": list(pose.followup_shape),
                "homography_to_reference": pose.matrix.tolist(),
                **known,
            },
            truth={
                **known,
                "tilt_deg": pose.tilt_deg,
                "scene": self.scene_name,
                "lens": self.lens.facts(),
                "condition": self.condition.name,
            },
        )

    def _pose(self, rng: np.random.Generator) -> Pose:
        zoom = float(rng.uniform(1.1, 3.0 if self.kind == "frontal" else 2.2))
        part = 0.92 if self.kind == "frontal" else TILTED_PART
        rows, cols = (floor(part * n / zoom) for n in self.shape)
        is_tilted = self.kind == "tilted"
        room = [0.04 * n for n in self.shape]
        return Pose(
            reference_shape=self.shape,
            followup_shape=(rows, cols),
            zoom=zoom,
            tilt_deg=float(rng.uniform(5, 25)) if is_tilted else 0.0,
            bearing_deg=float(rng.uniform(0, 360)) if is_tilted else 0.0,
            roll_deg=float(rng.uniform(-6, 6)) if is_tilted else 0.0,
            shift_px=(
                float(rng.uniform(-room[1], room[1])),
                float(rng.uniform(-room[0], room[0])),
            ),
        )


def calibration_chart(rng: np.random.Generator, shape: tuple[int, int]) -> Chart:
    """Chart from which a method may calibrate the camera of a task."""
    return chart_of(rng, shape, LAYOUT, SIDE_OVER_HEIGHT * shape[0])


def simulation_tasks(size: SetSize, seed: int) -> list[Task]:
    """Tasks of the track."""
    rng, count = stream(seed, "simulation", size.name), size.simulations
    choices = zip(
        numbered("simulation", count),
        spread(rng, size.scenes, count),
        spread(rng, SIMULATION_KINDS, count),
        spread(rng, LENSES, count),
        spread(rng, SIMULATION_CONDITIONS, count),
        strict=True,
    )
    return [
        Simulation(
            name=name,
            seed=seed,
            shape=size.frame,
            chart_shape=size.chart_frame,
            scene_name=seen,
            kind=kind,
            lens=lens,
            condition=condition,
        )
        for name, seen, kind, lens, condition in choices
    ]


LEVELS = {"levels_per_dn": STEPS_PER_DN}
"""What the truth of the track says beside that of its tasks."""
