from typing import Any, get_args

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray

from acquisition.choices import FocusMeasure
from acquisition.focus._live import _variance_between
from acquisition.focus._measures import FOCUS_MEASURES, focus_value

MEASURES: tuple[FocusMeasure, ...] = get_args(FocusMeasure)
BLACK_DN = 64.0


def scene(seed: int = 0, shape: tuple[int, int] = (70, 110)) -> NDArray[np.float64]:
    """Blurred noise between 300 and 2500 DN; neither square nor symmetric."""
    plane = np.random.default_rng(seed).normal(size=shape)
    soft = cv2.GaussianBlur(plane, (0, 0), 2.0)
    return np.asarray(1200 + 1000 * soft / np.abs(soft).max())


def test_the_table_holds_every_measure() -> None:
    assert set(FOCUS_MEASURES) == set(MEASURES)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32, np.float64])
@pytest.mark.parametrize("measure", MEASURES)
def test_sums_agree_with_plain_numpy_and_opencv(measure: FocusMeasure, dtype: type) -> None:
    image: NDArray[Any] = (scene() / 10).astype(dtype)
    plane = image.astype(np.float64)
    inner = np.s_[1:-1, 1:-1]
    expected = {
        "squared-gradient": np.mean(np.diff(plane, axis=0) ** 2)
        + np.mean(np.diff(plane, axis=1) ** 2),
        "brenner": np.mean((plane[2:] - plane[:-2]) ** 2)
        + np.mean((plane[:, 2:] - plane[:, :-2]) ** 2),
        "tenengrad": np.mean(cv2.Sobel(plane, -1, 1, 0)[inner] ** 2)
        + np.mean(cv2.Sobel(plane, -1, 0, 1)[inner] ** 2),
        "laplacian": np.var(cv2.Laplacian(plane, -1)[inner]),
    }[measure]
    sums = FOCUS_MEASURES[measure].sums(image)
    assert sums.response_dn2 == pytest.approx(expected, rel=1e-9)
    assert sums.mean_dn == pytest.approx(plane.mean(), rel=1e-12)
    assert sums.square_dn2 == pytest.approx(np.mean(plane**2), rel=1e-12)


def test_the_largest_levels_do_not_overflow() -> None:
    image = np.zeros((90, 90), np.uint16)
    image[::2] = 65535
    sums = FOCUS_MEASURES["squared-gradient"].sums(image)
    assert sums.response_dn2 == 65535.0**2


@pytest.mark.parametrize("measure", MEASURES)
@settings(max_examples=20, deadline=None)
@given(scale=st.floats(0.3, 3.0))
def test_exposure_does_not_enter_any_measure(measure: FocusMeasure, scale: float) -> None:
    image = scene()
    drifted = BLACK_DN + scale * (image - BLACK_DN)
    assert focus_value(drifted, black_level_dn=BLACK_DN, measure=measure) == pytest.approx(
        focus_value(image, black_level_dn=BLACK_DN, measure=measure), rel=1e-9
    )


@pytest.mark.parametrize("measure", MEASURES)
def test_pure_noise_is_zero_within_its_error(measure: FocusMeasure) -> None:
    rng = np.random.default_rng(2)
    values = [
        focus_value(
            1000 + 20 * rng.standard_normal((70, 110)),
            black_level_dn=BLACK_DN,
            noise_variance_dn2=400.0,
            measure=measure,
        )
        for _ in range(60)
    ]
    assert abs(np.mean(values)) < 4 * np.std(values) / np.sqrt(60)


@pytest.mark.parametrize("measure", MEASURES)
def test_shot_noise_is_taken_out_by_its_mean_variance(measure: FocusMeasure) -> None:
    rng = np.random.default_rng(6)
    clean = scene()
    variance = (clean - BLACK_DN) / 0.5
    noisy = [
        focus_value(
            clean + np.sqrt(variance) * rng.standard_normal(clean.shape),
            black_level_dn=BLACK_DN,
            noise_variance_dn2=float(variance.mean()),
            measure=measure,
        )
        for _ in range(60)
    ]
    truth = focus_value(clean, black_level_dn=BLACK_DN, measure=measure)
    assert abs(np.mean(noisy) - truth) < 4 * np.std(noisy) / np.sqrt(60)


@settings(max_examples=20, deadline=None)
@given(flicker=st.floats(0.8, 1.25), sigma=st.floats(1.0, 40.0))
def test_the_noise_between_two_frames_does_not_hold_flicker(flicker: float, sigma: float) -> None:
    rng = np.random.default_rng(9)
    clean = scene()
    first = clean + sigma * rng.standard_normal(clean.shape)
    second = BLACK_DN + flicker * (clean - BLACK_DN) + sigma * rng.standard_normal(clean.shape)
    found = _variance_between(first, second, BLACK_DN)
    # 7700 px: 1.6 % each, and the scale is known to sigma / level / sqrt(n).
    assert found == pytest.approx(sigma**2, rel=0.1)


def test_frames_of_two_shapes_are_refused() -> None:
    with pytest.raises(ValueError):
        _variance_between(np.zeros((4, 5)), np.zeros((5, 4)), 0.0)


@pytest.mark.parametrize("measure", MEASURES[1:])
def test_a_picture_smaller_than_the_measure_reaches_is_refused(measure: FocusMeasure) -> None:
    with pytest.raises(ValueError):
        focus_value(np.zeros((2, 9)), black_level_dn=0, measure=measure)
