"""Parallax to a fraction of a pixel, of patterns whose displacement has a closed form.

Waves of 8 px and longer: the lens's blur leaves little of shorter ones.
"""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from calibration.parallax._refinement import refined_parallax
from calibration.parallax._views import AlignedViews, in_own_light
from simulation.arrays import BoolArray, Float32Array, FloatArray
from tests.calibration.parallax.test_matching import views_of

FRAME = (90, 110)
INNER = np.s_[16:-16, 16:-16]
Y, X = np.meshgrid(np.arange(90.0), np.arange(110.0), indexing="ij")
ALL: BoolArray = np.ones(FRAME, dtype=np.bool_)
ASLANT = (0.6, -0.8)


def waves(x: FloatArray, y: FloatArray, seed: int = 0) -> FloatArray:
    """Sum of 60 waves, 8 to 40 px long, with a standard deviation of 1."""
    rng = np.random.default_rng(seed)
    total = np.zeros_like(x)
    for _ in range(60):
        length, angle, phase = rng.uniform(8, 40), *rng.uniform(0, 2 * np.pi, 2)
        along = x * np.cos(angle) + y * np.sin(angle)
        total += np.cos(2 * np.pi * along / length + phase)
    return np.asarray(total / 30**0.5)


def views_at(
    parallax_px: FloatArray | float, to: tuple[float, float] = ASLANT, seed: int = 0
) -> AlignedViews:
    """A target whose pixels lie in the source by so much along the lines."""
    there = waves(X + parallax_px * to[0], Y + parallax_px * to[1], seed)
    return views_of(there, waves(X, Y, seed), to)


def start(parallax_px: FloatArray | float) -> Float32Array:
    """What matching finds: to a whole pixel."""
    return np.asarray(np.rint(parallax_px + np.zeros(FRAME)), dtype=np.float32)


@pytest.mark.parametrize("fraction", [0.2, 0.5, 0.7])
@pytest.mark.parametrize("angle_deg", [0, 217])
def test_a_fraction_of_a_pixel_is_found(fraction: float, angle_deg: int) -> None:
    angle = np.deg2rad(angle_deg)
    for parallax_px in (2 + fraction, -3 - fraction):
        views = views_at(parallax_px, (np.cos(angle), np.sin(angle)))
        found, error, _ = refined_parallax(views, start(parallax_px), ALL)
        off = found[INNER] - parallax_px
        # OpenCV rounds places to 1/32 px, half of which is .016; two neighbours, weighed by their
        # distance, scatter by .01 with waves of 8 px; neither is on one side.
        assert abs(off.mean()) < 0.016
        assert np.std(off) < 0.02
        assert np.isfinite(error[INNER]).all()


@pytest.mark.parametrize("parallax_px", [0.0, 3.0])
def test_a_displacement_of_whole_pixels_without_noise_is_exact(parallax_px: float) -> None:
    """Nothing is left of the levels then; nor of a scene most of which is black."""
    to = (0.0, 1.0)
    for seen in (ALL, (X - 55) ** 2 + (Y - 45) ** 2 < 25**2):
        views = views_at(parallax_px, to)
        target = np.where(seen, views.target, np.float32(0))
        source = np.where(np.roll(seen, round(parallax_px), 0), views.source, np.float32(0))
        dark = replace(views, target=target, source=source)
        found, error, _ = refined_parallax(dark, start(parallax_px), ALL)
        assert not np.isnan(error).any()
        # Of what is black nothing is known.
        textured = cv2.erode(seen.astype(np.uint8), np.ones((15, 15), np.uint8))[INNER] > 0
        np.testing.assert_allclose(found[INNER][textured], parallax_px, atol=1e-3)


@pytest.mark.parametrize("off_px", [-0.5, 0.5])
def test_it_is_found_from_either_side(off_px: float) -> None:
    found, _, _ = refined_parallax(views_at(3.2), start(3.2) * 0 + np.float32(3.2 + off_px), ALL)
    # The rounds end within a hundredth of a pixel of one another.
    nearest, _, _ = refined_parallax(views_at(3.2), start(3.2), ALL)
    np.testing.assert_allclose(found[INNER], nearest[INNER], atol=0.01)


