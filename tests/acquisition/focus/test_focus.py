from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st
from numpy.typing import NDArray

from acquisition.focus.measures import Region, focus_value

BLACK_DN = 64.0


def ramp(rows: int = 5, cols: int = 7) -> NDArray[np.uint16]:
    """Level 100 + 10 x + 3 y."""
    y, x = np.mgrid[:rows, :cols]
    return np.asarray(100 + 10 * x + 3 * y, dtype=np.uint16)


def test_a_ramp_has_the_closed_form() -> None:
    light = ramp().astype(float) - BLACK_DN
    expected = (10**2 + 3**2) / np.mean(light**2)
    assert focus_value(ramp(), black_level_dn=BLACK_DN) == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16, np.float32])
def test_the_value_does_not_depend_on_the_type_of_the_pixels(dtype: type) -> None:
    image: NDArray[Any] = ramp().astype(dtype)
    assert focus_value(image, black_level_dn=BLACK_DN) == pytest.approx(
        focus_value(ramp(), black_level_dn=BLACK_DN), rel=1e-12
    )


@given(st.floats(0.1, 10))
def test_exposure_drift_does_not_read_as_focus(scale: float) -> None:
    brighter = ((ramp() - BLACK_DN) * scale + BLACK_DN).astype(np.float32)
    assert focus_value(brighter, black_level_dn=BLACK_DN) == pytest.approx(
        focus_value(ramp(), black_level_dn=BLACK_DN), rel=1e-4
    )  # float32 levels


def test_blur_lowers_the_value() -> None:
    edge = np.where(np.arange(40) < 20, 200, 2000).astype(np.float32)
    sharp = np.tile(edge, (30, 1))
    soft = np.tile(np.convolve(edge, np.full(5, 0.2), "same"), (30, 1)).astype(np.float32)
    inner = Region(x_px=5, y_px=0, width_px=30, height_px=30)
    values = [focus_value(image, black_level_dn=0, region=inner) for image in (sharp, soft)]
    assert values[0] == pytest.approx(5 * values[1], rel=0.05)  # a step over 5 px: 5 (1/5)^2


def test_noise_raises_the_value_by_what_the_formula_says_and_can_be_taken_out() -> None:
    rng = np.random.default_rng(5)
    noisy = (ramp(300, 400).astype(np.float64) + rng.normal(0, 20, (300, 400))).astype(np.float32)
    clean = focus_value(ramp(300, 400), black_level_dn=BLACK_DN)
    biased = focus_value(noisy, black_level_dn=BLACK_DN)
    light_dn2 = np.mean((ramp(300, 400) - BLACK_DN) ** 2)
    assert biased - clean == pytest.approx(4 * 20**2 / light_dn2, rel=0.02)  # 120 000 px
    unbiased = focus_value(noisy, black_level_dn=BLACK_DN, noise_variance_dn2=400.0)
    assert unbiased == pytest.approx(clean, abs=0.02 * (biased - clean) + 0.02 * clean)


def test_a_region_is_x_then_y_from_the_top_left() -> None:
    image = np.full((20, 30), 500, np.uint16)
    image[3:7, 20:28] = ramp(4, 8)
    region = Region(x_px=20, y_px=3, width_px=8, height_px=4)
    assert focus_value(image, black_level_dn=0, region=region) == pytest.approx(
        focus_value(ramp(4, 8), black_level_dn=0), rel=1e-12
    )


def test_no_light_above_black_is_no_focus() -> None:
    assert focus_value(np.full((4, 4), 64, np.uint16), black_level_dn=64) == 0.0


def test_a_flat_scene_is_no_focus() -> None:
    assert focus_value(np.full((4, 4), 900, np.uint16), black_level_dn=64) == 0.0


def test_a_region_beyond_the_image_is_refused() -> None:
    with pytest.raises(ValueError):
        focus_value(
            ramp(), black_level_dn=0, region=Region(x_px=1, y_px=0, width_px=7, height_px=5)
        )


@pytest.mark.parametrize("changed", [{"x_px": -1}, {"width_px": 1}, {"height_px": 0}])
def test_a_region_of_no_pixels_is_refused(changed: dict[str, int]) -> None:
    with pytest.raises(ValueError):
        Region(**{"x_px": 0, "y_px": 0, "width_px": 4, "height_px": 4, **changed})


def test_an_image_too_small_for_a_difference_is_refused() -> None:
    with pytest.raises(ValueError):
        focus_value(np.zeros((1, 9), np.uint16), black_level_dn=0)
