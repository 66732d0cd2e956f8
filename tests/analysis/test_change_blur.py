"""Extra blur of a follow-up, told from noise."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from analysis.change_blur import extra_blur, immerkaer_variance
from analysis.change_filter import find_changes
from tests.analysis.test_change_filter import MATRIX, PSF, pair

FloatArray = NDArray[np.float64]

EVERYWHERE = np.ones((200, 240), dtype=np.bool_)


def scene(seed: int, contrast_dn: float) -> FloatArray:
    """A texture 2.5 px wide: a blur of variance t changes it by t / 2 times its Laplacian."""
    image = gaussian_filter(np.random.default_rng(seed).standard_normal(EVERYWHERE.shape), 2.5)
    return np.asarray(contrast_dn * image / image.std())


@pytest.mark.parametrize("extra_px2", [0.0, 0.04, 0.09, 0.16])
def test_a_blur_is_measured_without_noise(extra_px2: float) -> None:
    sharp = gaussian_filter(scene(1, 60.0), 1.0)
    soft = gaussian_filter(scene(1, 60.0), np.sqrt(1.0 + extra_px2))
    found = extra_blur(sharp, soft, EVERYWHERE, 0.0)
    # The Laplacian of 5 points, and the next order of the blur, make some per cent.
    assert found.value_px2 == pytest.approx(extra_px2, rel=0.06, abs=1e-9)


def test_noise_of_either_image_is_no_blur() -> None:
    rng = np.random.default_rng(3)
    image = scene(2, 12.0)
    values, errors = [], []
    for _ in range(40):
        # The simulated image's noise is smeared by the simulation, the follow-up's is white.
        simulated = image + gaussian_filter(rng.normal(0.0, 9.0, image.shape), 0.6)
        followup = image + rng.normal(0.0, 4.0, image.shape)
        found = extra_blur(simulated, followup, EVERYWHERE, 4.0**2)
        values.append(found.value_px2)
        errors.append(found.err_px2)
    assert abs(np.mean(values)) < 4 * np.std(values) / np.sqrt(40)
    # The stated error is that of the scatter, which 40 draws give to 11 %.
    assert np.mean(errors) == pytest.approx(np.std(values), rel=0.35)


def test_changes_are_left_out_of_it() -> None:
    image = scene(4, 60.0)
    changed = image.copy()
    changed[60:70, 80:90] += 300.0
    rng = np.random.default_rng(0)
    found = extra_blur(image, changed + rng.normal(0, 1.0, image.shape), EVERYWHERE, 1.0)
    assert abs(found.value_px2) < 0.02


@pytest.mark.parametrize("level_dn", [0.0, 500.0])
def test_nothing_to_see_is_no_blur(level_dn: float) -> None:
    flat = np.full(EVERYWHERE.shape, level_dn)
    found = extra_blur(flat, flat, EVERYWHERE, 0.0)
    assert (found.value_px2, found.err_px2) == (0.0, np.inf)
    assert extra_blur(flat, flat, ~EVERYWHERE, 0.0).err_px2 == np.inf


@given(
    sigma_dn=st.floats(0.1, 50.0),
    slope=st.floats(-5.0, 5.0),
    twist=st.floats(-0.05, 0.05),
    seed=st.integers(0, 1000),
)
def test_the_noise_is_found_on_any_slope(
    sigma_dn: float, slope: float, twist: float, seed: int
) -> None:
    # The mask is blind to a + b x + c y + d x y, and to a few changed pixels.
    y, x = np.mgrid[: EVERYWHERE.shape[0], : EVERYWHERE.shape[1]].astype(np.float64)
    noise = np.random.default_rng(seed).normal(0.0, sigma_dn, EVERYWHERE.shape)
    image = noise + slope * x - slope * y + twist * x * y
    image[50:60, 50:60] += 1000.0
    # 48000 correlated values of 36: the variance is known to some per cent.
    assert immerkaer_variance(image, EVERYWHERE) == pytest.approx(sigma_dn**2, rel=0.08)
    assert immerkaer_variance(image, ~EVERYWHERE) == 0.0


def test_a_faint_noisy_scene_is_compared() -> None:
    one = pair(1, 0.0)
    rng = np.random.default_rng(1)
    noisy = [image + rng.normal(0.0, 0.6 * image.std(), image.shape) for image in
             (one.reference, one.followup)]  # fmt: skip
    result = find_changes(noisy[0], noisy[1], MATRIX, PSF)
    assert abs(result.extra_blur_px2) < 3 * result.extra_blur_err_px2
