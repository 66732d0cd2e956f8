"""Runs of a plan, with all options."""

import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile

from acquisition.bench import BenchConfig, BenchDevices
from acquisition.capture._quality import QualityFinding
from acquisition.capture._runner import (
    CaptureProgress,
    Placement,
    RunOperator,
    RunSummary,
    Verdict,
    run_plan,
)
from acquisition.devices import Frame
from acquisition.errors import (
    CaptureError,
    DeviceDisconnectedError,
    DeviceError,
    DeviceTimeoutError,
    OperatorStopError,
    SessionError,
    StageLimitError,
    StageStoppedError,
    StreamInterruptedError,
)
from acquisition.plan import CapturePlan, PlanEntry
from acquisition.session._journal import Stamps
from acquisition.session._reader import Session, verify
from tests.acquisition.fakes import (
    SETTINGS,
    FakeUids,
    FakeUtc,
    ScriptedCamera,
    ScriptedStage,
    frame,
    steady_frames,
)
from tests.acquisition.session_fixtures import bench_of, plan_of

ALL_HEIGHTS_MM = [100.0, 110.0] * 3


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "session"


def always_ready(_: PlanEntry) -> Placement:
    return "ready"


def run(
    path: Path,
    *,
    plan: CapturePlan | None = None,
    camera: ScriptedCamera | None = None,
    stage: ScriptedStage | None = None,
    bench: BenchConfig | None = None,
    sleep: Callable[[float], None] = time.sleep,
    retake: Sequence[int] = (),
    prefix: str = "uid",
    **attended: Any,
) -> RunSummary:
    """Run a plan on scripted devices; ``attended`` are what a `RunOperator` is asked and told."""
    camera = camera or ScriptedCamera()
    devices = BenchDevices(
        config=bench or bench_of(),
        camera=camera,
        stage=stage or ScriptedStage(),
        clock=camera.clock,
        sleep=sleep,
    )
    return run_plan(
        path,
        plan or plan_of(),
        devices,
        RunOperator(**{"name": "Zoë", "place": always_ready, **attended}),
        retake=retake,
        stamps=Stamps(utc_now=FakeUtc(), new_uid=FakeUids(prefix)),
    )


def kinds(path: Path) -> list[str]:
    return [event.kind for event in Session(path).events]


def failing_after(good_frames: int, fault: BaseException) -> Iterator[Frame | BaseException]:
    frames = steady_frames()
    for _ in range(good_frames):
        yield next(frames)
    yield fault


def test_a_run_captures_the_whole_plan_in_order(path: Path) -> None:
    stage = ScriptedStage()
    assert run(path, stage=stage) == RunSummary(captured=6, already_captured=0, skipped=0)
    session = Session(path)
    assert [r.index for r in session.records] == list(range(6))
    assert [r.height_mm for r in session.records] == ALL_HEIGHTS_MM
    assert stage.moves_mm == ALL_HEIGHTS_MM
    assert stage.homings == 1
    assert kinds(path) == ["start", "plan", *["capture"] * 6]
    assert verify(path).is_ok
    # levels 999 and 1001 in turn from a skipped 1001: 999, 1001, 999
    images = session.load(session.records[0])
    assert images.mean_dn == pytest.approx(np.float32(2999 / 3), abs=0)
    assert images.variance_dn2 == pytest.approx(4 / 3, rel=1e-7)


def test_a_record_tells_how_the_capture_was_made(path: Path) -> None:
    run(path)
    record = Session(path).records[0]
    assert (record.exposure_us, record.gain_db, record.pixel_format) == (2000.0, 0.0, "Mono12")
    assert (record.black_level_dn, record.max_level_dn) == (64.0, 4095.0)
    assert (record.frames_used, record.incomplete_frames) == (3, 0)
    assert record.started_utc < record.finished_utc
    assert (record.first_timestamp_ns, record.last_timestamp_ns) == (40_000_000, 80_000_000)
    assert record.focus_value is not None
    assert [r.focus_value for r in Session(path).records[4:]] == [None, None]  # flats


def test_a_camera_snapshot_uses_the_genicam_names(path: Path) -> None:
    run(path)
    camera = Session(path).devices["camera"]
    assert camera["DeviceSerialNumber"] == "C1"
    assert (camera["ExposureTime"], camera["Gain"], camera["Gamma"]) == (2000.0, 0.0, 1.0)
    assert Session(path).devices["stage"]["limits_mm"] == [0.0, 300.0]


