"""The candidate for two distances, beside blobs and lenses in closed form."""

import numpy as np
import pytest

from benchmarks.lens_between.cosine_blocks import WholeBlocks
from benchmarks.lens_between.lens_prior import GAUSSIAN_PARAMETERS, LensGrid, lens_prior
from benchmarks.lens_between.pairs import NearAndFar, lens_between
from tests.calibration.blob_scene import blob_photograph

TO_NEAR = np.array([[2.0, 0.0, -159.5], [0.0, 2.0, -119.5], [0.0, 0.0, 1.0]])


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


def test_cosines_of_whole_blocks_keep_their_power() -> None:
    rng = np.random.default_rng(5)
    used = np.ones((24, 32), dtype=np.bool_)
    used[3, 5] = False  # one block is not whole
    image = rng.normal(size=used.shape)
    blocks = WholeBlocks(used)
    assert blocks.count == 11
    power = float(np.sum(image**2) - np.sum(image[:8, :8] ** 2))
    assert np.sum(blocks.cosines(image) ** 2) == pytest.approx(power)


@pytest.mark.slow
def test_a_gaussian_lens_is_found_without_noise() -> None:
    covariance = np.array([[0.45, 0.08], [0.08, 0.33]])
    near, far = (blob_photograph(zoom, covariance) for zoom in (1.0, 2.0))
    pair = NearAndFar(near_dn=near, far_dn=far, near_noise_dn2=0.0)
    found = lens_between(pair, TO_NEAR).nearest_gaussian()
    np.testing.assert_allclose(found.px2, [0.45, 0.08, 0.33], atol=0.02)


@pytest.mark.slow
def test_noise_of_the_near_photograph_alone_is_no_blur() -> None:
    # Taken for what the whole resampled frame has, where the near one ends within it, it gave a
    # width of 0.25 px for 0.57.
    covariance = np.array([[0.45, 0.08], [0.08, 0.33]])
    near, far = (blob_photograph(zoom, covariance) for zoom in (1.0, 2.0))
    noisy = near + np.random.default_rng(5).normal(0, 20.0, near.shape)
    pair = NearAndFar(near_dn=noisy, far_dn=far, near_noise_dn2=400.0)
    found = lens_between(pair, TO_NEAR).nearest_gaussian()
    np.testing.assert_allclose(np.sqrt(found.px2[[0, 2]]), np.sqrt([0.45, 0.33]), rtol=0.05)
