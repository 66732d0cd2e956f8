"""Relative blur of two photographs, told from noise."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from analysis.changes.matching.relative_blur import (
    RelativeBlur,
    calibrated_blur_px2,
    relative_blur,
    smoothing_for,
)
from analysis.changes.matching.smoothed_warp import (
    PixelPositions,
    smoothed,
    spline_coefficients,
)
from simulation import GaussianPsf
from simulation.arrays import FloatArray

SHAPE = (200, 240)


def same(y: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    return y, x


PLACED = PixelPositions.of(same, SHAPE, SHAPE)
VALID = np.zeros(SHAPE, dtype=np.bool_)
VALID[12:-12, 12:-12] = True


def scene(seed: int, contrast_dn: float) -> FloatArray:
    image = gaussian_filter(np.random.default_rng(seed).standard_normal(SHAPE), 2.0)
    return np.asarray(100 + contrast_dn * image / image.std())


def measured(source: FloatArray, target: FloatArray) -> RelativeBlur:
    return relative_blur(source.astype(np.float32), target.astype(np.float32), PLACED, VALID, 0.0)


@pytest.mark.parametrize("blur_px2", [-3.0, -0.5, 0.0, 0.16, 1.0, 3.0])
def test_a_blur_is_measured_without_noise_whichever_is_softer(blur_px2: float) -> None:
    sharp, soft = 1.0, float(np.sqrt(1 + abs(blur_px2)))
    widths = (sharp, soft) if blur_px2 >= 0 else (soft, sharp)
    source, target = (gaussian_filter(scene(1, 40.0), width, truncate=7) for width in widths)
    # The search's last step leaves a few thousandths.
    assert measured(source, target).value_px2 == pytest.approx(blur_px2, rel=0.02, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("blur_px2", [0.0, 0.4])
def test_noise_of_either_is_no_blur_and_the_error_is_that_of_the_scatter(blur_px2: float) -> None:
    rng = np.random.default_rng(3)
    source = scene(2, 12.0)
    target = gaussian_filter(source, np.sqrt(blur_px2), truncate=7) if blur_px2 else source
    found = [
        measured(source + rng.normal(0, 3.0, SHAPE), target + rng.normal(0, 2.0, SHAPE))
        for _ in range(24)
    ]
    values = np.array([one.value_px2 for one in found])
    # A mean of 24 is 4 of its standard errors off once in 2,000 (t distribution).
    assert abs(values.mean() - blur_px2) < 4 * values.std(ddof=1) / np.sqrt(24)
    # 24 draws give a scatter to 15 %; that of steps that stop early is not quite the error's.
    assert np.mean([one.err_px2 for one in found]) == pytest.approx(values.std(ddof=1), rel=0.6)


def test_changes_light_and_offset_are_no_blur() -> None:
    source = scene(4, 40.0)
    target = 1.3 * source + 20.0
    target[60:70, 80:90] += 300.0
    rng = np.random.default_rng(0)
    found = measured(source, target + rng.normal(0, 0.5, SHAPE))
    # The smoothed change's skirt, below 5 standard deviations, is not left out.
    assert abs(found.value_px2) < 0.05


def test_nothing_to_see_tells_no_blur_and_what_is_expected_stays() -> None:
    flat = np.full(SHAPE, 500.0)
    found = measured(flat, flat)
    assert (found.value_px2, found.err_px2) == (0.0, np.inf)
    assert found.towards(0.3, 1.0) == pytest.approx(0.3)


@pytest.mark.parametrize("zoom", [1.0, 1.5, 2.0])
def test_one_gaussian_camera_differs_from_itself_by_what_the_zoom_takes(zoom: float) -> None:
    psf = GaussianPsf(sigma_x_px=0.9, sigma_y_px=0.9)

    def nearer(y: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        return zoom * y, zoom * x

    size = (round(zoom * SHAPE[0]) + 10, round(zoom * SHAPE[1]) + 10)
    placed = PixelPositions.of(nearer, SHAPE, size)
    seen = smoothed(scene(5, 30.0).astype(np.float32), 1.0)
    expected = 0.81 * (1 - 1 / zoom**2)
    found = calibrated_blur_px2(psf, seen, VALID, smoothing_for(0.2), placed)
    assert found == pytest.approx(expected, abs=1e-3)  # the search's last step
    assert spline_coefficients(seen, 1.0).shape == SHAPE
