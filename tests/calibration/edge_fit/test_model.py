import numpy as np
import pytest

from calibration.edges import edge_profile
from tests.calibration.closed_form import pixel_edge, point_edge

DISTANCES = np.linspace(-6.0, 6.0, 97)


@pytest.mark.parametrize("sigma_px", [0.3, 0.8, 2.5])
@pytest.mark.parametrize("normal_deg", [0.0, 0.05, 5.0, 30.0, 45.0, 89.9, 135.0, 200.0])
def test_the_pixel_edge_is_the_blurred_step_averaged_over_the_pixel(
    sigma_px: float, normal_deg: float
) -> None:
    normal = float(np.deg2rad(normal_deg))
    # The one-dimensional form near the axes is good to b^2 / 24 of the curvature: 4e-7.
    expected = pixel_edge(DISTANCES, sigma_px, normal)
    np.testing.assert_allclose(edge_profile(DISTANCES, sigma_px, normal), expected, atol=5e-7)


def test_without_an_angle_the_edge_is_a_cumulative_gaussian() -> None:
    # The table of Phi is good to 3e-10 and ends at 6 sigma, at 1e-9.
    np.testing.assert_allclose(edge_profile(DISTANCES, 0.7), point_edge(DISTANCES, 0.7), atol=1e-9)


def test_far_from_the_edge_the_levels_are_those_of_the_sides() -> None:
    far = np.array([-50.0, 50.0])
    np.testing.assert_array_equal(edge_profile(far, 0.5, 0.3), [0.0, 1.0])
