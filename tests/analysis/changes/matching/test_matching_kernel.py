"""The kernel between two smoothed photographs, against closed forms."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, laplace, map_coordinates

from analysis.changes.matching.matching_kernel import (
    MatchingKernel,
    NormalEquations,
    design_matrix,
    white_noise_gain,
)
from analysis.changes.matching.relative_blur import Smoothing, smoothing_for
from analysis.changes.matching.smoothed_warp import (
    PixelPositions,
    smoothed,
    spline_coefficients,
)
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
