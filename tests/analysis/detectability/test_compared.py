"""The observer that predicts comparisons: closed forms on flat scenes, and what texture costs."""

from math import exp, pi, sqrt

import numpy as np
import pytest

from analysis.detectability import (
    DetectabilityCurve,
    DetectionTask,
    GaussianSignal,
    PatchSignal,
    Scenario,
    compared_change,
    curves_of_images,
    expected_limits,
    scene_residual,
    scene_sums,
)
from analysis.detectability._compared import comparison_filters
from simulation import GaussianPsf
from simulation.arrays import FloatArray

PSF = GaussianPsf(sigma_px=0.9)
FLAT = np.full((160, 190), 100.0)
SIGMA_PX, CONTRAST_DN, NOISE_DN = 2.0, 10.0, 1.5


def task(**changed: object) -> DetectionTask:
    given: dict[str, object] = {
        "signal": GaussianSignal(sigma_px=SIGMA_PX),
        "contrasts_dn": (CONTRAST_DN,),
        "noises_dn": (NOISE_DN,),
        "zooms": (1.0, 1.5, 2.0),
        "models": ("matched",),
        "observers": ("changes",),
        "reference_zoom": 1.0,
        "window_px": 17,
    }
    return DetectionTask(**(given | changed))  # type: ignore[arg-type]


def curve(image: FloatArray = FLAT, **changed: object) -> DetectabilityCurve:
    return curves_of_images([image], PSF, task(**changed)).curves[0]


def texture(shape: tuple[int, int] = (160, 190)) -> FloatArray:
    return np.asarray(np.random.default_rng(1).normal(100, 15, shape))


@pytest.mark.slow
def test_the_follow_up_shows_a_spot_as_two_gaussians_in_a_row() -> None:
    found = curve(zooms=(1.0, 1.5, 2.0), reference_zoom=1.0)
    assert found.seen_sigma_px is not None
    assert found.seen_dn is not None
    for zoom, sigma_px, peak_dn in zip(found.zoom, found.seen_sigma_px, found.seen_dn, strict=True):
        wide = SIGMA_PX**2 + 0.9**2 * (zoom**2 - 1)
        assert sigma_px == pytest.approx(sqrt(wide) / zoom, rel=0.003)
        assert peak_dn == pytest.approx(CONTRAST_DN * SIGMA_PX**2 / wide, rel=0.005)


@pytest.mark.parametrize("zoom", [1.25, 1.5, 2.0, 3.0])
def test_the_filters_make_up_for_the_blur_of_a_gaussian_lens(zoom: float) -> None:
    smoothing = comparison_filters(Scenario(psf=PSF, reference_zoom=1.0), "matched", zoom).smoothing
    blur_px2 = 0.9**2 * (1 - 1 / zoom**2)
    assert smoothing.source_px**2 - smoothing.target_px**2 == pytest.approx(blur_px2, abs=0.01)


@pytest.mark.slow
def test_d_prime_on_a_flat_scene_is_that_of_white_noise_behind_the_filters() -> None:
    found = curve()
    for zoom, d_prime in zip(found.zoom, found.dprime, strict=True):
        scenario = Scenario(psf=PSF, reference_zoom=1.0, window_px=17)
        filters = comparison_filters(scenario, "matched", zoom)
        wide = SIGMA_PX**2 + 0.9**2 * (zoom**2 - 1)
        seen_px2, peak_dn = wide / zoom**2, CONTRAST_DN * SIGMA_PX**2 / wide
        by_hand = 0.0
        for width in filters.widths:
            whole = seen_px2 + width.width_px**2
            height = peak_dn * seen_px2 / whole * exp(-(width.step_px**2) / 6 / (2 * whole))
            source_px2 = filters.smoothing.source_px**2 + width.width_px**2
            source_px2 -= filters.smoothing.target_px**2
            noise_dn2 = (
                NOISE_DN**2 / (4 * pi) * (1 / width.width_px**2 + 1 / (zoom**2 * source_px2))
            )
            by_hand = max(by_hand, height / sqrt(noise_dn2) / width.allowance)
        # To 0.5 %: sums of samples stand for integrals.
        assert d_prime == pytest.approx(by_hand, rel=0.005)


