"""Lenses of the prior, beside a closed form and differences."""

import numpy as np

from calibration.blind._lens_prior import GAUSSIAN_PARAMETERS, LensGrid, lens_prior, lens_transfer


def test_its_first_parameters_are_a_gaussian_behind_a_pixel() -> None:
    fx, fy = np.random.default_rng(2).uniform(-0.5, 0.5, (2, 40))
    lens = np.zeros(lens_prior().mean.size)
    lens[:GAUSSIAN_PARAMETERS] = xx, xy, yy = 0.4, 0.1, 0.3
    form = xx * fx**2 + 2 * xy * fx * fy + yy * fy**2
    expected = np.sinc(fx) * np.sinc(fy) * np.exp(-2 * np.pi**2 * form)
    np.testing.assert_allclose(LensGrid(fx, fy).factors(lens).transfer, expected, rtol=1e-12)


def test_slopes_are_those_of_the_transfer() -> None:
    fx, fy = np.random.default_rng(3).uniform(-0.6, 0.6, (2, 30))
    grid, rng = LensGrid(fx, fy), np.random.default_rng(4)
    lens = lens_prior().mean + 0.2 * rng.normal(size=lens_prior().mean.size)
    slopes = grid.slopes(grid.factors(lens))
    for number in range(0, lens.size, 5):
        step = 1e-6 * np.eye(lens.size)[number]
        change = grid.factors(lens + step).transfer - grid.factors(lens - step).transfer
        np.testing.assert_allclose(slopes[number], change / 2e-6, atol=1e-6)


def test_a_lens_at_some_frequencies_is_that_of_their_grid() -> None:
    fx, fy = np.random.default_rng(6).uniform(-1.2, 1.2, (2, 50))
    lens = lens_prior().mean + 0.3 * np.random.default_rng(7).normal(size=lens_prior().mean.size)
    expected = LensGrid(fx, fy).factors(lens).transfer
    np.testing.assert_allclose(lens_transfer(lens, fx, fy), expected, rtol=1e-9, atol=1e-12)