def test_the_operator_is_asked_once_for_each_target_and_orientation(path: Path) -> None:
    asked: list[tuple[str, str, float]] = []

    def place(entry: PlanEntry) -> Placement:
        asked.append(entry.placement)
        return "ready"

    run(path, place=place)
    assert asked == [("edge", "Kante", 5.0), ("edge", "Kante", 95.0), ("flat", "paper", 0.0)]


def test_a_skipped_placement_is_left_for_another_run(path: Path) -> None:
    def place(entry: PlanEntry) -> Placement:
        return "skip" if entry.orientation_deg == 95.0 else "ready"

    assert run(path, place=place) == RunSummary(captured=4, already_captured=0, skipped=2)
    assert kinds(path).count("skip") == 2
    assert run(path, prefix="b") == RunSummary(captured=2, already_captured=4, skipped=0)
    assert Session(path).is_complete


def test_progress_counts_captures_of_earlier_runs_too(path: Path) -> None:
    with pytest.raises(CaptureError):
        run(
            path,
            camera=ScriptedCamera([f for f, _ in zip(steady_frames(), range(8), strict=False)]),
        )
    seen: list[tuple[int, int, int]] = []
    run(
        path,
        progress=lambda p: seen.append((p.captured, p.planned, p.record.frames_used)),
        prefix="b",
    )
    assert seen == [(3, 6, 3), (4, 6, 3), (5, 6, 3), (6, 6, 3)]


def test_a_homed_stage_is_not_homed_again(path: Path) -> None:
    stage = ScriptedStage(is_homed=True)
    run(path, stage=stage)
    assert stage.homings == 0


def test_repeats_do_not_move_the_stage_again(path: Path) -> None:
    stage = ScriptedStage()
    run(path, plan=plan_of(repeats=3), stage=stage)
    assert stage.moves_mm == ALL_HEIGHTS_MM
    assert len(Session(path).records) == 18


def test_the_plan_may_ask_for_more_frames_than_the_bench(path: Path) -> None:
    run(path, plan=plan_of(frames_per_capture=5))
    assert {r.frames_used for r in Session(path).records} == {5}


def test_raw_frames_are_kept_where_the_plan_asks(path: Path) -> None:
    run(path, plan=plan_of(keep_frames=True))
    session = Session(path)
    record = session.records[3]
    assert record.frames_file is not None
    raw = tifffile.imread(path / record.frames_file)
    assert raw.shape == (3, 4, 6)
    np.testing.assert_array_equal(raw.mean(0).astype(np.float32), session.load(record).mean_dn)


def test_the_height_read_back_is_recorded_not_the_one_asked_for(path: Path) -> None:
    run(path, stage=ScriptedStage(error_mm=-0.002))
    record = Session(path).records[0]
    assert (record.height_asked_mm, record.height_mm) == (100.0, 99.998)


@pytest.mark.parametrize("error_mm", [0.02, -0.02, float("nan"), float("inf")])
def test_a_stage_that_is_not_where_it_was_sent_ends_the_run(path: Path, error_mm: float) -> None:
    camera = ScriptedCamera()
    with pytest.raises(StageStoppedError) as refused:
        run(path, camera=camera, stage=ScriptedStage(error_mm=error_mm))
    assert refused.value.height_mm == pytest.approx(100.0 + error_mm, nan_ok=True)
    assert camera.starts == 0
    assert Session(path).records == ()


def test_a_stage_that_creeps_during_the_exposure_ends_the_run(path: Path) -> None:
    stage = ScriptedStage()
    stage.creep_mm = 0.05
    with pytest.raises(StageStoppedError) as refused:
        run(path, stage=stage)
    assert refused.value.height_mm == 100.05
    assert Session(path).records == ()


@pytest.mark.parametrize("when", ["before", "after"])
def test_a_capture_that_overlaps_a_move_is_refused(path: Path, when: str) -> None:
    stage = ScriptedStage()

    class Jogged(ScriptedCamera):
        """Somebody moves the stage while it exposes."""

        def stop(self) -> None:
            super().stop()
            stage.state = "moving"

    if when == "before":
        stage.state = "moving"
    camera = ScriptedCamera() if when == "before" else Jogged()
    with pytest.raises(DeviceError):
        run(path, camera=camera, stage=stage)
    assert Session(path).records == ()
    assert camera.starts == (0 if when == "before" else 1)


