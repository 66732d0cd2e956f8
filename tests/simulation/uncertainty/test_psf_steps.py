import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from simulation import GaussianPsf
from simulation.arrays import FloatArray
from simulation.uncertainty import PsfStep, principal_steps

VALUES = np.array([0.75, 0.8, 0.1])


def psf_of(values: FloatArray) -> GaussianPsf:
    return GaussianPsf(*values.tolist())


def covariance_of(steps: tuple[PsfStep, ...]) -> FloatArray:
    """The sum of the squares of the steps."""
    total = np.zeros((3, 3))
    for step in steps:
        sides = [
            np.array([psf.sigma_x_px, psf.sigma_y_px, psf.rho])
            for psf in (step.plus, step.minus)
            if isinstance(psf, GaussianPsf)
        ]
        one = (sides[0] - sides[1]) / step.length
        total += np.outer(one, one)
    return total


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 10**6), zoom=st.floats(1.1, 3.0))
def test_independent_steps_add_up_to_the_covariance(seed: int, zoom: float) -> None:
    # Of widths whose errors are alike, all directions matter, and the steps are the covariance.
    root = np.random.default_rng(seed).normal(size=(3, 3)) + 2 * np.eye(3)
    covariance = 1e-6 * root @ root.T
    found = covariance_of(principal_steps(psf_of, VALUES, covariance, zoom))
    # Directions left out hold 1e-3 of what the follow-up shows.
    assert np.trace(found) == pytest.approx(np.trace(covariance), rel=0.2)
    assert np.all(np.linalg.eigvalsh(covariance - found) > -1e-9 * np.trace(covariance))


def test_a_direction_that_changes_nothing_is_left_out() -> None:
    assert principal_steps(psf_of, VALUES, np.zeros((3, 3)), 2.0) == ()
    # A width known a thousand times better than the other.
    (step,) = principal_steps(psf_of, VALUES, np.diag([1e-4, 1e-10, 0.0]), 2.0)
    assert isinstance(step.plus, GaussianPsf)
    assert step.plus.sigma_y_px == pytest.approx(0.8, abs=1e-3)


def test_where_one_side_is_no_psf_the_other_is_taken() -> None:
    def bounded(values: FloatArray) -> GaussianPsf:
        if values[0] < 0.75:
            raise ValueError("too narrow")
        return psf_of(values)

    (step,) = principal_steps(bounded, VALUES, np.diag([1e-4, 0.0, 0.0]), 2.0)
    sides = {step.plus, step.minus}
    assert psf_of(VALUES) in sides
    assert max(p.sigma_x_px for p in sides if isinstance(p, GaussianPsf)) == pytest.approx(
        0.75 + 0.01 * step.length
    )
