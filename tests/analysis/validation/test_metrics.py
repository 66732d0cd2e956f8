from math import inf, log10

import numpy as np
import pytest
from hypothesis import given, strategies as st

from analysis.validation.metrics import (
    compare_images,
    correlation,
    mean_squared_error,
)


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
