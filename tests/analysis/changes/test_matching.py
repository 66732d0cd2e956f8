"""Blur, kernel, rounding and scatter between two photographs, against closed forms."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, laplace, map_coordinates

from analysis.changes.matching import (
    GRADIENT,
    MatchingKernel,
    PixelPositions,
    RelativeBlur,
    Smoothing,
    VarianceTerms,
    calibrated_blur_px2,
    calibrated_factor,
    fit_tone_curve,
    rounding_variance,
    smoothed,
    smoothing_for,
    spline_coefficients,
    white_noise_gain,
)
from analysis.changes.matching._matching_kernel import NormalEquations, design_matrix
from analysis.changes.matching._variance import fit_sizes
from analysis.changes.matching.relative_blur import relative_blur
from simulation import GaussianPsf
from simulation.arrays import Float32Array, FloatArray, FloatImage

SIDE = 7
SHAPE = (160, 200)


def texture(seed: int, width_px: float = 1.5) -> Float32Array:
    noise = np.random.default_rng(seed).standard_normal(SHAPE)
    return (40 * gaussian_filter(noise, width_px) / 0.2 + 100).astype(np.float32)


def fitted(source: Float32Array, target: FloatImage) -> MatchingKernel:
    rows, cols = (part.ravel() for part in np.mgrid[5 : SHAPE[0] - 5 : 2, 5 : SHAPE[1] - 5 : 2])
    level = float(source.mean())
    design = design_matrix(source, level, rows, cols)
    measured = target[rows, cols].astype(np.float64)
    equations = NormalEquations.of(design, measured, np.ones(len(rows)), centre=1.0)
    return MatchingKernel(coefficients=equations.solution(), level_dn=level)


def test_a_known_kernel_light_and_offset_are_recovered() -> None:
    source = texture(1)
    taps = np.zeros((SIDE, SIDE))
    taps[3, 2:5], taps[2, 3], taps[4, 4] = (0.2, 0.9, 0.1), 0.15, -0.05
    target = np.zeros(SHAPE)
    for row, col in np.argwhere(taps):
        target += taps[row, col] * np.roll(source, (3 - row, 3 - col), (0, 1))
    x = np.linspace(-1, 1, SHAPE[1])
    target = target * (1 + 0.1 * x) + 7.0 + 3.0 * x
    kernel = fitted(source, target)
    inner = np.s_[8:-8, 8:-8]
    # The ridge holds back what the texture hardly tells; levels are right to half a per cent.
    assert np.std((kernel.of(source) - target)[inner]) < 5e-3 * np.std(target)
    gain, _ = kernel.light(SHAPE)
    np.testing.assert_allclose(gain, 1.3 * (1 + 0.1 * np.broadcast_to(x, SHAPE)), rtol=0.01)


def test_a_blur_that_changes_over_the_frame_is_not_held_back() -> None:
    source = texture(4, 2.5)
    x = np.linspace(-1, 1, SHAPE[1])
    target = source + 0.05 * x * laplace(source.astype(np.float64))  # 0.1 px^2 at either side
    kernel = fitted(source, target)
    inner = np.s_[8:-8, 8:-8]
    before, after = (np.std((made - target)[inner]) for made in (source, kernel.of(source)))
    # 2 % is left; of a natural scene, with more power at low frequencies, it is more.
    assert after < 0.05 * before


def test_a_constant_stays_a_constant() -> None:
    kernel = fitted(texture(2), 1.2 * texture(2) + 5.0)
    flat = np.full(SHAPE, np.float32(kernel.level_dn))
    np.testing.assert_allclose(kernel.of(flat), 1.2 * kernel.level_dn + 5.0, rtol=1e-4)


@pytest.mark.parametrize("blur_px2", [0.0, 0.7, -0.7, 3.0])
@pytest.mark.parametrize("zoom", [1.0, 1.5])
def test_white_noise_through_smoothing_and_kernel_has_the_variance_of_the_closed_form(
    blur_px2: float, zoom: float
) -> None:
    rng = np.random.default_rng(5)
    smoothing = smoothing_for(blur_px2)
    taps = np.zeros((SIDE, SIDE))
    taps[3, 2:5], taps[2, 3] = (0.1, 0.7, 0.15), 0.2
    shape = (500, 500)

    def positions(y: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        return zoom * y + 0.3, zoom * x + 0.7

    size = (round(shape[0] * zoom) + 20, round(shape[1] * zoom) + 20)
    noise = rng.standard_normal(size).astype(np.float32)
    placed = PixelPositions.of(positions, shape, size)
    seen = placed.seen(spline_coefficients(noise, smoothing.source_px * zoom))
    coefficients = np.zeros(3 * SIDE * SIDE + 9)
    coefficients[: SIDE * SIDE] = taps.ravel()
    made = MatchingKernel(coefficients=coefficients, level_dn=0.0).of(np.nan_to_num(seen))
    own = smoothed(rng.standard_normal(shape).astype(np.float32), smoothing.target_px)
    gain = white_noise_gain(taps, smoothing, zoom)
    inner = np.s_[30:-30, 30:-30]
    # 194,000 pixels, one in 12.6 s^2 independent: a standard error of 1.2 % at s 1, 2.4 % at 2.
    assert np.var(made[inner]) == pytest.approx(gain.source, rel=4 * 0.012 * smoothing.source_px)
    assert np.var(own[inner]) == pytest.approx(gain.target, rel=4 * 0.012 * smoothing.target_px)


@pytest.mark.parametrize("blur_px2", [-3.0, -0.5, 0.0, 0.5, 3.0])
def test_smoothing_brings_both_to_one_sharpness_and_swaps_with_the_photographs(
    blur_px2: float,
) -> None:
    one, other = smoothing_for(blur_px2), smoothing_for(-blur_px2)
    assert one.source_px**2 - one.target_px**2 == pytest.approx(blur_px2)
    assert min(one.source_px, one.target_px) >= 1
    assert (one.source_px, one.target_px) == pytest.approx((other.target_px, other.source_px))
    assert isinstance(one, Smoothing)


def test_a_photograph_is_smoothed_and_seen_as_by_a_spline_of_its_exact_positions() -> None:
    source = texture(3, 1.0)

    def bent(y: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        return 0.9 * y + 0.02 * x + 8 + 1e-4 * y * x, 1.05 * x - 0.03 * y + 5 + 2e-4 * x * x

    placed = PixelPositions.of(bent, (140, 190), SHAPE)
    seen = placed.seen(spline_coefficients(source, 1.2))
    y, x = bent(*np.mgrid[:140, :190].astype(np.float64))
    exact = map_coordinates(gaussian_filter(source.astype(float), 1.2, truncate=8), [y, x], order=5)
    sound = placed.inside(np.ones(SHAPE, dtype=bool), 14.0)
    assert sound.mean() > 0.5
    # Single precision, and positions between nodes 16 px apart.
    np.testing.assert_allclose(seen[sound], exact[sound], atol=5e-4 * float(np.std(source)))
    assert np.isnan(placed.seen(source)[:, -1]).all()  # past the photograph


BLUR_SHAPE = (200, 240)


def same(y: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
    return y, x


PLACED = PixelPositions.of(same, BLUR_SHAPE, BLUR_SHAPE)
VALID = np.zeros(BLUR_SHAPE, dtype=np.bool_)
VALID[12:-12, 12:-12] = True


def scene(seed: int, contrast_dn: float) -> FloatArray:
    image = gaussian_filter(np.random.default_rng(seed).standard_normal(BLUR_SHAPE), 2.0)
    return np.asarray(100 + contrast_dn * image / image.std())


def measured(source: FloatArray, target: FloatArray) -> RelativeBlur:
    return relative_blur(source.astype(np.float32), target.astype(np.float32), PLACED, VALID, 0.0)


@pytest.mark.parametrize("blur_px2", [-3.0, -0.5, 0.0, 0.16, 1.0, 3.0])
def test_a_blur_is_measured_without_noise_whichever_is_softer(blur_px2: float) -> None:
    sharp, soft = 1.0, float(np.sqrt(1 + abs(blur_px2)))
    widths = (sharp, soft) if blur_px2 >= 0 else (soft, sharp)
    source, target = (gaussian_filter(scene(1, 40.0), width, truncate=7) for width in widths)
    # The search's last step leaves a few thousandths.
    assert measured(source, target).value_px2 == pytest.approx(blur_px2, rel=0.02, abs=0.01)


@pytest.mark.slow
@pytest.mark.parametrize("blur_px2", [0.0, 0.4])
def test_noise_of_either_is_no_blur_and_the_error_is_that_of_the_scatter(blur_px2: float) -> None:
    rng = np.random.default_rng(3)
    source = scene(2, 12.0)
    target = gaussian_filter(source, np.sqrt(blur_px2), truncate=7) if blur_px2 else source
    found = [
        measured(source + rng.normal(0, 3.0, BLUR_SHAPE), target + rng.normal(0, 2.0, BLUR_SHAPE))
        for _ in range(24)
    ]
    values = np.array([one.value_px2 for one in found])
    # A mean of 24 is 4 of its standard errors off once in 2,000 (t distribution).
    assert abs(values.mean() - blur_px2) < 4 * values.std(ddof=1) / np.sqrt(24)
    # 24 draws give a scatter to 15 %; that of steps that stop early is not quite the error's.
    assert np.mean([one.err_px2 for one in found]) == pytest.approx(values.std(ddof=1), rel=0.6)


def test_changes_light_and_offset_are_no_blur() -> None:
    source = scene(4, 40.0)
    target = 1.3 * source + 20.0
    target[60:70, 80:90] += 300.0
    rng = np.random.default_rng(0)
    found = measured(source, target + rng.normal(0, 0.5, BLUR_SHAPE))
    # The smoothed change's skirt, below 5 standard deviations, is not left out.
    assert abs(found.value_px2) < 0.05


def test_nothing_to_see_tells_no_blur_and_what_is_expected_stays() -> None:
    flat = np.full(BLUR_SHAPE, 500.0)
    found = measured(flat, flat)
    assert (found.value_px2, found.err_px2) == (0.0, np.inf)
    assert found.towards(0.3, 1.0) == pytest.approx(0.3)


@pytest.mark.parametrize("zoom", [1.0, 1.5, 2.0])
def test_one_gaussian_camera_differs_from_itself_by_what_the_zoom_takes(zoom: float) -> None:
    psf = GaussianPsf(sigma_x_px=0.9, sigma_y_px=0.9)

    def nearer(y: FloatArray, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        return zoom * y, zoom * x

    size = (round(zoom * BLUR_SHAPE[0]) + 10, round(zoom * BLUR_SHAPE[1]) + 10)
    placed = PixelPositions.of(nearer, BLUR_SHAPE, size)
    seen = smoothed(scene(5, 30.0).astype(np.float32), 1.0)
    expected = 0.81 * (1 - 1 / zoom**2)
    found = calibrated_blur_px2(psf, seen, VALID, smoothing_for(0.2), placed)
    assert found == pytest.approx(expected, abs=1e-3)  # the search's last step
    assert spline_coefficients(seen, 1.0).shape == BLUR_SHAPE


ROUNDED_SHAPE = (90, 120)


def test_of_a_linear_file_it_is_a_twelfth() -> None:
    ramp = np.arange(90 * 120, dtype=np.float32).reshape(ROUNDED_SHAPE) % 256
    found = rounding_variance(ramp)
    assert found is not None
    np.testing.assert_allclose(found, 1 / 12, rtol=1e-5)  # single precision


def test_levels_that_no_pixel_has_do_not_widen_the_step() -> None:
    ramp = np.arange(90 * 120, dtype=np.float32).reshape(ROUNDED_SHAPE) % 256
    ramp[ramp % 9 == 4] += 1
    found = rounding_variance(ramp)
    assert found is not None
    np.testing.assert_allclose(found, 1 / 12, rtol=1e-5)


def test_of_a_tone_curve_it_follows_the_curve_s_slope() -> None:
    code = np.arange(90 * 120, dtype=np.float64).reshape(ROUNDED_SHAPE) % 256
    levels = (255 * (code / 255) ** 2.2).astype(np.float32)
    found = rounding_variance(levels)
    assert found is not None
    slope = 2.2 * (code / 255) ** 1.2
    middle = (code > 20) & (code < 250)
    # The median of five steps, and between levels a straight line.
    np.testing.assert_allclose(found[middle], slope[middle] ** 2 / 12, rtol=0.05)


@pytest.mark.parametrize("levels", [2, 20, 5000])
def test_charts_and_means_of_frames_tell_no_step(levels: int) -> None:
    image = np.arange(90 * 120, dtype=np.float32).reshape(ROUNDED_SHAPE) % levels
    assert rounding_variance(image * np.float32(0.37)) is None


VARIANCE_SHAPE = (300, 320)


VARIANCE_PLACED = PixelPositions.of(same, VARIANCE_SHAPE, VARIANCE_SHAPE)
EVERYWHERE = np.ones(VARIANCE_SHAPE, dtype=np.bool_)


def test_the_variance_is_taken_apart_into_what_it_was_made_of() -> None:
    rng = np.random.default_rng(4)
    scene = (100 + gaussian_filter(rng.standard_normal(VARIANCE_SHAPE), 2.0) * 300).astype(
        np.float32
    )
    along_y, along_x = np.gradient(scene)
    slope = np.sqrt((along_y**2 + along_x**2) / 2)
    difference = 1.5 * rng.standard_normal(VARIANCE_SHAPE) + 0.2 * slope * rng.standard_normal(
        VARIANCE_SHAPE
    )
    terms = VarianceTerms.of(scene, scene, scene, VARIANCE_PLACED)
    rows, cols = np.nonzero(EVERYWHERE)
    sizes = fit_sizes(difference.ravel(), terms.at(rows, cols), None)
    # Clipping at 3.5 standard deviations takes 0.7 % of the variance.
    assert terms.noise_dn2(sizes, EVERYWHERE) == pytest.approx(1.5**2, rel=0.05)
    assert np.sqrt(sizes[GRADIENT]) == pytest.approx(0.2, rel=0.06)
    expected = 1.5**2 + (0.2 * slope) ** 2
    assert np.median(terms.variance(sizes) / expected) == pytest.approx(1.0, abs=0.04)
    floor = np.full(VARIANCE_SHAPE, np.float32(100))
    assert terms.variance(sizes, floor).min() == 100


def test_a_variance_that_is_wrong_by_a_factor_is_put_right_in_spite_of_changes() -> None:
    rng = np.random.default_rng(6)
    sd = np.where(np.arange(VARIANCE_SHAPE[1]) < 160, 1.0, 4.0) * np.ones(VARIANCE_SHAPE)
    difference = sd * rng.standard_normal(VARIANCE_SHAPE)
    predicted: Float32Array = np.where(sd > 2, 4.0, 1.0).astype(
        np.float32
    )  # 4 times too small on the right
    difference[50:60, 50:60] += 30.0
    factor = calibrated_factor(
        difference.astype(np.float32), predicted, np.float32(0.5) * predicted, EVERYWHERE, 0.3
    )
    # 48,000 pixels tell a robust spread to 0.5 %; 1.33 scatters of the tail are forgiven.
    assert np.median(factor[:, :150]) == pytest.approx(1.0, rel=0.03)
    assert np.median(factor[:, 170:]) == pytest.approx(2.0, rel=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("gamma", [0.45, 1.8])
def test_a_tone_curve_is_found_to_a_fraction_of_the_noise(gamma: float) -> None:
    rng = np.random.default_rng(7)
    light = np.clip(110 + gaussian_filter(rng.standard_normal(VARIANCE_SHAPE), 3.0) * 300, 15, 240)
    noise = rng.normal(0, 1.0, (2, *VARIANCE_SHAPE))
    source = gaussian_filter(light + noise[0], 1.0).astype(np.float32)
    target = (255 * (np.maximum(light + noise[1], 0) / 255) ** gamma).astype(np.float32)
    valid = EVERYWHERE.copy()
    valid[:8] = valid[-8:] = valid[:, :8] = valid[:, -8:] = False
    curve = fit_tone_curve(source, target, valid, 1.0)
    assert curve is not None
    levels = np.quantile(target, np.linspace(0.03, 0.97, 40)).astype(np.float32)
    truth = 255 * (levels / 255) ** (1 / gamma)
    error = curve.of(levels) - truth
    # Up to the gain and the offset, which the kernel has; noise 1 DN.
    error -= np.polyval(np.polyfit(truth, error, 1), truth)
    assert np.abs(error).max() < 0.3
    assert (np.diff(curve.values_dn) > 0).all()


def test_levels_that_fall_have_no_tone_curve() -> None:
    rng = np.random.default_rng(8)
    light = (110 + gaussian_filter(rng.standard_normal(VARIANCE_SHAPE), 3.0) * 300).astype(
        np.float32
    )
    assert fit_tone_curve(light, 255 - light, EVERYWHERE, 1.0) is None


def test_few_pixels_that_differ_everywhere_are_still_calibrated() -> None:
    # Of a drawing nothing differs but for pixels that lie within the reach of every other one.
    difference = np.zeros((200, 200), dtype=np.float32)
    difference[::6, ::6] = 1.0
    variance = np.full((200, 200), np.float32(1e-6))
    factor = calibrated_factor(difference, variance, variance, np.ones((200, 200), np.bool_), 1.0)
    assert np.all(np.isfinite(factor))
