"""Track ``simulation``: predict the photograph from further away, given one from here."""

from dataclasses import dataclass
from math import floor

import numpy as np

from hil_mocks.benchmark_set.charts import Chart, chart_of
from hil_mocks.benchmark_set.exposures import STEPS_PER_DN, Condition, truth_tiff
from hil_mocks.benchmark_set.lenses import LENSES, Lens
from hil_mocks.benchmark_set.poses import Pose
from hil_mocks.benchmark_set.streams import stream
from hil_mocks.benchmark_set.tasks import (
    NOISY,
    RenderedTask,
    SetSize,
    Task,
    View,
    chart_light,
    numbered,
    spread,
)

_CHART_LAYOUT = (2, 3)
_CHART_SIDE_OVER_HEIGHT = 0.22
TILTED_PART = 0.72
"""Side of a tilted follow-up over that of an upright one, so that the reference shows it all."""

KINDS = ("frontal", "frontal", "tilted")
CONDITIONS = (
    Condition(name="little noise", gain_e_per_dn=12.0),
    NOISY,
    Condition(name="much noise", gain_e_per_dn=1.5, read_noise_e=14.0),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Simulation:
    """A reference, a chart by the same camera, and where the follow-up would stand."""

    name: str
    seed: int
    shape: tuple[int, int]
    chart_shape: tuple[int, int]
    scene_name: str
    kind: str
    lens: Lens
    condition: Condition
    track: str = "simulation"

    @property
    def view(self) -> View:
        """The scene from both poses."""
        pose = self._pose(stream(self.seed, self.track, self.name, "pose"))
        return View(scene=self.scene_name, seed=self.seed, lens=self.lens, pose=pose)

    def rendered(self) -> RenderedTask:
        """See `Task.rendered`."""
        rng, view = stream(self.seed, self.track, self.name), self.view
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
    return chart_of(rng, shape, _CHART_LAYOUT, _CHART_SIDE_OVER_HEIGHT * shape[0])


def simulation_tasks(size: SetSize, seed: int) -> list[Task]:
    """Tasks of the track."""
    rng, count = stream(seed, "simulation", size.name), size.simulations
    choices = zip(
        numbered("simulation", count),
        spread(rng, size.scenes, count),
        spread(rng, KINDS, count),
        spread(rng, LENSES, count),
        spread(rng, CONDITIONS, count),
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
