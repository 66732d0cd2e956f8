"""Ten scenes of the set rendered by GalSim, which shares no code with the set's renderer."""

from collections.abc import Iterator
from math import cos, radians, sin
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from hil_mocks.benchmark_set._camera_tracks import EdgeChart, PhotographsWithoutEdge, Simulation
from hil_mocks.benchmark_set._documents import benchmark_tasks
from hil_mocks.benchmark_set._lenses import CircularPupil, GaussianLens, Lens
from hil_mocks.benchmark_set._photographs import INK, PAPER
from hil_mocks.benchmark_set._scenes import scene
from hil_mocks.benchmark_set._tasks import View, chart_light

galsim = pytest.importorskip("galsim", reason="the independent renderer is not installed")

FloatArray = NDArray[np.float64]
PARAMETERS = galsim.GSParams(maximum_fft_size=16384, folding_threshold=2e-3)
PITCH_PX = 0.25
BEYOND_PX = 40
"""Of the scene's mirror image, where a follow-up looks over its border."""


def optics(lens: Lens) -> Any:
    if isinstance(lens, GaussianLens):
        c, s = cos(radians(lens.angle_deg)), sin(radians(lens.angle_deg))
        turn = np.array([[c, -s], [s, c]])
        root = turn @ np.diag([lens.sigma_major_px, lens.sigma_minor_px]) @ turn.T
        unit = galsim.Gaussian(sigma=1.0, gsparams=PARAMETERS)
        return galsim.Transform(unit, jac=root.ravel().tolist(), flux_ratio=1 / np.linalg.det(root))
    assert isinstance(lens, CircularPupil)
    size = 1 / lens.cut_off_cy_per_px
    waves = lens.facts().get("zernike_waves_rms")
    if waves is None:
        return galsim.Airy(lam_over_diam=size, gsparams=PARAMETERS)
    return galsim.OpticalPSF(
        lam_over_diam=size, oversampling=1.0, pad_factor=2, gsparams=PARAMETERS, **waves
    )


def drawn(light: Any, lens: Lens, shape: tuple[int, int]) -> FloatArray:
    seen = galsim.Convolve(light, optics(lens), galsim.Pixel(1.0), gsparams=PARAMETERS)
    image = seen.drawImage(nx=shape[1], ny=shape[0], scale=1.0, method="no_pixel")
    return np.asarray(image.array, dtype=np.float64)


def squares(task: EdgeChart) -> FloatArray:
    middle_y, middle_x = ((n - 1) / 2 for n in task.shape)
    boxes = [
        galsim.Box(s.side_px, s.side_px, flux=(INK - PAPER) * s.side_px**2)
        .rotate(s.slant_deg * galsim.degrees)
        .shift(s.x_px - middle_x, s.y_px - middle_y)
        for s in task.chart.squares
    ]
    return PAPER + drawn(galsim.Sum(boxes), task.lens, task.shape)


def followup(view: View) -> FloatArray:
    """The cubic B-spline is a box of one coefficient, thrice blurred by another."""
    matrix, (rows, cols) = view.pose.matrix, view.pose.followup_shape
    known = scene(view.scene, view.pose.reference_shape, view.seed).coefficients
    mean = known.mean()
    around = np.pad(known - mean, round(BEYOND_PX / PITCH_PX), mode="symmetric")
    cells = galsim.InterpolatedImage(
        galsim.Image(around, scale=PITCH_PX),
        x_interpolant="nearest",
        normalization="sb",
        calculate_stepk=False,
        calculate_maxk=False,
        gsparams=PARAMETERS,
    )
    box = galsim.Pixel(PITCH_PX, gsparams=PARAMETERS)
    spline = galsim.Convolve(cells, box, box, box, gsparams=PARAMETERS)
    looked_at = matrix[:2, :2] @ [(cols - 1) / 2, (rows - 1) / 2] + matrix[:2, 2]
    middle = (np.array(view.pose.reference_shape[::-1]) - 1) / 2
    back = np.linalg.inv(matrix[:2, :2]).ravel().tolist()
    seen = galsim.Transform(spline.shift(*(middle - looked_at)), jac=back, gsparams=PARAMETERS)
    return np.asarray(mean + drawn(seen, view.lens, (rows, cols)))


def affine_tasks() -> Iterator[EdgeChart | PhotographsWithoutEdge | Simulation]:
    """Those of the tiny sets of three seeds that an affine map renders."""
    for seed in (1, 2, 3):
        for task in benchmark_tasks("tiny", seed):
            if isinstance(task, EdgeChart | PhotographsWithoutEdge):
                yield task
            if isinstance(task, Simulation) and task.kind == "frontal":
                yield task


TEN = [task for task in affine_tasks() if task.name != "edges-002"][:10]


def test_the_ten_are_of_all_sorts() -> None:
    assert len(TEN) == 10
    assert {type(task) for task in TEN} == {EdgeChart, PhotographsWithoutEdge, Simulation}
    kinds = {(type(task) is EdgeChart, task.lens.facts()["kind"]) for task in TEN}
    assert {"gaussian", "diffraction", "aberrated"} == {kind for _, kind in kinds}


@pytest.mark.slow
@pytest.mark.parametrize("task", TEN, ids=lambda task: f"{task.name} of seed {task.seed}")
def test_the_light_on_each_pixel_is_galsim_s(
    task: EdgeChart | PhotographsWithoutEdge | Simulation,
) -> None:
    if isinstance(task, EdgeChart):
        ours, theirs = chart_light(task.chart, task.lens), squares(task)
    else:
        ours, theirs = task.view.followup_light(), followup(task.view)
    worst = np.abs(ours - theirs).max() / ours.max()
    assert worst < 1e-3