def test_a_flat_scene_leaves_nothing_unexplained() -> None:
    residual = scene_residual(
        FLAT, Scenario(psf=PSF, reference_zoom=1.0, window_px=17), "matched", 1.5
    )
    assert residual.autocovariance_dn2.max() < 1e-6


@pytest.mark.slow
def test_texture_costs_where_it_outweighs_the_noise() -> None:
    """White texture through a lens that passes next to all of it is aliased further away."""
    sharp = GaussianPsf(sigma_px=0.3)
    fine = curves_of_images([texture()], sharp, task()).curves[0]
    flat = curves_of_images([FLAT], sharp, task()).curves[0]
    assert fine.dprime[1] < 0.97 * flat.dprime[1]
    louder = task(noises_dn=(40.0,))
    assert curves_of_images([texture()], sharp, louder).curves[0].dprime[1] == pytest.approx(
        curves_of_images([FLAT], sharp, louder).curves[0].dprime[1], rel=0.05
    )


@pytest.mark.slow
def test_d_prime_is_in_proportion_to_contrast_and_on_a_flat_scene_to_noise() -> None:
    once = np.array(curve().dprime)
    assert np.array(curve(contrasts_dn=(3 * CONTRAST_DN,)).dprime) == pytest.approx(3 * once)
    assert np.array(curve(noises_dn=(2 * NOISE_DN,)).dprime) == pytest.approx(once / 2, rel=1e-6)


@pytest.mark.slow
def test_the_limit_turns_the_curve_round() -> None:
    found = curve()
    limits = expected_limits(found)
    assert found.seen_dn is not None
    for zoom, seen_dn, d_prime in zip(found.zoom, found.seen_dn, found.dprime, strict=True):
        assert limits.limit_at(zoom) == pytest.approx(seen_dn / d_prime)
    with pytest.raises(ValueError, match="observer changes"):
        expected_limits(found.model_copy(update={"observer": "npw"}))


@pytest.mark.slow
def test_a_patch_has_no_width_and_predicts_no_limit() -> None:
    patch = np.zeros((9, 9))
    patch[2:7, 4] = 1.0
    found = curve(signal=PatchSignal(levels_dn=patch))
    assert found.seen_sigma_px is None
    assert min(found.dprime) > 0
    with pytest.raises(ValueError, match="Gaussian"):
        expected_limits(found)


def test_a_patch_that_is_a_spot_stands_as_high_as_the_spot() -> None:
    y, x = np.mgrid[-12:13, -12:13]
    patch = PatchSignal(levels_dn=np.exp(-(y**2 + x**2) / (2 * SIGMA_PX**2)))
    scenario = Scenario(psf=PSF, reference_zoom=1.0)
    one, other = (
        compared_change(signal, scenario, "matched", 1.37)
        for signal in (patch, GaussianSignal(sigma_px=SIGMA_PX))
    )
    # Six places stand for all.
    assert one.heights == pytest.approx(other.heights, rel=0.02)


def test_a_photograph_too_small_to_be_compared_is_refused() -> None:
    with pytest.raises(ValueError, match="too small to be compared"):
        curve(image=texture((60, 60)), zooms=(2.0,))


@pytest.mark.slow
def test_the_sums_of_residuals_follow_those_of_the_artefacts() -> None:
    asked = task(models=("bicubic", "matched"), zooms=(1.0, 1.5))
    plan = asked.plan(PSF, 1)
    sums = scene_sums(texture(), plan)
    assert sums.products_dn2.shape[:2] == (4, 2)
    plain = task(models=("bicubic", "matched"), zooms=(1.0, 1.5), observers=("npw",)).plan(PSF, 1)
    assert np.array_equal(scene_sums(texture(), plain).products_dn2, sums.products_dn2[:2])
    # What was measured before the observer is found again.
    assert "is_compared" not in plain.key
    assert plain.key != plan.key
