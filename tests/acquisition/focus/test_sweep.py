import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from acquisition.focus.sweep import NoFocusPeakError, fit_focus_peak

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
