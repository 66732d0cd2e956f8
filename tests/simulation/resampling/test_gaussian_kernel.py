import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from simulation.choices import GaussianForm
from simulation.resampling import BlurCovariance, gaussian_terms


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
