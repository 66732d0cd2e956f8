"""The fixed pattern of a sensor, of which rows, columns and pixels are known."""

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.ndimage import gaussian_filter

from calibration.noise import pattern_parts, pattern_spectra, share_passed
from simulation.arrays import FloatArray

ROWS, COLS = 300, 400


def pattern(rows: float, columns: float, pixels: float, seed: int = 1) -> FloatArray:
    rng = np.random.default_rng(seed)
    return np.asarray(
        rng.normal(0, 1, (ROWS, 1)) * rows
        + rng.normal(0, 1, (1, COLS)) * columns
        + rng.normal(0, 1, (ROWS, COLS)) * pixels
    )


SOUND = np.ones((ROWS, COLS), dtype=np.bool_)


def test_rows_columns_and_pixels_are_told_apart() -> None:
    found = pattern_parts(pattern(2.0, 0.7, 4.0), SOUND, 0.0)
    assert found.rows == pytest.approx(2.0, rel=4 / np.sqrt(2 * ROWS))
    assert found.columns == pytest.approx(0.7, rel=4 / np.sqrt(2 * COLS))
    assert found.pixels == pytest.approx(4.0, rel=4 / np.sqrt(2 * ROWS * COLS))
    assert found.total == pytest.approx(np.sqrt(2.0**2 + 0.7**2 + 4.0**2), rel=0.04)


def test_the_error_is_the_scatter_over_sensors() -> None:
    totals = [pattern_parts(pattern(2.0, 0.7, 4.0, seed), SOUND, 0.0).total for seed in range(40)]
    stated = pattern_parts(pattern(2.0, 0.7, 4.0), SOUND, 0.0).err
    assert np.std(totals, ddof=1) == pytest.approx(stated, rel=0.35)  # of 40


def test_pixels_alone_are_no_rows_and_no_columns() -> None:
    found = pattern_parts(pattern(0.0, 0.0, 4.0), SOUND, 0.0)
    # Row means scatter by 4 / sqrt(400) = 0.2 without a pattern; what is left is a share of that.
    assert found.rows < 0.1
    assert found.columns < 0.1


def test_temporal_noise_and_defects_do_not_count() -> None:
    levels = pattern(0.0, 0.0, 5.0)
    found = pattern_parts(levels, SOUND, 9.0)
    assert found.pixels == pytest.approx(4.0, rel=0.02)
    sound = SOUND.copy()
    sound[7, 9] = False
    levels[7, 9] = 1e5
    assert pattern_parts(levels, sound, 9.0).pixels == pytest.approx(found.pixels, rel=1e-3)


def test_what_a_high_pass_takes_from_rows_and_columns_is_added_again() -> None:
    levels = pattern(2.0, 1.0, 4.0)
    high = levels - gaussian_filter(levels, 12.0, mode="nearest")
    found = pattern_parts(high, SOUND, 0.0, share_passed(12.0))
    whole = pattern_parts(levels, SOUND, 0.0)
    # 300 rows are 25 widths of the window: what it leaves of them scatters by a few per cent.
    assert found.rows == pytest.approx(whole.rows, rel=0.03)
    assert found.columns == pytest.approx(whole.columns, rel=0.03)


def test_a_high_pass_leaves_what_its_window_does_not_average() -> None:
    sigma_px = 12.0
    closed = 1 - 2 / (sigma_px * np.sqrt(2 * np.pi)) + 1 / (2 * sigma_px * np.sqrt(np.pi))
    assert share_passed(sigma_px) == pytest.approx(closed, rel=1e-6)


@given(st.floats(0.1, 10.0))
def test_the_parts_are_in_the_unit_of_the_pattern(factor: float) -> None:
    levels = pattern(1.0, 0.5, 2.0)
    one, other = (pattern_parts(each, SOUND, 0.0) for each in (levels, factor * levels))
    for name in ("total", "rows", "columns", "pixels"):
        assert getattr(other, name) == pytest.approx(factor * getattr(one, name))


def test_white_noise_has_its_own_standard_deviation_at_every_frequency() -> None:
    found = pattern_spectra(pattern(0.0, 0.0, 3.0), SOUND, 1.0)
    assert found.freq_x_cy_per_px[-1] == found.freq_y_cy_per_px[-1] == 0.5
    assert found.along_x[1:] == pytest.approx(3.0, rel=5 / np.sqrt(ROWS))
    assert found.along_y[1:] == pytest.approx(3.0, rel=5 / np.sqrt(COLS))
    assert found.temporal == 1.0


def test_stripes_are_a_peak_at_their_frequency_along_one_axis() -> None:
    columns = np.arange(COLS)
    levels = pattern(0.0, 0.0, 0.1) + 2.0 * np.sin(2 * np.pi * columns / 8)
    found = pattern_spectra(levels, SOUND, 0.0)
    peak = int(np.argmax(found.along_x))
    assert found.freq_x_cy_per_px[peak] == pytest.approx(1 / 8)
    # Of amplitude 2, over N columns: 2 sqrt(N) / 2.
    assert found.along_x[peak] == pytest.approx(np.sqrt(COLS), rel=0.01)
    assert found.along_y[1:].max() < 1.0
