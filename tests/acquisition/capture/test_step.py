"""One step of a run: its exposure, and its bracket."""

import math
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from hypothesis import given, strategies as st

from acquisition.bench import BenchDevices
from acquisition.capture._quality import bracket_remarks
from acquisition.capture._runner import RunOperator, RunSummary, run_plan
from acquisition.capture._step import (
    _bracket_exposures_us,
    _next_exposure,
    flicker_fraction,
    without_flicker,
)
from acquisition.errors import PlanError, SessionError
from acquisition.plan import CapturePlan, estimate_plan, plan_entries
from acquisition.session._capture_files import read_capture
from acquisition.session._reader import Session, verify
from acquisition.session._record import CaptureRecord
from hil_mocks import SimulatedBench
from tests.acquisition.records import RECORD
from tests.acquisition.session_fixtures import plan_of
from tests.hil_mocks.benches import bench_config

BLACK_DN, MAX_DN = 64.0, 4095.0
LIMITS_US = (50.0, 16000.0)


def bright(exposure_us: float, dn_per_us: float) -> float:
    return min(BLACK_DN + dn_per_us * exposure_us, MAX_DN)


@given(
    dn_per_us=st.floats(0.05, 50.0),
    start_us=st.floats(50.0, 16000.0),
    mains_hz=st.sampled_from([0.0, 50.0, 60.0]),
)
def test_a_linear_camera_is_well_exposed_within_eight_pictures(
    dn_per_us: float, start_us: float, mains_hz: float
) -> None:
    exposure_us = start_us
    for _ in range(8):
        step = _next_exposure(
            exposure_us,
            bright(exposure_us, dn_per_us),
            black_level_dn=BLACK_DN,
            max_level_dn=MAX_DN,
            limits_us=LIMITS_US,
            mains_hz=mains_hz,
        )
        assert LIMITS_US[0] <= step.exposure_us <= LIMITS_US[1]
        if step.is_settled:
            break
        exposure_us = step.exposure_us
    assert step.is_settled
    light = (bright(exposure_us, dn_per_us) - BLACK_DN) / (MAX_DN - BLACK_DN)
    # Within 10 % of the exposure for 70 %, or there is a reason.
    assert bool(step.limited_by) == (not 0.7 / 1.1 <= light <= 0.7 / 0.9)
    at_a_limit = exposure_us <= LIMITS_US[0] * 1.12 or exposure_us >= LIMITS_US[1] / 1.12
    if mains_hz == 0 and not at_a_limit:
        assert 0.6 <= light <= 0.8
    assert light < 0.8 or exposure_us <= LIMITS_US[0] * 1.12


def test_a_saturated_picture_says_only_shorter() -> None:
    step = _next_exposure(
        8000.0, MAX_DN, black_level_dn=BLACK_DN, max_level_dn=MAX_DN, limits_us=LIMITS_US
    )
    assert (step.exposure_us, step.is_settled) == (2000.0, False)


@pytest.mark.parametrize(
    ("dn_per_us", "mains_hz", "limited_by"),
    [
        (0.25, 0.0, ()),  # 11.3 ms
        (0.25, 50.0, ("flicker",)),  # 10 ms of 11.3
        (0.14, 50.0, ("longest", "flicker")),  # 16 of 20 ms, then 10
        (0.14, 0.0, ("longest",)),
        (0.282, 50.0, ()),  # 10 of 10.006 ms
        (80.0, 50.0, ("shortest",)),  # 35 us
        (500.0, 50.0, ("shortest",)),  # saturated at 50 us
        (0.0, 0.0, ("longest",)),
    ],
)
def test_what_keeps_the_exposure_from_seventy_per_cent_is_said(
    dn_per_us: float, mains_hz: float, limited_by: tuple[str, ...]
) -> None:
    exposure_us = 2000.0
    for _ in range(8):
        step = _next_exposure(
            exposure_us,
            bright(exposure_us, dn_per_us),
            black_level_dn=BLACK_DN,
            max_level_dn=MAX_DN,
            limits_us=LIMITS_US,
            mains_hz=mains_hz,
        )
        exposure_us = step.exposure_us
    assert step.is_settled
    assert step.limited_by == limited_by


