import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from acquisition.focus.sweep import (
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
    for number in range(240):
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
    # 95 % of 240, less or more three standard deviations of 1.4 %; more where the pupil, which is
    # nearer to what is expected of it than one standard deviation, is a part of the error.
    assert 0.908 <= np.mean(covered) <= (0.992 if is_known else 1.0)


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
