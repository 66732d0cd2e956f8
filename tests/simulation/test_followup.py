"""Whole follow-ups: their light and their noise."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from simulation import GaussianPsf, PoseOptions, PsfField, SamplingGrid, zoom_operator
from simulation.arrays import FloatArray
from simulation.capture_noise import CaptureNoise, propagated_variance, with_capture_noise
from simulation.choices import MODELS, Model
from simulation.followup import (
    CaptureOptions,
    FollowUp,
    Rendering,
    _exposed,
    _unsharp_masked,
    _vignetted,
    captured,
    from_pose,
    zoomed_out,
)

NOISE = CaptureNoise(gain_e_per_dn=4.0, read_noise_e=8.0, black_level_dn=64.0)
PSF = GaussianPsf(sigma_x_px=0.8, sigma_y_px=0.8)


LOOKS = {
    "zoom": lambda image, noise: zoomed_out(image, 2.0, PSF, "matched", Rendering(noise=noise)),
    "pose": lambda image, noise: from_pose(
        image, *pose_of_zoom(image.shape, 2.0), PSF, PoseOptions(model="matched"), noise
    ),
}


def pose_of_zoom(shape: tuple[int, int], zoom: float) -> tuple[FloatArray, tuple[int, int]]:
    grid = SamplingGrid.centred(shape, zoom)
    return grid.matrix, (grid.cols, grid.rows)


@pytest.mark.slow
@pytest.mark.parametrize("look", LOOKS)
@pytest.mark.parametrize(("exposure", "vignetting"), [(1.0, 0.0), (1.6, 0.0), (1.0, 0.6)])
def test_the_noise_is_that_of_the_light_that_arrives(
    exposure: float, vignetting: float, look: str
) -> None:
    rng = np.random.default_rng(2)
    level = np.full((300, 300), 1064.0)
    reference = level + np.sqrt(NOISE.variance_dn2(level)) * rng.standard_normal(level.shape)
    clean = captured(
        LOOKS[look](level, None), CaptureOptions(exposure=exposure, vignetting=vignetting)
    )
    options = CaptureOptions(exposure=exposure, vignetting=vignetting, seed=3)
    noisy = captured(LOOKS[look](reference, NOISE), options, NOISE)
    inner = np.s_[10:-10, 10:-10]
    # The clean image was lit without a black level; light it as the noisy one.
    expected_level = (clean / 1064.0) * 1000.0 + 64.0
    normalised = (noisy - expected_level) / np.sqrt(NOISE.variance_dn2(expected_level))
    assert np.mean(normalised[inner]) == pytest.approx(0.0, abs=0.05)
    assert np.var(normalised[inner]) == pytest.approx(1.0, rel=0.06)  # 16 900 pixels


def test_without_options_nothing_changes() -> None:
    image = np.random.default_rng(0).uniform(0, 9, (20, 30))
    followup = FollowUp(image=image, own_variance_dn2=None)
    np.testing.assert_array_equal(captured(followup, CaptureOptions()), image)


@pytest.mark.parametrize("shape", [(80, 121), (81, 120)])
def test_a_field_is_taken_at_the_middle_of_the_camera_s_frame(shape: tuple[int, int]) -> None:
    # Even as a field, so that the plain zoom-out is the truth; odd sizes leave half a pixel.
    (xx, xy), (_, yy) = PSF.covariance_px2
    even = PsfField(
        width_px=shape[1], height_px=shape[0], coefficients_px2=np.array([[xx], [xy], [yy]])
    )
    image = np.random.default_rng(1).uniform(0, 255, shape)
    plain = zoomed_out(image, 1.7, PSF, "matched")
    field = zoomed_out(image, 1.7, even, "matched")
    assert field.is_field
    # White noise, and two kernels that end at different places: 0.28 of 255.
    assert field.image == pytest.approx(plain.image, abs=1.5e-3 * 255)
    with pytest.raises(ValueError, match="model"):
        zoomed_out(image, 1.7, even, "paper")


@pytest.mark.parametrize(
    "values",
    [
        {"exposure": float("inf")},
        {"exposure": -1.0},
        {"vignetting": 1.0},
        {"vignetting": float("nan")},
        {"sharpening": (float("nan"), 1.0)},
        {"sharpening": (0.8, 0.0)},
    ],
)
def test_options_out_of_range_are_refused(values: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match="got"):
        CaptureOptions(**values)


IMAGE = np.random.default_rng(2).uniform(100.0, 900.0, (31, 44))


def test_exposure_scales_the_light_above_the_black_level() -> None:
    brighter = _exposed(IMAGE, 1.5, black_level_dn=64.0)
    np.testing.assert_allclose(brighter - 64.0, 1.5 * (IMAGE - 64.0))
    np.testing.assert_allclose(_exposed(IMAGE, 1.0, 64.0), IMAGE)


def test_vignetting_takes_its_share_at_the_corners_and_nothing_at_the_centre() -> None:
    flat = np.full((31, 45), 1000.0)
    dim = _vignetted(flat, 0.3)
    for corner in ((0, 0), (0, -1), (-1, 0), (-1, -1)):
        assert dim[corner] == pytest.approx(700.0)
    assert dim[15, 22] == pytest.approx(1000.0)
    # Half-way to the corner: cos^4 with tan^2 a quarter of the corner's (0.7^-0.5 - 1).
    flat_odd = np.full((41, 61), 1000.0)
    expected = 1000.0 * (1 + (0.7**-0.5 - 1) / 4) ** -2
    assert _vignetted(flat_odd, 0.3)[10, 15] == pytest.approx(expected)


def test_vignetting_leaves_the_black_level_and_colour_alone() -> None:
    black = np.full((9, 11, 3), 64.0)
    np.testing.assert_allclose(_vignetted(black, 0.5, black_level_dn=64.0), 64.0)


@pytest.mark.parametrize("frequency", [0.05, 0.2, 0.4])
def test_sharpening_lifts_a_wave_by_its_closed_form(frequency: float) -> None:
    x = np.arange(400)
    wave = np.tile(np.cos(2 * np.pi * frequency * x), (9, 1))
    amount, sigma = 0.8, 1.2
    # The blur leaves exp(-2 pi^2 sigma^2 f^2); scipy's sampled Gaussian is good to 1e-3 here.
    gain = 1 + amount * (1 - np.exp(-2 * (np.pi * sigma * frequency) ** 2))
    sharp = _unsharp_masked(wave, amount, sigma)
    np.testing.assert_allclose(sharp[:, 50:-50], gain * wave[:, 50:-50], atol=2e-3)


def test_no_sharpening_changes_nothing_and_the_dtype_stays() -> None:
    image = IMAGE.astype(np.float32)
    np.testing.assert_array_equal(_unsharp_masked(image, 0.0, 1.0), image)
    for result in (_unsharp_masked(image, 1.0, 1.0), _vignetted(image, 0.1), _exposed(image, 2.0)):
        assert result.dtype == np.float32


@pytest.mark.parametrize(
    "call",
    [
        lambda: _exposed(IMAGE, -1.0),
        lambda: _vignetted(IMAGE, 1.0),
        lambda: _unsharp_masked(IMAGE, -0.1, 1.0),
        lambda: _unsharp_masked(IMAGE, 1.0, 0.0),
        lambda: _unsharp_masked(IMAGE, float("nan"), 1.0),
    ],
)
def test_impossible_options_are_refused(call: Callable[[], object]) -> None:
    with pytest.raises(ValueError):
        call()


SHAPE = (18, 23)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("rho", [0.0, 0.3])
def test_the_variance_is_the_sum_of_squared_weights(model: Model, rho: float) -> None:
    grid = SamplingGrid.centred(SHAPE, 1.7)
    operator = zoom_operator(
        SHAPE, grid, GaussianPsf(sigma_x_px=0.9, sigma_y_px=0.7, rho=rho), model
    )
    rng = np.random.default_rng(4)
    variance = rng.uniform(0.5, 4.0, SHAPE)
    # The dense operator, column by column, from unit images.
    expected = np.zeros((grid.rows, grid.cols))
    for row in range(SHAPE[0]):
        for col in range(SHAPE[1]):
            unit = np.zeros(SHAPE)
            unit[row, col] = 1.0
            expected += operator.apply(unit) ** 2 * variance[row, col]
    np.testing.assert_allclose(propagated_variance(operator, variance), expected, rtol=1e-9)


def test_zoom_1_keeps_the_variance() -> None:
    operator = zoom_operator(
        SHAPE, SamplingGrid.centred(SHAPE, 1.0), GaussianPsf(sigma_x_px=1, sigma_y_px=1)
    )
    variance = np.random.default_rng(1).uniform(1, 2, SHAPE)
    np.testing.assert_allclose(propagated_variance(operator, variance), variance, rtol=1e-12)


def test_a_simulated_follow_up_gets_the_noise_of_a_captured_one() -> None:
    shape = (200, 260)
    noise = CaptureNoise(
        gain_e_per_dn=5.0, read_noise_e=12.0, black_level_dn=64.0, frames_averaged=10
    )
    level = np.full(shape, 1000.0)
    rng = np.random.default_rng(7)
    variance = noise.variance_dn2(level)
    reference = level + np.sqrt(variance) * rng.standard_normal(shape)
    grid = SamplingGrid.centred(shape, 2.0)
    operator = zoom_operator(shape, grid, GaussianPsf(sigma_x_px=0.8, sigma_y_px=0.8))
    followup = operator.apply(reference)
    own = propagated_variance(operator, variance)
    inner = np.s_[5:-5, 5:-5]
    # 90 x 120 pixels of correlated noise: the variance is known to 3 %, three of those.
    assert np.var(followup[inner]) == pytest.approx(float(own[inner].mean()), rel=0.09)
    noisy = with_capture_noise(followup, own, noise, rng)
    assert np.var(noisy[inner]) == pytest.approx(float(variance[0, 0]), rel=0.06)


def test_the_variance_of_a_level_is_worked_by_hand() -> None:
    # 500 DN of light at 5 e-/DN are 2500 e-: shot noise 50 e-; read noise 10 e-.
    noise = CaptureNoise(
        gain_e_per_dn=5.0, read_noise_e=10.0, black_level_dn=64.0, frames_averaged=4
    )
    expected = (50.0**2 + 10.0**2) / 5.0**2 / 4
    np.testing.assert_allclose(noise.variance_dn2(np.array([564.0])), [expected])
    # Below the black level there is no light that could be noisy.
    np.testing.assert_allclose(noise.variance_dn2(np.array([0.0])), [10.0**2 / 25 / 4])


@pytest.mark.slow
@settings(max_examples=30, deadline=None)
@given(factor=st.floats(0.1, 10.0), zoom=st.floats(1.0, 2.5))
def test_the_variance_is_linear_and_not_negative(factor: float, zoom: float) -> None:
    operator = zoom_operator(
        SHAPE, SamplingGrid.centred(SHAPE, zoom), GaussianPsf(sigma_x_px=0.7, sigma_y_px=0.9)
    )
    variance = np.random.default_rng(3).uniform(0, 2, SHAPE)
    once = propagated_variance(operator, variance)
    assert np.all(once >= 0)
    np.testing.assert_allclose(propagated_variance(operator, factor * variance), factor * once)


def test_impossible_noise_is_refused() -> None:
    operator = zoom_operator(SHAPE, SamplingGrid.centred(SHAPE, 2.0), None, "bicubic")
    with pytest.raises(ValueError):
        propagated_variance(operator, np.full(SHAPE, -1.0))
    for key, value in (
        ("gain_e_per_dn", 0.0),
        ("read_noise_e", -1.0),
        ("frames_averaged", 0),
        ("black_level_dn", np.nan),
    ):
        good = {"gain_e_per_dn": 5.0, "read_noise_e": 1.0, "black_level_dn": 0.0}
        with pytest.raises(ValueError):
            CaptureNoise(**(good | {key: value}))  # type: ignore[arg-type]  # wrong on purpose
    noise = CaptureNoise(gain_e_per_dn=1.0, read_noise_e=0.0, black_level_dn=0.0)
    with pytest.raises(ValueError):
        with_capture_noise(np.zeros((3, 3)), np.zeros((2, 2)), noise, np.random.default_rng(0))
