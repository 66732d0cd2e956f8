"""Control charts of calibrations over time."""

from datetime import UTC, datetime, timedelta
from math import sqrt

import numpy as np
import pytest
from hypothesis import given, strategies as st
from scipy.special import ndtr

from acquisition.files import InputFile, Provenance
from calibration.psf import PsfCalibration, control_charts, cumulative_sums, cusum_limit
from tests.calibration.known import known

START = datetime(2026, 1, 5, tzinfo=UTC)


def date(number: int) -> str:
    return (START + timedelta(days=30 * number)).isoformat()


def history(widths_px: list[float], err_px: float = 0.003) -> list[PsfCalibration]:
    """Monthly calibrations with these widths along x; those along y never change."""
    return [
        PsfCalibration(
            sigma_x_px=width,
            sigma_x_err_px=err_px,
            sigma_y_px=0.7,
            sigma_y_err_px=err_px,
            captured_utc=date(number),
        )
        for number, width in enumerate(widths_px)
    ]


def test_one_value_passes_a_limit_as_often_as_a_normal_tail() -> None:
    # Of one value, the sum is max(0, z - 1/2): above the limit where z is above limit + 1/2.
    limit = cusum_limit(1, 0.01)
    assert ndtr(-(limit + 0.5)) == pytest.approx(0.01, rel=0.02)  # states are finite


def test_the_limit_holds_for_drawn_histories() -> None:
    limit = cusum_limit(24, 0.02)
    rng = np.random.default_rng(1)
    sums, largest = np.zeros(40_000), np.zeros(40_000)
    for _ in range(24):
        sums = np.maximum(sums + rng.standard_normal(sums.size) - 0.5, 0.0)
        largest = np.maximum(largest, sums)
    # 40 000 draws know 2 % to 0.07 %
    assert np.mean(largest > limit) == pytest.approx(0.02, abs=0.003)


def test_longer_histories_have_wider_limits() -> None:
    limits = [cusum_limit(count, 0.002) for count in (5, 12, 50, 200)]
    assert limits == sorted(limits)


def test_sums_by_hand() -> None:
    # Differences from the mean before, over their errors: 1 / sqrt 2, then 5.5 / sqrt 1.5.
    up, down = cumulative_sums(np.array([0.0, 1.0, 6.0]), np.ones(3))
    first, second = 1 / sqrt(2), 5.5 / sqrt(1.5)
    assert up == pytest.approx([0.0, first - 0.5, first + second - 1.0])
    assert down == pytest.approx([0.0, 0.0, 0.0])


@given(st.lists(st.floats(-5, 5), min_size=5, max_size=20), st.floats(0.1, 10), st.floats(-50, 50))
def test_scale_and_offset_do_not_matter(values: list[float], scale: float, offset: float) -> None:
    errs = np.linspace(0.5, 1.5, len(values))
    plain = cumulative_sums(np.array(values), errs)
    other = cumulative_sums(scale * np.array(values) + offset, scale * errs)
    assert np.allclose(plain[0], other[0], atol=1e-6)
    assert np.allclose(plain[1], other[1], atol=1e-6)


def test_a_rise_upwards_is_a_fall_of_the_mirrored_values() -> None:
    values, errs = np.array([0.1, -0.3, 0.8, 1.2, 2.0]), np.full(5, 0.4)
    assert cumulative_sums(values, errs)[0] == pytest.approx(cumulative_sums(-values, errs)[1])


def test_a_step_is_named_with_its_date_and_size() -> None:
    charts = control_charts(history([0.7] * 6 + [0.721] * 6))
    drift = known(charts[0].drift)
    assert (drift.kind, drift.after_utc, drift.before_utc) == ("step", date(5), date(6))
    assert drift.change == pytest.approx(0.021)
    assert drift.change_err == pytest.approx(0.003 * sqrt(1 / 6 + 1 / 6))  # of two means
    assert charts[0].centre == pytest.approx(0.7)
    assert date(6) <= drift.seen_utc <= date(8)
    assert "sigma x changed at once, by +3.00 ± 0.48 %" in str(charts[0])
    assert charts[1].drift is None
    assert str(charts[1]) == "sigma y: no drift in 12 calibrations"


def test_a_steady_drift_is_told_from_a_step() -> None:
    drift = known(
        control_charts(history([0.7] * 6 + [0.7 + 0.006 * n for n in range(1, 13)]))[0].drift
    )
    assert drift.kind == "steady"
    assert drift.after_utc <= date(5) < drift.before_utc
    assert drift.change == pytest.approx(0.072, rel=1e-6)


def test_what_is_within_the_errors_is_no_drift() -> None:
    rng = np.random.default_rng(3)
    widths = 0.7 + 0.003 * rng.standard_normal(24)
    assert all(one.drift is None for one in control_charts(history(widths.tolist())))


def test_four_calibrations_and_those_without_a_date_have_no_chart() -> None:
    few = history([0.7] * 4)
    undated = [one.model_copy(update={"captured_utc": None}) for one in history([0.7] * 6)]
    assert control_charts(few) == ()
    assert control_charts([*few, *undated]) == ()


def test_calibrations_of_the_same_captures_count_once() -> None:
    made = Provenance(
        version="1",
        created="2026-01-01T00:00:00+00:00",
        command="calibrate",
        inputs=(InputFile(path="journal.jsonl", sha256="a" * 64),),
    )
    again = [one.model_copy(update={"provenance": made}) for one in history([0.7] * 8)]
    assert control_charts(again) == ()
