import copy
import pickle
from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
from hypothesis import given, strategies as st

from simulation import GaussianPsf


@given(x=st.floats(0.1, 5.0), y=st.floats(0.1, 5.0), rho=st.floats(-0.95, 0.95))
def test_a_psf_is_that_of_its_covariance(x: float, y: float, rho: float) -> None:
    found = GaussianPsf.from_covariance(
        GaussianPsf(sigma_x_px=x, sigma_y_px=y, rho=rho).covariance_px2
    )
    assert found.sigma_x_px == pytest.approx(x)
    assert found.sigma_y_px == pytest.approx(y)
    assert found.rho == pytest.approx(rho, abs=1e-12)


@pytest.mark.parametrize(
    "covariance",
    [
        [[0.5, 0.6], [0.6, 0.5]],
        [[-0.5, 0.0], [0.0, 0.5]],
        [[0.5, 0.0], [0.0, 0.0]],
        [[np.nan, 0.0], [0.0, 0.5]],
    ],
)
def test_what_is_no_covariance_is_refused(covariance: list[list[float]]) -> None:
    with pytest.raises(ValueError):
        GaussianPsf.from_covariance(np.array(covariance))


def test_widths_may_be_given_in_their_order_or_one_for_a_round_psf() -> None:
    named = GaussianPsf(sigma_x_px=0.8, sigma_y_px=0.7, rho=0.1)
    assert GaussianPsf(0.8, 0.7, 0.1) == named
    assert hash(GaussianPsf(0.8, 0.7, 0.1)) == hash(named)
    assert GaussianPsf(sigma_px=0.8) == GaussianPsf(0.8, 0.8)
    assert eval(repr(named)) == named
    assert pickle.loads(pickle.dumps(named)) == named == copy.deepcopy(named)
    assert replace(named, rho=0.2) == GaussianPsf(0.8, 0.7, 0.2)
    with pytest.raises(FrozenInstanceError):
        named.rho = 0.0  # type: ignore[misc]  # on purpose


@pytest.mark.parametrize(
    ("widths", "said"),
    [
        ({}, "sigma_x_px: it is missing"),
        ({"sigma_x_px": 0.8}, "sigma_px="),
        ({"sigma_px": 0.8, "sigma_x_px": 0.8}, "leave the others out"),
        ({"sigma_px": 0.8, "rho": 0.1}, "leave the others out"),
    ],
)
def test_widths_that_are_missing_or_given_twice_are_named(
    widths: dict[str, float], said: str
) -> None:
    with pytest.raises(TypeError, match=said):
        GaussianPsf(**widths)
