import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from simulation import GaussianPsf, SamplingGrid, zoom_out_on_grid
from simulation.zoom import BlurredSpline
from tests.simulation.closed_form import photograph, random_scene

PSF = GaussianPsf(sigma_x_px=0.72, sigma_y_px=0.64, rho=0.2)
IMAGE = photograph(random_scene(5, 300, 250), (90, 120), 1.0, 0.6, (-45, -60))


@pytest.mark.parametrize("zoom", [1.0, 1.3, 2.5])
def test_on_a_grid_it_is_the_matched_model(zoom: float) -> None:
    grid = SamplingGrid.centred((90, 120), zoom)
    y, x = np.meshgrid(grid.rows_px, grid.cols_px, indexing="ij")
    found = BlurredSpline.of(IMAGE, PSF, zoom).at(y, x)
    expected = zoom_out_on_grid(IMAGE, grid, PSF, "matched")
    # Both cut the kernels' tails where weights are below 1e-3, one of them a second time.
    np.testing.assert_allclose(found, expected, atol=0.1)


@settings(max_examples=15)
@given(level=st.floats(-1e3, 1e3), zoom=st.floats(0.99, 3.5))
def test_a_constant_stays_a_constant_even_beyond_the_border(level: float, zoom: float) -> None:
    spline = BlurredSpline.of(np.full((40, 50), level), PSF, zoom)
    places = np.array([-3.0, 0.3, 17.71, 43.0])
    np.testing.assert_allclose(spline.at(places, places[::-1]), level, rtol=1e-9, atol=1e-9)