@pytest.mark.parametrize(("across", "down"), [(0.06, 0.0), (-0.03, 0.05), (0.0, -0.08)])
def test_a_surface_that_slopes_is_found_without_a_bias(across: float, down: float) -> None:
    true = 2.3 + across * (X - 55) + down * (Y - 45)
    found, _, _ = refined_parallax(views_at(true), start(true), ALL)
    off = found[INNER] - true[INNER]
    # Whole pixels to begin with are steps, which the fit of planes levels: to a twentieth of a
    # pixel everywhere, and to a hundredth on average.
    assert np.abs(off).max() < 0.05
    assert abs(off.mean()) < 0.005


def test_two_surfaces_stay_two() -> None:
    """Beside a jump of 5 px, neighbours on the other surface say nothing."""
    right = X > 55
    true = np.where(right, 4.3, -0.7)
    found, _, _ = refined_parallax(views_at(true), start(true), ALL)
    away = np.abs(X - 55) > 3
    away[:16], away[-16:], away[:, :16], away[:, -16:] = (False,) * 4
    # The blur's reach, 2 px, mixes in what is beyond the edge, which then weighs less.
    np.testing.assert_allclose(found[away], true[away], atol=0.15)
    away &= np.abs(X - 55) > 10
    np.testing.assert_allclose(found[away], true[away], atol=0.05)


def noisy(views: AlignedViews, sigma: float, seed: int) -> AlignedViews:
    rng = np.random.default_rng(seed)
    target, source = (
        (image + rng.normal(0, sigma, FRAME)).astype(np.float32)
        for image in (views.target, views.source)
    )
    return replace(views, target=target, source=source)


@pytest.mark.slow
@pytest.mark.parametrize("sigma", [0.03, 0.15])
@pytest.mark.parametrize("to", [(1.0, 0.0), ASLANT])
def test_stated_errors_are_those_of_white_noise(sigma: float, to: tuple[float, float]) -> None:
    over = []
    for seed in range(8):
        views = noisy(views_at(1.35, to, seed), sigma, seed + 100)
        found, error, _ = refined_parallax(views, start(1.35), ALL)
        # Pixels further from one another than the neighbours that they share.
        apart = np.s_[16:-16:15, 16:-16:15]
        over.append((found[apart] - 1.35) / error[apart])
    ratio = float(np.sqrt(np.mean(np.square(over))))
    # 160 independent ratios: 6 % of their root mean square, of which 3.3 are 1 of 1000. A factor
    # of 1.5 is what the blur's correlations, which differ with the waves, may be off.
    assert 1 / 1.5 / 1.2 < ratio < 1.5 * 1.2


def test_what_is_not_matched_does_not_count() -> None:
    views, matched = views_at(2.4), ALL.copy()
    matched[30:50, 40:60] = False
    junk = np.where(matched, views.target, 5.0).astype(np.float32)
    begun = start(2.4)
    begun[~matched] = -7
    found, _, left = refined_parallax(replace(views, target=junk), begun, matched)
    np.testing.assert_array_equal(found[~matched], -7)
    np.testing.assert_array_equal(left[~matched], 0)
    beside = matched.copy()
    beside[:16], beside[-16:], beside[:, :16], beside[:, -16:] = (False,) * 4
    # The blur of .7 px brings the junk 2 px further, where what is left weighs less, not nothing.
    beside[27:53, 37:63] = False
    np.testing.assert_allclose(found[beside], 2.4, atol=0.15)
    beside[20:60, 30:70] = False
    np.testing.assert_allclose(found[beside], 2.4, atol=0.05)


@settings(max_examples=10)
@given(gain=st.floats(0.2, 5.0), offset=st.floats(-50, 50))
def test_a_photograph_in_its_own_light_is_the_same_in_any(gain: float, offset: float) -> None:
    image = (100 + 20 * waves(X, Y)).astype(np.float32)
    own = in_own_light(image, ALL)
    # Single precision of levels of up to 850, beside a contrast of 4 at least.
    np.testing.assert_allclose(in_own_light(gain * image + offset, ALL), own, atol=2e-3)
    assert 0.5 < own[INNER].std() < 1.5


def test_what_shows_nothing_is_0_in_its_own_light_and_hides_nothing_beside() -> None:
    image, shown = (100 + 20 * waves(X, Y)).astype(np.float32), ALL.copy()
    shown[:, 60:] = False
    one, two = (
        in_own_light(np.where(shown, image, np.float32(hidden)), shown) for hidden in (0.0, 9e3)
    )
    np.testing.assert_array_equal(one, two)
    assert not one[~shown].any()
