"""Two photographs of one view: nothing is aligned, and noise is neither blur nor light nor change.

The pictures are scikit-image's; the noise is drawn here.
"""

from functools import lru_cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from analysis.changes import ChangeOptions, find_changes
from analysis.changes.photograph_pair import nearest_shift, one_view
from calibration.registration import DistortedPose, RegistrationHints
from simulation.arrays import FloatArray
from tests.shipped import shipped

PICTURES = ("camera", "coins", "moon", "page", "brick", "text")


@lru_cache
def picture(name: str) -> FloatArray:
    """Levels from 100 to 2100, none of them at an end."""
    levels = shipped(name)[:400, :400]
    return 100 + 2000 * levels / 255


def noisy(scene: FloatArray, noise_dn: float, seed: int) -> FloatArray:
    return scene + np.random.default_rng(seed).normal(0, noise_dn, scene.shape)


@pytest.mark.parametrize("name", PICTURES)
@pytest.mark.parametrize("noise_dn", [3.0, 30.0])
def test_equal_exposures_are_as_sharp_and_as_bright_and_nothing_changed(
    name: str, noise_dn: float
) -> None:
    scene = picture(name)
    found = find_changes(noisy(scene, noise_dn, 1), noisy(scene, noise_dn, 2)).summary
    assert found.homography == ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    # 12 pairs, drawn once: 3.9 standard errors are exceeded in one of 10,000.
    assert abs(found.extra_blur_px2) < 3.9 * found.extra_blur_err_px2
    assert abs(found.gain - 1) < 3.9 * found.gain_err
    assert (found.changes, found.moved) == ((), ())


def test_a_mask_is_no_hint_of_the_pose() -> None:
    mask = np.zeros(picture("coins").shape, dtype=np.bool_)
    mask[:40] = True
    options = ChangeOptions(hints=RegistrationHints(left_out=mask), left_out=mask)
    result = find_changes(
        noisy(picture("coins"), 3.0, 1), noisy(picture("coins"), 3.0, 2), None, options
    )
    assert result.summary.homography == ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    assert not result.valid[:40].any()


@pytest.mark.slow
def test_the_stated_errors_of_blur_and_gain_are_those_of_the_draws() -> None:
    ratios = []
    for seed in range(40):
        scene = picture(PICTURES[seed % len(PICTURES)])
        # Of unequal noise, too: the mean is weighted by it.
        pair = noisy(scene, 20.0, 100 + seed), noisy(scene, 20.0 + 20 * (seed % 2), 200 + seed)
        found = find_changes(*pair).summary
        ratios.append(
            (
                found.extra_blur_px2 / found.extra_blur_err_px2,
                (found.gain - 1) / found.gain_err,
            )
        )
    rms = np.sqrt(np.mean(np.square(ratios), axis=0))
    # The root of chi-squared of 40 over 40: 0.67 to 1.39 in 998 of 1,000; errors are estimates.
    assert (rms > 0.6).all()
    assert (rms < 1.5).all()


@pytest.mark.parametrize("name", PICTURES)
def test_a_photograph_does_not_differ_from_itself(name: str) -> None:
    scene = np.rint(picture(name) / 10)
    result = find_changes(scene, scene)
    assert not result.difference_dn.any()
    assert result.summary.gain == 1.0
    assert result.summary.extra_blur_px2 == pytest.approx(0, abs=1e-6)
    assert (result.summary.changes, result.summary.warnings) == ((), ())


def test_before_against_after_is_minus_after_against_before() -> None:
    scene = picture("coins")
    before, after = noisy(scene, 10.0, 1), noisy(scene, 10.0, 2)
    after[200:206, 220:228] += 300.0
    there, back = find_changes(before, after), find_changes(after, before)
    scale = float(np.abs(there.difference_dn).max())
    # The light is fitted to one of them: to a few parts in a thousand of what changed.
    np.testing.assert_allclose(there.difference_dn, -back.difference_dn, atol=5e-3 * scale)
    assert len(there.summary.changes) == len(back.summary.changes) == 1


def test_a_true_blur_and_a_true_gain_are_measured() -> None:
    scene = picture("camera")
    softer = 1.2 * gaussian_filter(scene, np.sqrt(0.5), truncate=7) + 30
    found = find_changes(noisy(scene, 8.0, 1), noisy(softer, 8.0, 2)).summary
    # At whole pixels the Gaussian has a variance of 0.497.
    assert found.extra_blur_px2 == pytest.approx(0.5, abs=4 * found.extra_blur_err_px2 + 0.02)
    assert found.gain == pytest.approx(1.2, abs=4 * found.gain_err + 1e-3)


def test_a_part_cut_out_at_whole_pixels_is_compared_pixel_by_pixel() -> None:
    scene = np.rint(picture("camera") / 10)
    result = find_changes(scene, scene[31:331, 17:347])
    assert result.summary.homography == ((1.0, 0.0, 17.0), (0.0, 1.0, 31.0), (0.0, 0.0, 1.0))
    assert not result.difference_dn.any()


def test_another_view_is_aligned() -> None:
    scene = picture("camera")
    moved = noisy(np.roll(scene, 3, axis=1), 5.0, 2)
    assert one_view(noisy(scene, 5.0, 1), moved, ChangeOptions()) is None
    other = noisy(picture("brick"), 5.0, 3)
    assert one_view(noisy(scene, 5.0, 1), other, ChangeOptions()) is None


@pytest.mark.parametrize(
    ("matrix", "shift"),
    [
        (((1.0, 0.0, 16.9), (0.0, 1.0, -3.2), (0.0, 0.0, 1.0)), (-3, 17)),
        (((1.01, 0.0, 16.9), (0.0, 1.01, -3.2), (0.0, 0.0, 1.0)), None),
        (((1.0, 0.02, 0.0), (-0.02, 1.0, 0.0), (0.0, 0.0, 1.0)), None),
    ],
)
def test_the_nearest_shift_is_that_of_whole_pixels(
    matrix: tuple[tuple[float, ...], ...], shift: tuple[int, int] | None
) -> None:
    pose = DistortedPose(
        matrix=np.array(matrix), k1=0.0, reference_shape=(200, 300), followup_shape=(150, 200)
    )
    assert nearest_shift(pose) == shift
