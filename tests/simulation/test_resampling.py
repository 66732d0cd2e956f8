"""Banded operators, the cubic kernel, and Gaussian kernels."""

import numpy as np
import pytest
from scipy.ndimage import correlate1d, gaussian_filter, map_coordinates

from simulation.arrays import IntArray
from simulation.choices import GaussianForm
from simulation.resampling import (
    BandedMatrix,
    BlurCovariance,
    TermWeights,
    apply_separable,
    blur,
    gaussian_terms,
    mirrored_rows,
    put_separable,
    spline_sampling,
)


def random_banded(rng: np.random.Generator, rows: int, columns: int, band: int) -> BandedMatrix:
    starts = np.sort(rng.integers(0, columns - band + 1, rows))
    return BandedMatrix(starts, rng.normal(size=(rows, band)), columns)


# Sizes below, at and above the strip of 64 rows, the vectors of 16 or 8 columns, the three of them
# that are summed at a time and the 192 columns that are copied at a time; bands of any length.
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(
    ("shape", "out_shape", "bands"),
    [
        ((3, 5), (1, 2), (2, 3)),
        ((64, 65), (64, 8), (8, 16)),
        ((131, 90), (70, 131), (11, 24)),
        ((150, 451), (99, 208), (7, 33)),
    ],
)
def test_the_compiled_kernel_equals_the_dense_product(
    dtype: type[np.floating], shape: tuple[int, int], out_shape: tuple[int, int],
    bands: tuple[int, int],
) -> None:  # fmt: skip
    rng = np.random.default_rng(1)
    along_y = random_banded(rng, out_shape[0], shape[0], bands[0])
    along_x = random_banded(rng, out_shape[1], shape[1], bands[1])
    image = rng.normal(size=shape).astype(dtype)
    out = apply_separable(along_y, along_x, image)
    expected = along_y.dense() @ image.astype(np.float64) @ along_x.dense().T
    assert out.dtype == dtype
    np.testing.assert_allclose(out, expected, atol=20 * np.finfo(dtype).eps * abs(expected).max())


def test_a_view_with_gaps_is_read_like_its_copy() -> None:
    rng = np.random.default_rng(2)
    matrix = random_banded(rng, 9, 20, 8)
    image = rng.normal(size=(40, 60))[::2, ::3]
    np.testing.assert_array_equal(
        apply_separable(matrix, matrix, image), apply_separable(matrix, matrix, image.copy())
    )


def test_entries_at_one_place_add_up() -> None:
    places: IntArray = np.array([0, 0, 1], dtype=np.int64)
    columns: IntArray = np.array([2, 2, 0], dtype=np.int64)
    matrix = BandedMatrix.from_entries(2, 3, places, columns, np.array([1.0, 2.0, 4.0]))
    np.testing.assert_array_equal(matrix.dense(), [[0, 0, 3], [4, 0, 0]])


def test_an_image_of_another_size_is_refused() -> None:
    matrix = random_banded(np.random.default_rng(5), 3, 6, 2)
    with pytest.raises(ValueError):
        apply_separable(matrix, matrix, np.zeros((6, 7)))


def test_two_threads_give_the_same_bits() -> None:
    rng = np.random.default_rng(6)
    along_y, along_x = random_banded(rng, 801, 900, 7), random_banded(rng, 70, 90, 5)
    image = rng.normal(size=(900, 90)).astype(np.float32)
    results = [np.empty((801, 70), np.float32) for _ in range(2)]
    for threads, out in zip((1, 2), results, strict=True):
        put_separable(((along_y, (along_x,)),) * 2, image, out, threads=threads)
    np.testing.assert_array_equal(results[0], results[1])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_weighted_terms_equal_the_dense_products_times_their_weights(
    dtype: type[np.floating],
) -> None:
    rng = np.random.default_rng(7)
    rows, columns, terms = 90, 41, 3
    along = [
        (random_banded(rng, rows, 120, 9), random_banded(rng, columns, 70, 6)) for _ in range(terms)
    ]
    # Two columns' weights for all, the second once the whole way.
    values, part = rng.normal(size=(terms, 2, rows)), np.linspace(0, 1, columns)
    weights = TermWeights(
        values.astype(dtype), np.zeros(columns, dtype=np.int64), part.astype(dtype)
    )
    image, out = rng.normal(size=(120, 70)).astype(dtype), np.empty((rows, columns), dtype)
    put_separable(tuple((y, (x,)) for y, x in along), image, out, weights=weights)
    shares = values[:, :1].swapaxes(1, 2) * (1 - part) + values[:, 1:].swapaxes(1, 2) * part
    made = np.stack([y.dense() @ image @ x.dense().T for y, x in along])
    expected = (shares * made).sum(axis=0)
    np.testing.assert_allclose(out, expected, atol=40 * np.finfo(dtype).eps * abs(expected).max())


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


def kernel_of(
    covariance: BlurCovariance, tail_tolerance: float = 1e-4, form: GaussianForm = "transfer"
) -> np.ndarray:
    terms = gaussian_terms(covariance, tail_tolerance=tail_tolerance, form=form)
    return np.asarray(sum(np.outer(term.along_y, term.along_x) for term in terms))


