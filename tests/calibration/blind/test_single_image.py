"""The PSF from edges of which many are soft: widths drawn from the model, truth known."""

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from scipy.integrate import quad

from calibration.blind.calibration import FEWEST_EDGES, _log_modified_gaussian, fit_sharpest_widths
from simulation.arrays import FloatArray


def drawn(
    count: int, covariance: FloatArray, softness_px2: float, err: float = 0.05, seed: int = 1
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Angles, widths and errors of edges of a scene; ``err`` is relative."""
    rng = np.random.default_rng(seed)
    angles = rng.uniform(0, 180, count)
    normal = np.deg2rad(angles + 90)
    n = np.stack([np.cos(normal), np.sin(normal)])
    sharp = np.einsum("ik,ij,jk->k", n, covariance, n)
    width = np.sqrt(sharp + (rng.exponential(softness_px2, count) if softness_px2 else 0.0))
    errs = err * width
    return angles, np.abs(width + errs * rng.standard_normal(count)), errs


@pytest.mark.parametrize("softness_px2", [0.0, 0.2, 1.0])
def test_the_sharpest_edges_tell_the_psf(softness_px2: float) -> None:
    psf = np.array([[0.49, 0.03], [0.03, 0.40]])
    found = fit_sharpest_widths(*drawn(800, psf, softness_px2))
    widths = np.sqrt(np.diag(found.covariance_px2))
    np.testing.assert_allclose(widths, np.sqrt(np.diag(psf)), rtol=0.04)
    assert found.softness_px2 == pytest.approx(softness_px2, abs=0.05 + 0.15 * softness_px2)


@pytest.mark.parametrize("left", [-0.3, 0.0, 0.5, 3.0])
@pytest.mark.parametrize("mean", [0.02, 0.3, 2.0])
def test_the_density_is_the_convolution_of_both(left: float, mean: float) -> None:
    err = 0.1

    def product(excess: float) -> float:
        scaled = (left - excess) / err
        gaussian = np.exp(-0.5 * scaled**2) / (err * np.sqrt(2 * np.pi))
        return float(gaussian * np.exp(-excess / mean) / mean)

    peak = max(left - err**2 / mean, 0.0)
    near = [peak, peak + err] if peak == 0.0 else [peak - err, peak, peak + err]
    expected, _ = quad(product, 0.0, peak + 20 * err, points=near, limit=500, epsabs=0.0)
    found = _log_modified_gaussian(np.array([left]), np.array([err]), mean)
    assert np.exp(found[0]) == pytest.approx(expected, rel=1e-6)


@pytest.mark.parametrize("mean", [1e-300, 1e-12, 1e-3])
def test_the_density_of_a_vanishing_softness_is_gaussian(mean: float) -> None:
    left, err = np.linspace(-0.5, 0.5, 11), np.full(11, 0.1)
    gaussian = -0.5 * (left / err) ** 2 - np.log(err * np.sqrt(2 * np.pi))
    found = _log_modified_gaussian(left, err, mean)
    # To first order in the mean: the Gaussian is shifted by it.
    np.testing.assert_allclose(found, gaussian + left * mean / err**2, atol=60 * mean + 1e-12)


@pytest.mark.slow
@settings(max_examples=10, deadline=None)
# The cost overflowed, and the width came out as 0.114.
@example(width=0.75, softness=0.5, seed=838)
@example(width=0.75, softness=0.5, seed=0)
@given(width=st.floats(0.5, 1.5), softness=st.floats(0.05, 1.5), seed=st.integers(0, 1000))
def test_a_hundred_edges_give_the_width_to_a_seventh(
    width: float, softness: float, seed: int
) -> None:
    psf = width**2 * np.eye(2)
    found = fit_sharpest_widths(*drawn(100, psf, softness * width**2, seed=seed))
    mean_width = np.linalg.det(found.covariance_px2) ** 0.25
    assert mean_width == pytest.approx(width, rel=1 / 7)


@pytest.mark.slow
def test_the_claimed_error_is_that_of_the_scatter() -> None:
    psf = 0.36 * np.eye(2)
    fits = [fit_sharpest_widths(*drawn(60, psf, 0.3, seed=seed)) for seed in range(40)]
    values = np.array([fit.covariance_px2[0, 0] for fit in fits])
    claimed = np.sqrt([fit.covariance_err_px2[0, 0] for fit in fits])
    assert 0.6 < np.std(values) / np.median(claimed) < 1.6


def test_outliers_do_not_pull() -> None:
    psf = 0.36 * np.eye(2)
    angles, widths, errs = drawn(300, psf, 0.2)
    widths[::25] = 0.2  # thin lines taken for edges
    found = fit_sharpest_widths(angles, widths, errs)
    assert np.linalg.det(found.covariance_px2) ** 0.25 == pytest.approx(0.6, rel=0.06)


def test_too_few_sure_edges_are_refused() -> None:
    angles, widths, errs = drawn(30, 0.36 * np.eye(2), 0.2)
    errs[FEWEST_EDGES - 1 :] = widths[FEWEST_EDGES - 1 :]
    with pytest.raises(ValueError):
        fit_sharpest_widths(angles, widths, errs)
    errs[FEWEST_EDGES - 1] = 0.1 * widths[FEWEST_EDGES - 1]
    assert fit_sharpest_widths(angles, widths, errs).edges_used == FEWEST_EDGES