def test_a_plan_beyond_the_travel_moves_nothing_and_makes_no_session(path: Path) -> None:
    stage = ScriptedStage(limits_mm=(0.0, 105.0))
    with pytest.raises(StageLimitError) as refused:
        run(path, stage=stage)
    assert (refused.value.height_mm, refused.value.limits_mm) == (110.0, (0.0, 105.0))
    assert (stage.moves_mm, stage.homings) == ([], 0)
    assert not path.exists()


@pytest.mark.parametrize(
    "fault",
    [
        DeviceDisconnectedError("cable out"),
        DeviceTimeoutError("mute"),
        KeyboardInterrupt(),
        OperatorStopError("stopped by the operator"),
    ],
)
def test_a_fault_in_mid_capture_keeps_what_was_captured_and_the_same_call_resumes(
    path: Path, fault: BaseException
) -> None:
    camera = ScriptedCamera(failing_after(11, fault))  # two captures of four frames, and three
    with pytest.raises((DeviceError, KeyboardInterrupt)):
        run(path, camera=camera)
    before = Session(path).records
    assert [r.index for r in before] == [0, 1]
    last = Session(path).events[-1]
    assert last.kind == (
        "stop" if isinstance(fault, KeyboardInterrupt | OperatorStopError) else "error"
    )
    assert last.facts["index"] == 2
    assert run(path, prefix="b") == RunSummary(captured=4, already_captured=2, skipped=0)
    session = Session(path)
    assert session.is_complete
    assert session.records[:2] == before
    assert verify(path).is_ok


def test_an_error_is_journaled_with_its_name_and_message(path: Path) -> None:
    camera = ScriptedCamera(failing_after(2, DeviceDisconnectedError("cable out")))
    with pytest.raises(DeviceDisconnectedError):
        run(path, camera=camera)
    assert Session(path).events[-1].facts == {
        "index": 0,
        "error": "DeviceDisconnectedError",
        "message": "cable out",
    }


def test_a_capture_whose_stream_broke_off_is_begun_once_more_from_its_first_frame(
    path: Path,
) -> None:
    def script() -> Iterator[Frame | BaseException]:
        for _ in range(6):  # a capture, then the skipped frame and one of the next
            yield frame(4000, next(ids))
        yield StreamInterruptedError("no frame for 1.0 s")
        while True:
            yield frame(1000, next(ids))

    ids = iter(range(1, 1000))
    assert run(path, camera=ScriptedCamera(script())) == RunSummary(
        captured=6, already_captured=0, skipped=0
    )
    session = Session(path)
    assert kinds(path)[:5] == ["start", "plan", "capture", "error", "capture"]
    error = next(event for event in session.events if event.kind == "error")
    assert error.facts["index"] == 1
    assert error.facts["error"] == "StreamInterruptedError"
    assert "the capture is restarted" in str(error.facts["message"])
    # Nothing of the broken average is in the new one: its frames were at 4000.
    assert (session.records[1].min_dn, session.records[1].max_dn) == (1000, 1000)
    assert verify(path).is_ok


def test_a_capture_whose_stream_breaks_off_again_and_again_goes_on_while_a_camera_is_waited_for(
    path: Path,
) -> None:
    ids = iter(range(1, 1000))

    def script() -> Iterator[Frame | BaseException]:
        for _ in range(4):
            for _ in range(2):
                yield frame(4000, next(ids))
            yield StreamInterruptedError("no frame for 1.0 s")
        while True:
            yield frame(1000, next(ids))

    assert run(path, camera=ScriptedCamera(script())).captured == 6
    assert kinds(path)[:7] == ["start", "plan", "error", "error", "error", "error", "capture"]
    assert Session(path).records[0].max_dn == 1000  # nothing of what was broken off


def test_where_a_lost_camera_is_not_waited_for_a_stream_that_breaks_off_twice_ends_the_run(
    path: Path,
) -> None:
    ids = iter(range(1, 1000))
    bench = bench_of()
    bench = bench.model_copy(
        update={"camera": bench.camera.model_copy(update={"reconnect_timeout_s": 0.0})}
    )

    def script() -> Iterator[Frame | BaseException]:
        for count in (6, 2):
            for _ in range(count):
                yield frame(1000, next(ids))
            yield StreamInterruptedError("no frame for 1.0 s")

    with pytest.raises(StreamInterruptedError):
        run(path, camera=ScriptedCamera(script()), bench=bench)
    assert kinds(path) == ["start", "plan", "capture", "error", "error"]


