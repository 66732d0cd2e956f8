"""Sweeps through the focus and the search of its height."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from numpy.typing import NDArray

from acquisition.focus._measures import Region, focus_value
from acquisition.focus._sweep import (
    UNKNOWN_PUPIL,
    NoFocusPeakError,
    PupilOffset,
    fit_focus_peak,
)

HEIGHTS_MM = np.linspace(270.0, 330.0, 15)


def lens(focus_mm: float, width_mm: float = 8.0) -> np.ndarray:
    """Squared gradient of an edge through a thin lens: 1 over the width of its blur."""
    defocus = (HEIGHTS_MM - focus_mm) * focus_mm / HEIGHTS_MM / width_mm
    return np.asarray(0.01 / np.sqrt(1.0 + defocus**2))


@pytest.mark.slow
@settings(max_examples=15, deadline=None)
@given(st.floats(282.0, 318.0), st.floats(0.01, 100.0))
def test_the_peak_of_a_thin_lens_is_found_exactly_whatever_the_scale(
    focus_mm: float, scale: float
) -> None:
    peak = fit_focus_peak(HEIGHTS_MM[::-1], scale * lens(focus_mm)[::-1])
    assert peak.height_mm == pytest.approx(
        focus_mm, abs=0.05
    )  # the shape leaves 0.1 % of the travel
    assert peak.value == pytest.approx(0.01 * scale, rel=0.03)


@pytest.mark.slow
def test_the_error_covers_the_scatter() -> None:
    rng = np.random.default_rng(4)
    pulls = []
    for _ in range(30):
        focus_mm = 300 + rng.uniform(-10, 10)
        peak = fit_focus_peak(HEIGHTS_MM, lens(focus_mm) + rng.normal(0, 2e-4, HEIGHTS_MM.size))
        assert abs(peak.height_mm - focus_mm) < 0.02 * 60
        pulls.append((peak.height_mm - focus_mm) / peak.err_mm)
    assert np.mean(np.abs(pulls) < 2) >= 0.8  # 93 % of 30 at 10 degrees of freedom, less 3 sigma
    assert np.std(pulls) < 1.5


def test_a_position_that_is_known_worse_counts_less() -> None:
    values, errs = lens(300.0), np.full(HEIGHTS_MM.size, 1e-5)
    values[5] *= 1.3
    errs[5] = 1e-3
    plain = fit_focus_peak(HEIGHTS_MM, values)
    weighted = fit_focus_peak(HEIGHTS_MM, values, errs)
    assert abs(weighted.height_mm - 300) < abs(plain.height_mm - 300)


@pytest.mark.parametrize(("focus_mm", "side"), [(230.0, "lower"), (400.0, "higher")])
def test_a_peak_outside_is_refused_with_the_way_to_go(focus_mm: float, side: str) -> None:
    with pytest.raises(NoFocusPeakError) as error:
        fit_focus_peak(HEIGHTS_MM, lens(focus_mm, 30.0))
    assert error.value.side == side


def test_noise_alone_holds_no_peak() -> None:
    rng = np.random.default_rng(1)
    with pytest.raises(NoFocusPeakError) as error:
        fit_focus_peak(HEIGHTS_MM, 1 + 0.01 * rng.standard_normal(HEIGHTS_MM.size))
    assert error.value.side is None


def test_too_few_positions_are_refused() -> None:
    with pytest.raises(ValueError):
        fit_focus_peak(HEIGHTS_MM[:6], lens(300.0)[:6])


def test_values_that_are_no_numbers_are_refused() -> None:
    with pytest.raises(ValueError):
        fit_focus_peak(HEIGHTS_MM, np.full(HEIGHTS_MM.size, np.nan))


def test_a_valley_is_no_peak() -> None:
    with pytest.raises(NoFocusPeakError):
        fit_focus_peak(HEIGHTS_MM, 0.02 - lens(300.0))


@pytest.mark.parametrize(("slope", "side"), [(1e-5, "higher"), (-1e-5, "lower")])
def test_values_that_rise_or_fall_all_the_way_say_where_to_go(slope: float, side: str) -> None:
    rng = np.random.default_rng(2)
    values = 0.01 + slope * (HEIGHTS_MM - 300.0) + rng.normal(0, 1e-6, HEIGHTS_MM.size)
    with pytest.raises(NoFocusPeakError) as error:
        fit_focus_peak(HEIGHTS_MM, values)
    assert error.value.side == side


def thin_lens(heights_mm: np.ndarray, f_number: float, offset_mm: float) -> np.ndarray:
    """Squared gradient of an edge by a lens of 8 mm that is focused at 300 mm, pixels of 8.3 um.

    The blur disc's variance is its diameter squared over 16 (Hecht, section 5.2); that of lens and
    pixel in focus is 0.39 px^2.
    """
    distance_mm = heights_mm + offset_mm
    disc_px = 8.0 / f_number * 8.0 * np.abs(distance_mm - 300) / (distance_mm * 292) / 8.3e-3
    return np.asarray(1 / np.sqrt(0.39 + disc_px**2 / 16))


@pytest.mark.parametrize("offset_mm", [-10.0, 12.5, 30.0])
@pytest.mark.parametrize("travel_mm", [(-30.0, 30.0), (-10.0, 40.0), (-60.0, 25.0)])
def test_the_peak_is_symmetric_in_the_inverse_distance_from_the_entrance_pupil(
    offset_mm: float, travel_mm: tuple[float, float]
) -> None:
    heights_mm = 300 - offset_mm + np.linspace(*travel_mm, 15)
    known = PupilOffset(offset_mm=offset_mm, err_mm=0.03)
    peak = fit_focus_peak(heights_mm, thin_lens(heights_mm, 4.0, offset_mm), pupil=known)
    assert peak.height_mm == pytest.approx(300 - offset_mm, abs=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("is_known", [True, False])
def test_the_interval_covers_from_f_1_4_to_f_8_on_both_sides_of_the_peak_and_on_one(
    is_known: bool,
) -> None:
    rng = np.random.default_rng(8)
    covered = []
    for number in range(120):
        f_number = (1.4, 2.0, 2.8, 4.0, 5.6, 8.0)[number % 6]
        low_mm, high_mm = ((-30, 30), (-60, 60), (-12, 45), (-45, 12))[number // 6 % 4]
        heights_mm = 287.5 + rng.uniform(-2, 2) + np.linspace(low_mm, high_mm, 15)
        values = thin_lens(heights_mm, f_number, 12.5)
        peak = fit_focus_peak(
            heights_mm,
            values * (1 + rng.normal(0, 2e-4, values.size)),
            pupil=PupilOffset(offset_mm=12.5, err_mm=0.03) if is_known else UNKNOWN_PUPIL,
        )
        covered.append(abs(peak.height_mm - 287.5) <= 1.96 * peak.err_mm)
    # Of 120 at 95 %, 106 to 119, 997 times of 1000; more where the pupil, nearer to what is
    # expected of it than one standard deviation, is a part of the error. Errors twice as large as
    # they should be hold all, half as large ones 81.
    assert 106 <= sum(covered) <= (119 if is_known else 120)


def test_what_a_textures_scale_does_is_part_of_the_error() -> None:
    values = thin_lens(HEIGHTS_MM, 1.4, 0.0)
    edge = fit_focus_peak(HEIGHTS_MM, values)
    for growth in (-1.5, 1.0):
        moved = values * (HEIGHTS_MM / 300) ** growth
        texture = fit_focus_peak(HEIGHTS_MM, moved, texture_share=1.0)
        assert abs(texture.height_mm - 300) > 5 * edge.err_mm
        assert abs(texture.height_mm - 300) < 1.96 * texture.err_mm


def test_a_pupil_below_the_target_is_refused() -> None:
    with pytest.raises(ValueError, match="above the target"):
        fit_focus_peak(HEIGHTS_MM, lens(300.0), pupil=PupilOffset(offset_mm=-280.0, err_mm=1.0))


def test_heights_from_an_unlikely_zero_have_a_peak_too() -> None:
    peak = fit_focus_peak(HEIGHTS_MM - 300.0, lens(300.0))
    assert abs(peak.height_mm) < 1.96 * peak.err_mm + 0.01


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
