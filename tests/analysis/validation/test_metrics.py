from math import inf, log10

import numpy as np
import pytest
from hypothesis import given, strategies as st

from analysis.errors import OverlapError
from analysis.validation import compare_images, process_for_comparison, scaled_up
from analysis.validation._metrics import (
    bicubic_at,
    correlation,
    crop_centre_half,
    mean_squared_error,
    normalise,
    shared_window,
    subtract_background,
)
from calibration.registration import DistortedPose


@given(curve=st.tuples(*[st.floats(-2, 2)] * 6), y=st.floats(2.0, 16.0), x=st.floats(2.0, 26.0))
def test_bicubic_interpolation_reproduces_a_parabola(
    curve: tuple[float, ...], y: float, x: float
) -> None:
    a, b, c, d, e, f = curve
    v, u = np.mgrid[:20, :30].astype(np.float64)
    # Keys, 1981: with a = -1/2 the cubic is exact up to the second power.
    image = a + b * u + c * v + d * u * u + e * u * v + f * v * v
    found = bicubic_at(image, np.array([y]), np.array([x]))
    expected = a + b * x + c * y + d * x * x + e * x * y + f * y * y
    assert found[0] == pytest.approx(expected, abs=1e-9 * (1 + np.abs(image).max()))


def test_at_the_pixels_it_is_the_image_and_outside_its_border_goes_on() -> None:
    image = np.random.default_rng(1).uniform(0, 255, (6, 9))
    y, x = np.mgrid[:6, :9].astype(np.float64)
    np.testing.assert_allclose(bicubic_at(image, y, x), image)
    assert bicubic_at(image, np.array([-4.0]), np.array([20.0]))[0] == pytest.approx(image[0, 8])


def test_scaling_up_keeps_the_centre_by_hand() -> None:
    # A ramp of 10 per pixel about 0 becomes one of 5 per pixel about 0.
    image = np.tile(10.0 * (np.arange(8) - 3.5), (8, 1))
    found = scaled_up(image, 2.0, (16, 16))
    np.testing.assert_allclose(found[:, 3:13], np.tile(5.0 * (np.arange(3, 13) - 7.5), (16, 1)))


@given(
    zoom=st.floats(1.0, 3.0),
    shift_px=st.floats(-20, 20),
    turn=st.floats(-0.05, 0.05),
    k1=st.floats(-0.05, 0.05),
)
def test_the_shared_window_lies_wholly_inside_the_reference(
    zoom: float, shift_px: float, turn: float, k1: float
) -> None:
    shape = (90, 120)
    matrix = np.array(
        [[zoom, -turn, shift_px - 59.5 * (zoom - 1)], [turn, zoom, -44.5 * (zoom - 1)], [0, 0, 1]]
    )
    pose = DistortedPose(matrix=matrix, k1=k1, reference_shape=shape, followup_shape=shape)
    window = shared_window(pose)
    margin_px = (pose.zoom - 1) / 2
    for places, size in ((window.y_px, 90), (window.x_px, 120)):
        assert places.min() >= margin_px - 1e-9
        assert places.max() <= size - 1 - margin_px + 1e-9
    # No more than a quarter of either side is given away.
    assert window.y_px.shape[0] * zoom > 0.6 * (90 - 2 * margin_px)
    assert window.x_px.shape[1] * zoom > 0.5 * (120 - 2 * margin_px)


def test_images_that_do_not_overlap_have_no_window() -> None:
    matrix = np.array([[1.5, 0, 900.0], [0, 1.5, 0], [0, 0, 1]])
    pose = DistortedPose(matrix=matrix, k1=0.0, reference_shape=(90, 120), followup_shape=(90, 120))
    with pytest.raises(OverlapError) as refused:
        shared_window(pose)
    assert refused.value.shared_px == 0


def test_images_that_share_a_strip_alone_have_no_window() -> None:
    # By hand: 1.5 u + 104 <= 119 - 0.25 lets ten columns in.
    matrix = np.array([[1.5, 0, 104.0], [0, 1.5, 0], [0, 0, 1]])
    pose = DistortedPose(matrix=matrix, k1=0.0, reference_shape=(90, 120), followup_shape=(90, 120))
    with pytest.raises(OverlapError) as refused:
        shared_window(pose)
    # Ten columns of the rows that the reference covers: 1.5 v <= 89 - 0.25.
    assert refused.value.shared_px == 10 * 59


def textures() -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    return rng.uniform(0, 255, (30, 40)), rng.uniform(0, 255, (30, 40))


def test_an_image_compared_with_itself_is_perfect() -> None:
    image, _ = textures()
    metrics = compare_images(image, image)
    assert metrics.mse_dn2 == 0
    assert metrics.psnr_db == inf
    assert metrics.correlation == pytest.approx(1)
    assert metrics.ssim == pytest.approx(1)
    assert metrics.nmi == pytest.approx(2)