@pytest.mark.parametrize("limits_us", [(0.0, 1.0), (2.0, 1.0), (math.nan, 1.0)])
def test_limits_out_of_order_are_refused(limits_us: tuple[float, float]) -> None:
    with pytest.raises(ValueError):
        _next_exposure(1.0, 1.0, black_level_dn=0, max_level_dn=9, limits_us=limits_us)


@given(exposure_us=st.floats(1.0, 1e6), mains_hz=st.sampled_from([50.0, 60.0]))
def test_whole_periods_keep_no_flicker(exposure_us: float, mains_hz: float) -> None:
    cut_us = without_flicker(exposure_us, mains_hz)
    assert cut_us <= exposure_us * (1 + 1e-9)
    if cut_us >= 0.5e6 / mains_hz:
        assert flicker_fraction(cut_us, mains_hz) < 1e-9


def test_the_flicker_that_is_left_is_a_sinc() -> None:
    assert flicker_fraction(5000.0, 50) == pytest.approx(2 / math.pi)  # half a period
    assert flicker_fraction(1e-3, 50) == pytest.approx(1.0)
    assert flicker_fraction(9000.0, 0) == 0.0


def test_longer_exposures_of_a_bracket_are_whole_periods_of_the_flicker() -> None:
    assert _bracket_exposures_us(9000.0, (1.0, 4.0, 16.0), 50) == (9000.0, 30_000.0, 140_000.0)
    assert _bracket_exposures_us(500.0, (1.0, 8.0), 50) == (500.0, 4000.0)
    assert _bracket_exposures_us(9000.0, (1.0, 4.0, 16.0), 0) == (9000.0, 36_000.0, 144_000.0)


@given(st.floats(21.0, 1e6), st.floats(1.5, 32.0), st.integers(2, 12), st.sampled_from([0, 50, 60]))
def test_exposures_of_a_bracket_ascend(
    shortest_us: float, ratio: float, count: int, mains_hz: float
) -> None:
    exposures_us = _bracket_exposures_us(
        shortest_us, [ratio**number for number in range(count)], mains_hz
    )
    assert exposures_us[0] == shortest_us
    assert all(one < other for one, other in pairwise(exposures_us))


FRAMES = 4


def bracket_plan(bracket: dict[str, Any] | None, **changes: object) -> CapturePlan:
    target: dict[str, object] = {"kind": "chart", "target": "step tablet"}
    if bracket is not None:
        target["bracket"] = bracket
    return plan_of(
        heights_mm=[200.0], frames_per_capture=FRAMES, **{"targets": [target], **changes}
    )


def captured(path: Path, plan: CapturePlan) -> tuple[SimulatedBench, RunSummary]:
    bench = SimulatedBench(bench_config(camera__exposure_us=8000.0, optics__pixel_pitch_um=60.0))
    devices = BenchDevices(
        config=bench_config(camera__exposure_us=8000.0, optics__pixel_pitch_um=60.0),
        camera=bench.camera,
        stage=bench.stage,
        clock=lambda: bench.clock.now_s,
        sleep=bench.clock.advance,
    )

    def place(entry: Any) -> Any:
        bench.place(entry.target, entry.orientation_deg)
        return "ready"

    return bench, run_plan(path, plan, devices, RunOperator(name="Zoë", place=place))


