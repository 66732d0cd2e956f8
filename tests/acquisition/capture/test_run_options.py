"""What a run may do besides: quality checks, retakes, auto-exposure, drift, parking."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from acquisition.capture.quality import QualityFinding
from acquisition.capture.runner import Placement, Verdict
from acquisition.devices import Frame
from acquisition.errors import SessionError
from acquisition.plan import PlanEntry
from acquisition.session.reader import Session, verify
from tests.acquisition.capture.test_runner import ALL_HEIGHTS_MM, kinds, run
from tests.acquisition.fakes import ScriptedCamera, ScriptedStage, frame
from tests.acquisition.session_fixtures import bench_of, plan_of


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "session"


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