def test_unrelated_images_share_nothing() -> None:
    rng = np.random.default_rng(3)
    a, b = rng.uniform(0, 255, (2, 600, 600))
    metrics = compare_images(a, b)
    assert metrics.correlation == pytest.approx(0, abs=0.01)  # 1 / sqrt(360 000) = 0.0017
    assert metrics.ssim == pytest.approx(0, abs=0.02)
    assert metrics.nmi == pytest.approx(1, abs=0.01)  # 100 x 100 bins of 36 pixels each


def test_a_shift_of_level_by_hand() -> None:
    image, _ = textures()
    metrics = compare_images(image, image + 5)
    assert metrics.mse_dn2 == pytest.approx(25)
    assert metrics.psnr_db == pytest.approx(20 * log10(255 / 5))
    assert metrics.correlation == pytest.approx(1)


def test_the_data_range_moves_psnr_by_its_ratio() -> None:
    a, b = textures()
    wide, narrow = compare_images(a, b, 4095), compare_images(a, b, 255)
    assert wide.psnr_db - narrow.psnr_db == pytest.approx(20 * log10(4095 / 255))
    assert (wide.data_range_dn, narrow.data_range_dn) == (4095, 255)


@given(gain=st.floats(0.01, 100), offset=st.floats(-100, 100))
def test_correlation_ignores_gain_and_offset(gain: float, offset: float) -> None:
    a, b = textures()
    assert correlation(a, gain * b + offset) == pytest.approx(correlation(a, b), abs=1e-9)
    assert correlation(a, -gain * a + offset) == pytest.approx(-1)


def test_the_metrics_are_symmetric() -> None:
    a, b = textures()
    forth, back = compare_images(a, b), compare_images(b, a)
    for name in ("correlation", "mse_dn2", "nmi", "psnr_db", "ssim"):
        assert getattr(forth, name) == pytest.approx(getattr(back, name))


def test_single_precision_images_are_compared_in_double() -> None:
    a = np.full((10, 10), 40000.0, dtype=np.float32)
    b = a + np.float32(0.5)
    assert mean_squared_error(a, b) == 0.25


@pytest.mark.parametrize(
    ("a", "b"),
    [
        pytest.param(np.eye(8), np.eye(9)[:8], id="of two shapes"),
        pytest.param(*[np.stack([np.eye(8)] * 3, axis=-1)] * 2, id="in colour"),
        pytest.param(np.where(np.eye(8), np.nan, 0.0), np.eye(8), id="not finite"),
        pytest.param(np.ones((8, 8)), np.eye(8), id="constant"),
        pytest.param(np.eye(6), np.eye(6), id="less than 7 x 7"),
    ],
)
def test_what_cannot_be_compared_is_refused(a: np.ndarray, b: np.ndarray) -> None:
    compare_images(np.eye(8), np.eye(8)[::-1])
    with pytest.raises(ValueError):
        compare_images(a, b)


def test_a_data_range_that_is_not_positive_is_refused() -> None:
    with pytest.raises(ValueError):
        compare_images(*textures(), data_range_dn=0)


def test_normalising_stretches_the_own_extremes_to_0_and_255() -> None:
    np.testing.assert_allclose(normalise(np.array([[2.0, 4.0, 12.0]])), [[0.0, 51.0, 255.0]])


def test_normalising_undoes_gain_and_offset() -> None:
    image = np.random.default_rng(1).uniform(0, 50, (20, 30))
    np.testing.assert_allclose(normalise(image), normalise(3.7 * image + 11), atol=1e-10)


@pytest.mark.parametrize("value", [5.0, np.nan, np.inf])
def test_a_constant_or_infinite_image_cannot_be_normalised(value: float) -> None:
    with pytest.raises(ValueError):
        normalise(np.full((4, 4), value))


def test_a_constant_and_a_ramp_are_all_background() -> None:
    rows, cols = np.ogrid[:200, :220]
    background = subtract_background(7.0 + 0.5 * rows - 0.25 * cols)
    np.testing.assert_allclose(background[60:-60, 60:-60], 0, atol=1e-9)


def test_a_blob_loses_the_closed_form_share_of_its_peak() -> None:
    # A Gaussian of sigma s keeps s^2 / (s^2 + 10^2) of its peak under the background blur.
    y, x = np.ogrid[-100:101, -100:101]
    blob = np.exp(-(x**2 + y**2) / (2 * 5.0**2))
    remaining = subtract_background(blob)[100, 100]
    assert remaining == pytest.approx(1 - 25 / 125, abs=2e-4)  # the filter is cut at 4 sigma


def test_the_centre_half_of_an_odd_sized_image() -> None:
    rows, cols = np.mgrid[:10, :15].astype(float)
    np.testing.assert_array_equal(crop_centre_half(rows)[:, 0], [2, 3, 4, 5, 6])
    np.testing.assert_array_equal(crop_centre_half(cols)[0], [3, 4, 5, 6, 7, 8, 9])


def test_processing_is_the_three_steps_in_order() -> None:
    image = np.random.default_rng(2).uniform(0, 4095, (40, 60)).astype(np.uint16)
    processed = process_for_comparison(image)
    assert processed.shape == (20, 30)
    np.testing.assert_array_equal(
        processed, crop_centre_half(subtract_background(normalise(image)))
    )
