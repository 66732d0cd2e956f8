import numpy as np
import pytest
from scipy.ndimage import correlate1d, map_coordinates

from simulation.resampling import (
    BlurCovariance,
    blur,
    gaussian_terms,
    mirrored_rows,
    spline_sampling,
)


def test_the_blur_mirrors_the_image_at_its_edge() -> None:
    rng = np.random.default_rng(1)
    signal, kernel = rng.normal(size=30), np.array([0.1, 0.2, 0.4, 0.2, 0.1])
    expected = correlate1d(signal, kernel, mode="reflect")
    np.testing.assert_allclose(blur(kernel, 30).dense() @ signal, expected, atol=1e-14)


def test_a_kernel_is_convolved_not_correlated() -> None:
    impulse = np.zeros(9)
    impulse[4] = 1
    blurred = blur(np.array([1.0, 2.0, 4.0]), 9).dense() @ impulse
    np.testing.assert_array_equal(blurred[3:6], [1, 2, 4])


def test_a_kernel_longer_than_the_image_is_folded_until_it_fits() -> None:
    matrix = blur(np.full(41, 1 / 41), 6).dense()
    np.testing.assert_allclose(matrix.sum(axis=1), 1, atol=1e-14)


def test_without_blur_it_is_quintic_spline_interpolation() -> None:
    rng = np.random.default_rng(2)
    signal, positions = rng.normal(size=80), np.array([30.0, 33.3, 40.71, 41.5])
    (term,) = gaussian_terms(
        BlurCovariance(yy_px2=0, xx_px2=0), tail_tolerance=1e-10, spline_prefilter=True
    )
    expected = map_coordinates(signal, [positions], order=5)
    sampled = spline_sampling(positions, term.along_x, 80).dense() @ signal
    np.testing.assert_allclose(sampled, expected, atol=1e-7)


@pytest.mark.parametrize("power", [0, 1, 2, 3, 4, 5])
def test_the_spline_reproduces_polynomials_up_to_its_degree(power: int) -> None:
    (term,) = gaussian_terms(
        BlurCovariance(yy_px2=0, xx_px2=0), tail_tolerance=1e-10, spline_prefilter=True
    )
    positions = np.linspace(65, 75, 23)
    grid = (np.arange(140) - 70) / 10
    sampled = spline_sampling(positions, term.along_x, 140).dense() @ grid**power
    np.testing.assert_allclose(sampled, ((positions - 70) / 10) ** power, atol=1e-6)


@pytest.mark.parametrize("size", [4, 30])
def test_rows_beyond_the_edge_read_the_mirrored_image(size: int) -> None:
    rng = np.random.default_rng(3)
    signal, weights = rng.normal(size=size), rng.normal(size=(4, 7))
    starts = np.array([-6, -1, size - 4, size - 1])
    around = np.pad(signal, 10, mode="symmetric")
    expected = [around[start + 10 :][:7] @ row for start, row in zip(starts, weights, strict=True)]
    out = mirrored_rows(starts, weights, size).dense() @ signal
    np.testing.assert_allclose(out, expected, atol=1e-13)