@pytest.mark.parametrize("stop", [KeyboardInterrupt(), OperatorStopError("stopped")])
def test_a_stop_in_mid_move_stops_the_stage(path: Path, stop: BaseException) -> None:
    def interrupt(height_mm: float) -> None:
        if height_mm == 110.0:
            raise stop

    stage = ScriptedStage(on_move=interrupt)
    with pytest.raises(type(stop)):
        run(path, stage=stage)
    assert stage.stops == 1
    assert kinds(path)[-2:] == ["capture", "stop"]


def test_a_stage_fault_in_mid_move_stores_no_capture(path: Path) -> None:
    def stall(height_mm: float) -> None:
        if height_mm == 110.0:
            raise DeviceTimeoutError("never settles")

    with pytest.raises(DeviceTimeoutError):
        run(path, stage=ScriptedStage(on_move=stall))
    assert [r.height_mm for r in Session(path).records] == [100.0]


def test_an_error_of_a_callback_is_journaled_and_raised(path: Path) -> None:
    def fail(_: CaptureProgress) -> None:
        raise RuntimeError("screen gone")

    with pytest.raises(RuntimeError):
        run(path, progress=fail)
    assert kinds(path)[-2:] == ["capture", "error"]


def test_where_even_the_journal_cannot_be_written_the_first_error_is_the_one_raised(
    path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object) -> None:
        raise SessionError("journal full")

    def place(_: PlanEntry) -> Placement:
        monkeypatch.setattr("acquisition.session._writer.SessionWriter.journal", full)
        raise DeviceError("first")

    with pytest.raises(DeviceError) as caught:
        run(path, place=place)
    assert caught.value.__notes__ == ["this could not be journaled: journal full"]


def test_a_complete_session_touches_no_device(path: Path) -> None:
    run(path)
    camera, stage = ScriptedCamera(), ScriptedStage()
    summary = run(path, camera=camera, stage=stage, prefix="b")
    assert summary == RunSummary(captured=0, already_captured=6, skipped=0)
    assert (camera.starts, stage.homings, stage.moves_mm) == (0, 0, [])


def test_another_camera_cannot_go_on_with_a_session(path: Path) -> None:
    run(path)
    camera = ScriptedCamera()
    camera.info = replace(camera.info, serial_number="C2")
    with pytest.raises(SessionError) as refused:
        run(path, camera=camera, prefix="b")
    assert refused.value.keys == ("devices.camera.DeviceSerialNumber",)


def test_a_saturated_capture_is_stored_with_its_count(path: Path) -> None:
    script = (frame(SETTINGS.max_level_dn, i) for i in range(1, 100))
    run(path, camera=ScriptedCamera(script))
    assert Session(path).records[0].saturated_pixels == 24


def test_findings_are_told_and_noted_and_the_capture_is_kept(path: Path) -> None:
    seen: list[str] = []
    script = (frame(100, i) for i in range(1, 100))
    plan = plan_of(targets=[{"kind": "edge", "target": "Kante"}])
    run(
        path,
        plan=plan,
        camera=ScriptedCamera(script),
        progress=lambda p: seen.extend(f.problem for f in p.findings),
    )
    assert seen == ["under-exposed", "under-exposed"]
    assert kinds(path) == ["start", "plan", "capture", "note", "capture", "note"]
    session = Session(path)
    assert session.events[3].facts["capture"] == session.records[0].uid
    assert "under-exposed" in str(session.events[3].facts["text"])


def test_a_bad_capture_is_taken_again_where_the_operator_says_so(path: Path) -> None:
    script = (frame(100 if i <= 4 else 1000, i) for i in range(1, 100))
    asked: list[int] = []

    def review(entry: PlanEntry, findings: tuple[QualityFinding, ...]) -> Verdict:
        asked.append(entry.index)
        assert findings[0].problem == "under-exposed"
        return "retake"

    summary = run(path, camera=ScriptedCamera(script), review=review)
    assert (asked, summary.captured) == ([0], 6)
    session = Session(path)
    assert session.is_complete
    assert session.records[0].max_dn == 1000
    assert session.records[0].file.endswith("_take2.tif")
    assert kinds(path)[2:6] == ["capture", "note", "retake", "capture"]


def test_captures_are_taken_again_on_request(path: Path) -> None:
    run(path)
    before = Session(path).records
    assert run(path, retake=[1, 4], prefix="b").captured == 2
    session = Session(path)
    assert session.is_complete
    assert [r.uid == b.uid for r, b in zip(session.records, before, strict=True)] == [
        index not in (1, 4) for index in range(6)
    ]
    assert verify(path).is_ok


