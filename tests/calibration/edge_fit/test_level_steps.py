import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.special import log_ndtr

from calibration.edges.residuals import level_steps
from calibration.edges.rounded import interval_terms
from tests.calibration.closed_form import edge_image


def eight_bits(noise_dn: float = 0.3, seed: int = 1) -> np.ndarray:
    edge = edge_image(1.1, 7.0, low_dn=23.3, high_dn=65.1)
    return np.rint(edge + np.random.default_rng(seed).normal(0.0, noise_dn, edge.shape))


@pytest.mark.slow
@given(step=st.sampled_from([1 / 16, 1 / 3, 0.25, 1.0, 16.0, 257.0]), offset=st.floats(-50, 50))
def test_the_step_of_an_even_grid_is_found(step: float, offset: float) -> None:
    values = (eight_bits() * step + offset).ravel()
    found = level_steps(values)
    assert found.is_found
    np.testing.assert_allclose(found.upper - found.lower, step, rtol=1e-6)
    np.testing.assert_allclose((found.upper + found.lower) / 2, values, rtol=0, atol=1e-9 * step)


def test_the_steps_of_linear_light_grow_as_its_curve_does() -> None:
    codes = eight_bits().ravel()
    found = level_steps(255 * (codes / 255) ** 2.2)
    assert found.is_found
    # Where a code ends is half way to the next, to the curvature of the power over half a code.
    np.testing.assert_allclose(found.upper, 255 * ((codes + 0.5) / 255) ** 2.2, rtol=2e-3)


def test_levels_without_steps_have_none() -> None:
    noisy = edge_image(1.1, 7.0) + np.random.default_rng(3).normal(0.0, 100.0, (90, 110))
    assert not level_steps(noisy.ravel()).is_found
    for normal_deg in (0.0, 7.0, 45.0):
        assert not level_steps(edge_image(1.1, normal_deg).ravel()).is_found


def test_few_pixels_and_two_levels_tell_no_steps() -> None:
    assert not level_steps(np.arange(20.0)).is_found
    assert not level_steps(np.repeat([8.0, 52.0], 500)).is_found


@given(below=st.floats(-6.0, 6.0), width=st.floats(0.2, 4.0), s=st.floats(0.2, 3.0))
def test_the_derivatives_of_the_likelihood_are_its_differences(
    below: float, width: float, s: float
) -> None:
    step = 1e-4

    def terms(level: float, log_s: float) -> np.ndarray:
        away = below - level
        return np.array(interval_terms(away, away + width, float(np.exp(log_s))))

    here = terms(0.0, np.log(s))
    by_level = (terms(step, np.log(s)) - terms(-step, np.log(s))) / (2 * step)
    by_s = (terms(0.0, np.log(s) + step) - terms(0.0, np.log(s) - step)) / (2 * step)
    # Central differences: off by the third derivative times step^2, below 1e-8 of any scale here.
    scale = 1 + np.abs(here).max()
    assert here[[1, 3, 5]] == pytest.approx(by_level[[0, 1, 2]], abs=2e-4 * scale)
    assert here[[2, 5, 4]] == pytest.approx(by_s[[0, 1, 2]], abs=2e-4 * scale)
    assert here[3] <= 0  # Pratt (1981): concave in the level


def test_a_level_far_outside_its_interval_still_pulls_towards_it() -> None:
    far = interval_terms(-2000.0, -1999.0, 0.5)
    # Towards it, by the distance over the variance: the tail's slope, to 1 / distance^2.
    assert far[1] == pytest.approx(-1999.0 / 0.25, rel=1e-5)
    assert interval_terms(1999.0, 2000.0, 0.5)[1] == pytest.approx(-far[1])


@given(away=st.floats(9.0, 11.0), width=st.floats(0.1, 4.0), s=st.floats(0.05, 3.0))
def test_the_far_tail_continues_the_near_one(away: float, width: float, s: float) -> None:
    found = interval_terms(away * s, away * s + width, s)
    upper = log_ndtr(-away) + np.log1p(-np.exp(log_ndtr(-away - width / s) - log_ndtr(-away)))
    # The density over the probability, in logarithms as scipy computes them.
    first = np.exp(-0.5 * away**2 - 0.5 * np.log(2 * np.pi) - upper)
    second = np.exp(-0.5 * (away + width / s) ** 2 - 0.5 * np.log(2 * np.pi) - upper)
    assert found[0] == pytest.approx(upper, rel=1e-9)
    assert found[1] * s == pytest.approx(first - second, rel=1e-9)
