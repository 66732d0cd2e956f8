"""How sure a d' is: closed forms of its errors, and a scene whose d' is known in closed form."""

from math import exp, log

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.special import ndtr

from analysis.detectability import (
    CurveUncertainty,
    DetectabilityCurve,
    DetectabilityCurves,
    DetectionTask,
    DPrimeErrors,
    DPrimeSlopes,
    ErrorSources,
    d_prime_curves,
)
from analysis.detectability.error_sources import focus_spread, registration_spread
from benchmarks.truth.gaussian_scenes import GaussianScene, true_d_prime
from simulation import GaussianPsf

PSF_PX2 = 0.64
ZOOMS = (1.2, 1.57)
SCENE = GaussianScene()


def slopes(**stated: float) -> DPrimeSlopes:
    return DPrimeSlopes(**({"psf_per_px2": -1.25, "noise": -0.2} | stated))


def test_normal_errors_add_in_quadrature() -> None:
    sources = ErrorSources(psf_variance_err_px2=0.02, noise_relative_err=0.1)
    found = CurveUncertainty(sources=sources, scene=[0.03], slopes=[slopes()])
    errors = found.errors([1.5], 1.5)
    expected = (0.03**2 + 0.025**2 + 0.02**2) ** 0.5  # closed form
    assert errors.standard_error == pytest.approx(expected)
    low, high = errors.interval(2.0)
    assert (log(low / 2), log(high / 2)) == pytest.approx((-1.96 * expected, 1.96 * expected), 1e-4)
    assert errors.probability_of(1.9, 2.0) == pytest.approx(float(ndtr(log(2 / 1.9) / expected)))
    assert [one.source for one in errors.budget] == ["scene", "psf", "noise"]
    assert sum(one.share for one in errors.budget) == pytest.approx(1)


def test_a_focus_that_blurs_the_signal_alone_scatters_normally() -> None:
    spread = focus_spread(slopes(signal_per_px2=-2.0), 0.05)
    assert spread.variance == pytest.approx(0.1**2, rel=2e-3)  # closed form
    errors = DPrimeErrors(variances={"scene": 0.02**2}, spreads={"focus": spread})
    reach = 1.959964 * (0.1**2 + 0.02**2) ** 0.5
    assert errors.interval(1.0) == pytest.approx((exp(-reach), exp(reach)), rel=5e-3)


def test_a_registration_error_lowers_d_prime_as_its_integral_says() -> None:
    spread = registration_spread(0.5)
    # E ln(1 + q u) / 2 with u exponential is exp(1 / q) E1(1 / q) / 2: E1(2) = 0.0489005107.
    assert float(spread.weights @ spread.values) == pytest.approx(
        -0.5 * exp(2) * 0.0489005107, rel=5e-3
    )
    assert np.all(spread.values <= 0)


@given(
    st.floats(0.1, 5),
    st.floats(0.1, 5),
    st.floats(0.001, 0.3),
    st.floats(0, 0.2),
    st.floats(-3, 3),
)
def test_the_interval_and_the_probability_say_the_same(
    d_prime: float, threshold: float, err: float, scatter_px2: float, signal: float
) -> None:
    focus = focus_spread(slopes(signal_per_px2=signal, followup_per_px4=5.0), scatter_px2)
    errors = DPrimeErrors(variances={"scene": err**2}, spreads={"focus": focus})
    low, high = errors.interval(d_prime)
    assert low <= high
    assert errors.probability_of(low, d_prime) == pytest.approx(0.975, abs=1e-4)
    assert errors.probability_of(high, d_prime) == pytest.approx(0.025, abs=1e-4)
    probability = errors.probability_of(threshold, d_prime)
    assert (threshold <= low) <= (probability >= 0.9749)
    assert (threshold >= high) <= (probability <= 0.0251)


def test_what_is_not_known_is_named_and_counts_for_nothing() -> None:
    found = CurveUncertainty(scene=[0.1], slopes=[slopes(signal_per_px2=-3.0)])
    assert found.sources.unknown == ("psf", "focus", "noise", "registration")
    assert found.errors([1.0], 1.0).standard_error == pytest.approx(0.1)


def _curve(images: int, psf: GaussianPsf, seed: int) -> DetectabilityCurve:
    rng = np.random.default_rng(seed)
    scenes = [SCENE.photograph(400, PSF_PX2, rng) for _ in range(images)]
    task = DetectionTask(
        noises_dn=(2.0,), models=("matched",), observers=("hotelling",), zooms=ZOOMS
    )
    return d_prime_curves(scenes, psf, task).curves[0]


@pytest.mark.slow
def test_d_prime_is_that_of_a_scene_known_in_closed_form() -> None:
    found = _curve(6, GaussianPsf(sigma_px=PSF_PX2**0.5), 5)
    expected = [true_d_prime(SCENE, PSF_PX2, zoom, 2.0, 12.0) for zoom in ZOOMS]
    assert found.dprime == pytest.approx(expected, rel=0.02)


@pytest.mark.slow
def test_slopes_are_those_of_the_closed_form() -> None:
    found = _curve(4, GaussianPsf(sigma_px=PSF_PX2**0.5), 6)
    assert found.uncertainty is not None
    step_px2 = 0.05
    for zoom, slope in zip(ZOOMS, found.uncertainty.slopes, strict=True):
        ends = [
            [
                log(true_d_prime(SCENE, PSF_PX2, zoom, 2.0, 12.0, (sign * a, sign * b)))
                for sign in (-1, 1)
            ]
            for a, b in ((0.0, step_px2), (step_px2, 0.0))
        ]
        followup, reference = ((high - low) / (2 * step_px2) for low, high in ends)
        own = slope.signal_per_px2 - slope.with_followup_per_px2
        assert own == pytest.approx(followup, rel=0.06)
        assert -slope.with_reference_per_px2 == pytest.approx(reference, rel=0.06)


def test_a_curve_of_before_is_judged_by_its_interval() -> None:
    curve = DetectabilityCurve(
        model="matched",
        observer="hotelling",
        noise_dn=2.0,
        contrast_dn=12.0,
        signal_sigma_px=2.0,
        zoom=[1.0, 2.0],
        dprime=[4.0, 2.0],
        dprime_low=[4 * exp(-0.2), 2 * exp(-0.2)],
        dprime_high=[4 * exp(0.2), 2 * exp(0.2)],
        auc=[0.9, 0.8],
    )
    errors = curve.errors_at(2.0)
    assert errors.standard_error == pytest.approx(0.2 / 1.959964)
    assert curve.with_sources(ErrorSources(focus_scatter_px2=1.0)) == curve


def test_too_few_photographs_are_told_how_many_would_do() -> None:
    def document(err: float, images: int) -> DetectabilityCurves:
        found = CurveUncertainty(scene=[err], slopes=[slopes()])
        curve = DetectabilityCurve(
            model="matched",
            observer="hotelling",
            noise_dn=2.0,
            contrast_dn=12.0,
            signal_sigma_px=2.0,
            zoom=[1.5],
            dprime=[2.0],
            dprime_low=[1.0],
            dprime_high=[3.0],
            auc=[0.9],
            uncertainty=found,
        )
        return DetectabilityCurves(images=images, curves=[curve]).with_need()

    assert document(0.05, 4).photographs_needed is None  # 1.96 * .05 is below .1
    few = document(0.1, 4)
    assert few.photographs_needed == 16  # 4 (.196 / .1)^2 = 15.4
    assert (few.too_few_sentence or "").startswith("4 photographs leave d' uncertain by up to 20 %")
    assert "about 16 of the scene" in (few.too_few_sentence or "")
