"""What a correlation that no edge tells does to the widths."""

import numpy as np
import pytest
from hypothesis import given, strategies as st

from calibration.psf import fit_covariance, share_of_correlation


def test_an_edge_five_degrees_off_upright_hides_nearly_a_tenth_of_rho() -> None:
    # sin 5 cos 5 / cos^2 5 = tan 5 degrees.
    assert share_of_correlation(np.array([95.0])) == pytest.approx(np.tan(np.deg2rad(5.0)))
    assert share_of_correlation(np.array([90.0])) == pytest.approx(0.0, abs=1e-15)
    assert share_of_correlation(np.array([85.0, 95.0])) == pytest.approx(0.0, abs=1e-15)
    assert share_of_correlation(np.array([45.0])) == 0.0  # no width along an axis comes of it


@given(lean_deg=st.floats(-15.0, 15.0), rho=st.floats(-0.15, 0.15))
def test_the_fitted_width_is_off_by_that_share(lean_deg: float, rho: float) -> None:
    angles = np.array([90.0 + lean_deg])
    normal = np.deg2rad(angles + 90.0)
    nx, ny = np.cos(normal), np.sin(normal)
    across = np.sqrt(nx**2 + 2 * rho * nx * ny + ny**2)  # widths of 1 px
    found = fit_covariance(angles, across, np.full(1, 0.001)).sigma_x_px
    assert found is not None
    expected = abs(rho) * share_of_correlation(angles)
    assert abs(found.value - 1.0) == pytest.approx(expected, rel=0.1, abs=1e-12)