def test_a_retake_of_what_is_not_there_is_refused(path: Path) -> None:
    run(path)
    with pytest.raises(SessionError) as refused:
        run(path, retake=[9], prefix="b")
    assert refused.value.fault == "no capture"


def test_the_stage_is_parked_at_the_end_of_a_run_that_captured_something(path: Path) -> None:
    bench = bench_of()
    parked = bench.model_copy(update={"stage": bench.stage.model_copy(update={"park_mm": 290.0})})
    stage = ScriptedStage()
    run(path, stage=stage, bench=parked)
    assert stage.moves_mm == [*ALL_HEIGHTS_MM, 290.0]
    stage = ScriptedStage()
    run(path, stage=stage, bench=parked, prefix="b")
    assert stage.moves_mm == []


def test_the_plan_may_wait_longer_after_a_move(path: Path) -> None:
    waits_s: list[float] = []
    run(path, plan=plan_of(settle_s=1.5, repeats=2), sleep=waits_s.append)
    assert waits_s == [1.5] * 6


def test_the_hook_before_a_capture_finds_the_stage_at_rest(path: Path) -> None:
    stage = ScriptedStage()
    states: list[str] = []
    run(path, stage=stage, before_capture=lambda: states.append(stage.state))
    assert states == ["idle"] * 6


class LinearCamera(ScriptedCamera):
    """Sees light in proportion to its exposure."""

    dn_per_us = 0.5

    def next_frame(self, timeout_s: float) -> Frame:
        taken = super().next_frame(timeout_s)
        level = min(round(64 + self.dn_per_us * self.settings.exposure_us), 4095)
        return replace(taken, image_dn=np.full((4, 6), level, np.uint16))


def test_the_exposure_is_found_once_for_each_target_and_then_locked(path: Path) -> None:
    plan = plan_of(
        auto_exposure=True,
        targets=[
            {"kind": "edge", "target": "Kante", "orientations_deg": [5.0, 95.0]},
            {"kind": "texture", "target": "coins"},
            {"kind": "dark", "target": "cap"},
            {"kind": "flat", "target": "paper", "exposure_us": 700.0},
        ],
    )
    camera = LinearCamera()

    def place(entry: PlanEntry) -> Placement:
        camera.dn_per_us = 0.25 if entry.kind == "texture" else 0.5
        if entry.kind == "dark":
            raise KeyboardInterrupt
        return "ready"

    with pytest.raises(KeyboardInterrupt):
        run(path, plan=plan, camera=camera, place=place)
    found = [r.exposure_us for r in Session(path).records]
    # 70 % of 4031 DN at 0.5 DN/us; the texture needs twice that, cut down to 10 ms of mains.
    assert found == pytest.approx([5643.4] * 4 + [10000.0] * 2, rel=0.1)
    assert len(set(found)) == 2
    run(path, plan=plan, camera=LinearCamera(), prefix="b")
    again = [r.exposure_us for r in Session(path).records]
    assert again == [*found, 2000.0, 2000.0, 700.0, 700.0]


def test_a_run_that_resumes_keeps_the_exposure_that_was_found(path: Path) -> None:
    plan = plan_of(auto_exposure=True, targets=[{"kind": "edge", "target": "Kante"}])

    def interrupt(height_mm: float) -> None:
        if height_mm == 110.0:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(path, plan=plan, camera=LinearCamera(), stage=ScriptedStage(on_move=interrupt))
    darker = LinearCamera()
    darker.dn_per_us = 0.3
    run(path, plan=plan, camera=darker, prefix="b")
    first, second = Session(path).records
    assert first.exposure_us == second.exposure_us


def test_drift_over_an_orientation_is_measured_where_the_plan_asks(path: Path) -> None:
    script = (frame(1000 if i <= 8 else 1100, i) for i in range(1, 100))
    plan = plan_of(drift_check=True, targets=[{"kind": "edge", "target": "Kante"}])
    remarks: list[str] = []
    run(
        path,
        plan=plan,
        camera=ScriptedCamera(script),
        progress=lambda p: remarks.extend(p.remarks),
    )
    assert [r.height_asked_mm for r in Session(path).records] == [100.0, 110.0, 100.0]
    [remark] = remarks
    assert "+10.68 %" in remark  # 1036 DN above black after 936
    assert kinds(path)[-1] == "note"