@pytest.mark.parametrize("sigma_px", [0.2, 0.3, 0.5, 1.0, 3.0])
def test_the_kernel_has_the_transfer_function_of_the_gaussian_up_to_nyquist(
    sigma_px: float,
) -> None:
    (term,) = gaussian_terms(BlurCovariance(yy_px2=0, xx_px2=sigma_px**2), tail_tolerance=1e-4)
    offset = np.arange(len(term.along_x)) - len(term.along_x) // 2
    freq = np.linspace(0, 0.45, 40)
    transfer = np.cos(2 * np.pi * np.outer(freq, offset)) @ term.along_x
    # The cut tail alternates in sign: what it would add away from Nyquist is below its end.
    np.testing.assert_allclose(transfer, np.exp(-2 * (np.pi * sigma_px * freq) ** 2), atol=1e-3)


def test_a_sampled_gaussian_of_a_third_of_a_pixel_hardly_blurs_but_the_true_one_does() -> None:
    covariance = BlurCovariance(yy_px2=0, xx_px2=0.3**2)

    def variance_px2(form: GaussianForm) -> float:
        # Second moment read off the transfer function at a low frequency.
        kernel = kernel_of(covariance, 1e-5, form).ravel()
        offset = np.arange(len(kernel)) - len(kernel) // 2
        transfer = np.cos(2 * np.pi * 0.05 * offset) @ kernel
        return float(-np.log(transfer) / (2 * np.pi**2 * 0.05**2))

    assert variance_px2("transfer") == pytest.approx(0.3**2, rel=0.01)
    assert variance_px2("sampled") < 0.1**2


def test_the_sampled_form_is_the_library_filter() -> None:
    impulse = np.zeros((41, 41))
    impulse[20, 20] = 1
    kernel = kernel_of(BlurCovariance(yy_px2=4.0, xx_px2=1.0), form="sampled")
    expected = gaussian_filter(impulse, (2.0, 1.0))
    radius_y, radius_x = (size // 2 for size in kernel.shape)
    np.testing.assert_allclose(
        kernel, expected[20 - radius_y : 21 + radius_y, 20 - radius_x : 21 + radius_x], atol=1e-15
    )


@pytest.mark.parametrize("rho", [-0.6, 0.2, 0.8])
@pytest.mark.parametrize("sigma_px", [0.4, 1.5])
def test_a_correlated_gaussian_is_a_short_sum_of_products_with_the_right_transfer(
    rho: float, sigma_px: float
) -> None:
    xx_px2, yy_px2 = (1.2 * sigma_px) ** 2, sigma_px**2
    xy_px2 = rho * 1.2 * sigma_px**2
    covariance = BlurCovariance(yy_px2=yy_px2, xx_px2=xx_px2, xy_px2=xy_px2)
    kernel = kernel_of(covariance, 1e-5)
    y, x = (np.arange(size) - size // 2 for size in kernel.shape)
    freq = np.linspace(-0.4, 0.4, 17)
    transfer = (
        np.exp(-2j * np.pi * np.outer(freq, y)) @ kernel @ np.exp(-2j * np.pi * np.outer(x, freq))
    )
    fy, fx = freq[:, None], freq[None, :]
    expected = np.exp(-2 * np.pi**2 * (yy_px2 * fy**2 + 2 * xy_px2 * fy * fx + xx_px2 * fx**2))
    # Opposite signs of a frequency meet at Nyquist, where a correlated Gaussian has a step: the
    # cut makes it ring by some thousandths where the Gaussian is narrow.
    np.testing.assert_allclose(transfer, expected, atol=0.01 if sigma_px < 1 else 2e-3)
    assert len(gaussian_terms(covariance, tail_tolerance=1e-5)) <= 14


@pytest.mark.parametrize("xy_px2", [0.0, 0.3])
@pytest.mark.parametrize("prefilter", [False, True])
def test_kernels_sum_to_one(xy_px2: float, prefilter: bool) -> None:
    terms = gaussian_terms(
        BlurCovariance(yy_px2=0.5, xx_px2=0.6, xy_px2=xy_px2),
        tail_tolerance=1e-3,
        spline_prefilter=prefilter,
    )
    total = sum(term.along_y.sum() * term.along_x.sum() for term in terms)
    assert total == pytest.approx(1, abs=1e-12)


def test_an_impossible_covariance_is_refused() -> None:
    with pytest.raises(ValueError):
        BlurCovariance(yy_px2=1.0, xx_px2=1.0, xy_px2=1.1)


def test_a_sampled_gaussian_has_no_spline_prefilter() -> None:
    with pytest.raises(ValueError):
        gaussian_terms(
            BlurCovariance(yy_px2=1.0, xx_px2=1.0),
            tail_tolerance=1e-3,
            spline_prefilter=True,
            form="sampled",
        )


def test_a_correlated_sampled_gaussian_is_its_density_at_the_pixels() -> None:
    # Pearson's bivariate normal, order (x, y), normalised to 1 over the pixels.
    covariance = BlurCovariance(yy_px2=1.0, xx_px2=2.25, xy_px2=0.6)
    kernel = kernel_of(covariance, form="sampled")
    assert kernel.shape == (9, 13)  # four sigmas either way
    inverse = np.linalg.inv([[2.25, 0.6], [0.6, 1.0]])
    y, x = np.mgrid[-4:5, -6:7].astype(np.float64)
    form = inverse[0, 0] * x**2 + 2 * inverse[0, 1] * x * y + inverse[1, 1] * y**2
    density = np.exp(-0.5 * form)
    # Terms are left out below 3e-5.
    np.testing.assert_allclose(kernel, density / density.sum(), atol=4e-5)
