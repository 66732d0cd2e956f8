"""Sides of squares in closed form, whose frame is near."""

import math

import numpy as np
import pytest

from benchmarks.studies.edge_sides import SidesTally, Square, measured, square_along_pixels
from benchmarks.truth.edges import Rectangle, patches


def test_the_closed_form_of_a_square_is_its_quadrature() -> None:
    square = Rectangle(x_px=20.3, y_px=17.9, half_px=(9.2, 6.1), angle_rad=0.0, level_dn=3.0)
    shape = 36, 42
    expected = patches(shape, [square], 0.0, 0.9)
    # Four nodes a pixel are exact to 1e-6 at sigma 0.5, and beyond 7 sigma nothing is added.
    np.testing.assert_allclose(square_along_pixels(square, shape, 0.9), expected, atol=1e-6)


@pytest.mark.slow
def test_no_side_along_the_pixels_is_lost_and_its_width_is_exact_without_noise() -> None:
    rng = np.random.default_rng(11)
    tally = SidesTally()
    for sigma_px in (0.4, 0.7, 1.0, 1.4, 1.9, 2.5, 3.0):
        for angle_deg in (0.0, 0.5, 1.0):
            for snr in (math.inf, math.inf, 500.0, 100.0):
                square = Square.drawn(rng, sigma_px, angle_deg, snr)
                tally.add(square, measured(square.image_dn(rng)))
    assert tally.sides == 336
    # Before, noise of the arithmetic lost one in 80 of the sides without noise.
    assert tally.lost == []
    assert tally.worst < 5e-5, tally.worst_name
