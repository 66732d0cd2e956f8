"""Extra blur of a follow-up, told from noise."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from analysis.changes.filter import find_changes
from analysis.changes.uncertainty import extra_blur
from simulation.arrays import FloatArray
from tests.analysis.changes.test_filter import MATRIX, PSF, pair, posed

EVERYWHERE = np.ones((200, 240), dtype=np.bool_)


def scene(seed: int, contrast_dn: float) -> FloatArray:
    """A texture 2.5 px wide: a blur of variance t changes it by t / 2 times its Laplacian."""
    image = gaussian_filter(np.random.default_rng(seed).standard_normal(EVERYWHERE.shape), 2.5)
    return np.asarray(contrast_dn * image / image.std())


@pytest.mark.parametrize("extra_px2", [0.0, 0.04, 0.09, 0.16])
def test_a_blur_is_measured_without_noise(extra_px2: float) -> None:
    sharp = gaussian_filter(scene(1, 60.0), 1.0)
    soft = gaussian_filter(scene(1, 60.0), np.sqrt(1.0 + extra_px2))
    found = extra_blur(sharp, soft, EVERYWHERE)
    # The Laplacian of 5 points, and the next order of the blur, make some per cent.
    assert found.value_px2 == pytest.approx(extra_px2, rel=0.06, abs=1e-9)


@pytest.mark.parametrize("smeared_px", [0.0, 0.6])
def test_noise_of_either_image_is_no_blur(smeared_px: float) -> None:
    rng = np.random.default_rng(3)
    image = scene(2, 12.0)
    values, errors = [], []
    for _ in range(40):
        # The simulation smears the reference's noise, though not at zoom 1; the other is white.
        simulated = image + gaussian_filter(rng.normal(0.0, 5.0, image.shape), smeared_px)
        followup = image + rng.normal(0.0, 4.0, image.shape)
        found = extra_blur(simulated, followup, EVERYWHERE)
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
    found = extra_blur(image, changed + rng.normal(0, 1.0, image.shape), EVERYWHERE)
    assert abs(found.value_px2) < 0.02


@pytest.mark.parametrize("level_dn", [0.0, 500.0])
def test_nothing_to_see_is_no_blur(level_dn: float) -> None:
    flat = np.full(EVERYWHERE.shape, level_dn)
    found = extra_blur(flat, flat, EVERYWHERE)
    assert (found.value_px2, found.err_px2) == (0.0, np.inf)
    assert extra_blur(flat, flat, ~EVERYWHERE).err_px2 == np.inf


def test_a_faint_noisy_scene_is_compared() -> None:
    one = pair(1, 0.0)
    rng = np.random.default_rng(1)
    noisy = [image + rng.normal(0.0, 0.6 * image.std(), image.shape) for image in
             (one.reference, one.followup)]  # fmt: skip
    result = find_changes(noisy[0], noisy[1], PSF, posed(MATRIX, noise=None))
    assert abs(result.summary.extra_blur_px2) < 3 * result.summary.extra_blur_err_px2
