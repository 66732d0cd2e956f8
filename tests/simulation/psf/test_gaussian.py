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
