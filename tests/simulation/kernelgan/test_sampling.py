from typing import Any

import numpy as np
import pytest
from scipy import ndimage

from simulation import GaussianPsf, SamplingGrid, zoom_out
from simulation.arrays import FloatArray
from simulation.kernelgan import EstimatedKernel, kernel_operator
from simulation.kernelgan.crops import nearest_positions

SHAPE = (60, 90)
OFFSET = np.arange(13) - 6.0


def _gaussian(variance_px2: float, centre: tuple[float, float] = (0.0, 0.0)) -> EstimatedKernel:
    y, x = (np.exp(-0.5 * (OFFSET - c) ** 2 / variance_px2) for c in centre)
    weights = np.outer(y, x)
    return EstimatedKernel(weights=weights / weights.sum())


def _blobs() -> FloatArray:
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    made = np.zeros(SHAPE)
    for cy, cx in ((20.3, 31.8), (41.0, 60.4), (28.7, 52.2)):
        made += np.exp(-((y - cy) ** 2 + (x - cx) ** 2) / (2 * 2.5**2))
    return made


def test_nearest_equals_a_correlation_sampled_at_the_published_positions() -> None:
    rng = np.random.default_rng(0)
    weights = rng.uniform(0, 1, (13, 13))
    kernel = EstimatedKernel(weights=weights / weights.sum())
    image = rng.uniform(0, 1, SHAPE)
    for zoom in (2.0, 1.5, 3.0):  # all divide 60 and 90
        made = kernel_operator(SHAPE, SamplingGrid.centred(SHAPE, zoom), kernel, "nearest")
        blurred = ndimage.correlate(image, kernel.weights, mode="reflect")
        rows, cols = (nearest_positions(int(size / zoom), zoom) for size in SHAPE)
        np.testing.assert_allclose(made.apply(image), blurred[np.ix_(rows, cols)], atol=1e-10)


@pytest.mark.parametrize("centre", [(0.0, 0.0), (0.8, -1.3)])
@pytest.mark.parametrize("zoom", [2.0, 1.3])
def test_exact_has_the_geometry_of_the_other_models_wherever_the_kernel_lies(
    zoom: float, centre: tuple[float, float]
) -> None:
    psf = GaussianPsf(sigma_x_px=1.0, sigma_y_px=1.0)
    kernel = _gaussian(zoom**2 - 1, centre)
    grid = SamplingGrid.centred(SHAPE, zoom)
    made = kernel_operator(SHAPE, grid, kernel).apply(_blobs())
    # The kernel ends at 6 px, 3.5 of its sigmas and less where it is off centre.
    np.testing.assert_allclose(made, zoom_out(_blobs(), zoom, psf), atol=0.01)


def test_a_constant_stays_constant_and_zoom_1_changes_nothing() -> None:
    weights = np.zeros((13, 13))
    weights[6, 6] = 1.0
    for sampler in ("exact", "nearest"):
        grid = SamplingGrid.centred(SHAPE, 2.3)
        level = kernel_operator(SHAPE, grid, _gaussian(2.0, (0.4, 0.1)), sampler)
        np.testing.assert_allclose(level.apply(np.full(SHAPE, 7.0)), 7.0, rtol=1e-10)
        same = kernel_operator(
            SHAPE,
            SamplingGrid.centred(SHAPE, 1.0),
            EstimatedKernel(weights=weights),
            sampler,
        )
        np.testing.assert_allclose(same.apply(_blobs()), _blobs(), atol=1e-5)


def test_an_unknown_sampler_is_refused() -> None:
    sampler: Any = "cubic"
    with pytest.raises(ValueError):
        kernel_operator(SHAPE, SamplingGrid.centred(SHAPE, 2.0), _gaussian(1.0), sampler)