def test_a_bracket_is_one_capture_of_linear_light_with_its_errors(tmp_path: Path) -> None:
    path = tmp_path / "session"
    bench, summary = captured(path, bracket_plan({"exposures": 4, "ratio": 10.0}))
    assert summary.captured == 1
    assert verify(path).is_ok
    session = Session(path)
    (record,) = session.records
    # Longer ones are shortened to whole periods of lamps on 50 Hz: 10 ms.
    assert [one.exposure_us for one in record.bracket or ()] == [8000, 80_000, 800_000, 8_000_000]
    assert (record.exposure_us, record.frames_used) == (8000.0, 4 * FRAMES)
    images = session.load(record)
    light = bench.truth.expected_image_dn("step tablet", 0.0, bench.pose, exposure_us=8000.0)
    light -= record.black_level_dn
    assert light.max() / light.min() == pytest.approx(1e4, rel=0.01)
    assert images.variance_dn2 is not None
    error_dn = np.sqrt(images.variance_dn2 / record.frames_used)
    pulls = (images.mean_dn - record.black_level_dn - light) / error_dn
    assert np.mean(np.abs(pulls) < 1.96) == pytest.approx(0.95, abs=0.01)  # 6144: 3.6 deviations
    assert images.exposures_used is not None
    assert images.exposures_used.min() >= 1
    assert set(np.unique(images.exposures_used)) == {1, 2, 3, 4}
    again = read_capture(path / record.file)
    np.testing.assert_array_equal(again.exposures_used, images.exposures_used)
    assert CaptureRecord.from_json(record.to_json()) == record


def test_a_bracket_resumes_and_another_one_is_another_plan(tmp_path: Path) -> None:
    path = tmp_path / "session"
    plan = bracket_plan({"exposures": 2, "ratio": 4.0})
    captured(path, plan)
    _, again = captured(path, plan)
    assert (again.captured, again.already_captured) == (0, 1)
    (path / Session(path).records[0].file).unlink()
    _, repaired = captured(path, plan)
    assert repaired.captured == 1
    with pytest.raises(SessionError) as refused:
        captured(path, bracket_plan({"exposures": 3, "ratio": 4.0}))
    assert refused.value.fault == "made otherwise"
    assert "plan.targets.0.bracket.exposures" in refused.value.keys


def test_raw_frames_of_a_bracket_are_kept_exposure_by_exposure(tmp_path: Path) -> None:
    path = tmp_path / "session"
    captured(path, bracket_plan({"exposures": 2}, keep_frames=True))
    (record,) = Session(path).records
    assert record.frames_file is not None
    frames = tifffile.imread(path / record.frames_file)
    assert len(frames) == 2 * FRAMES
    levels = frames.mean(axis=(1, 2))
    assert levels[:FRAMES].max() < levels[FRAMES:].min()


def test_a_record_without_a_bracket_is_that_of_earlier_versions() -> None:
    assert "bracket" not in RECORD.to_json()


@pytest.mark.parametrize(
    "bracket", [{"exposures": 1}, {"exposures": 3, "ratio": 1.0}, {"ratio": 8.0}, {"steps": 3}]
)
def test_an_impossible_bracket_is_refused_by_its_key(bracket: dict[str, Any]) -> None:
    with pytest.raises(PlanError) as refused:
        bracket_plan(bracket)
    assert refused.value.keys[0].startswith("targets.0.bracket.")


def test_the_estimate_of_a_bracket_counts_each_exposure_and_three_pages() -> None:
    bench = bench_config(camera__exposure_us=8000.0)
    plain, four = (
        estimate_plan(plan, plan_entries(plan), bench, (64, 96))
        for plan in (bracket_plan(None), bracket_plan({"exposures": 4, "ratio": 10.0}))
    )
    assert (plain.bytes_, four.bytes_) == (8 * 64 * 96, 12 * 64 * 96)
    # Five frames each, one of them skipped, and four starts of the stream instead of one.
    assert four.seconds - plain.seconds == pytest.approx(5 * (0.08 + 0.8 + 8.0) + 3 * 0.25)


def test_exposures_that_disagree_by_more_than_a_percent_are_remarked(tmp_path: Path) -> None:
    path = tmp_path / "session"
    captured(path, bracket_plan({"exposures": 2}))
    (record,) = Session(path).records
    assert bracket_remarks(record) == ()
    assert bracket_remarks(RECORD) == ()
    document = record.to_json()
    document["bracket"][1]["light_ratio"] = 1.023
    (remark,) = bracket_remarks(CaptureRecord.from_json(document))
    assert "+2.3 %" in remark
