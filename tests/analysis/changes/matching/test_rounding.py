"""The variance by rounding, against a twelfth of the squared step of known files."""

import numpy as np
import pytest

from analysis.changes.matching.smoothed_warp import rounding_variance

SHAPE = (90, 120)


def test_of_a_linear_file_it_is_a_twelfth() -> None:
    ramp = np.arange(90 * 120, dtype=np.float32).reshape(SHAPE) % 256
    found = rounding_variance(ramp)
    assert found is not None
    np.testing.assert_allclose(found, 1 / 12, rtol=1e-5)  # single precision


def test_levels_that_no_pixel_has_do_not_widen_the_step() -> None:
    ramp = np.arange(90 * 120, dtype=np.float32).reshape(SHAPE) % 256
    ramp[ramp % 9 == 4] += 1
    found = rounding_variance(ramp)
    assert found is not None
    np.testing.assert_allclose(found, 1 / 12, rtol=1e-5)


def test_of_a_tone_curve_it_follows_the_curve_s_slope() -> None:
    code = np.arange(90 * 120, dtype=np.float64).reshape(SHAPE) % 256
    levels = (255 * (code / 255) ** 2.2).astype(np.float32)
    found = rounding_variance(levels)
    assert found is not None
    slope = 2.2 * (code / 255) ** 1.2
    middle = (code > 20) & (code < 250)
    # The median of five steps, and between levels a straight line.
    np.testing.assert_allclose(found[middle], slope[middle] ** 2 / 12, rtol=0.05)


@pytest.mark.parametrize("levels", [2, 20, 5000])
def test_charts_and_means_of_frames_tell_no_step(levels: int) -> None:
    image = np.arange(90 * 120, dtype=np.float32).reshape(SHAPE) % levels
    assert rounding_variance(image * np.float32(0.37)) is None
