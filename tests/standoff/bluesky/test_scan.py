"""A RunEngine scans heights of the simulated bench; the result is one of our sessions."""

import math
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

import standoff
from acquisition.errors import DeviceDisconnectedError, PlanError, SessionError, StageLimitError
from acquisition.plan import CapturePlan
from acquisition.session import verify
from hil_mocks import SimulatedBench
from hil_mocks.devices import CameraFaults
from standoff.bluesky import HeightStage, SessionCamera, WorkStatus, height_scan
from standoff.errors import ApplicationError
from standoff.library import height_series
from tests.hil_mocks.benches import bench_config

HEIGHTS_MM = [150.0, 200.0, 300.0]
COINS = {"kind": "texture", "target": "coins"}


def plan_of(heights_mm: list[float], **keys: object) -> CapturePlan:
    return height_series("scan", heights_mm, COINS, frames_per_capture=4, **keys)


@pytest.fixture
def bench() -> Iterator[standoff.Bench]:
    with standoff.Bench(bench_config(), operator="Zoë") as opened:
        opened.home()
        yield opened


def simulated(bench: standoff.Bench) -> SimulatedBench:
    found = bench._open().simulated
    assert found is not None
    return found


@pytest.fixture
def engine() -> Any:
    """A RunEngine, with the events it has emitted under ``events``."""
    run_engine = pytest.importorskip("bluesky.run_engine", reason="needs standoff[bluesky]")
    found = run_engine.RunEngine(context_managers=[])
    found.documents = []
    found.subscribe(lambda name, document: found.documents.append((name, document)))
    return found


def events(engine: Any) -> list[dict[str, Any]]:
    return [document["data"] for name, document in engine.documents if name == "event"]


def test_the_devices_satisfy_the_protocols(bench: standoff.Bench, tmp_path: Path) -> None:
    protocols = pytest.importorskip("bluesky.protocols", reason="needs standoff[bluesky]")
    stage = HeightStage(bench)
    camera = SessionCamera(bench, plan_of(HEIGHTS_MM), tmp_path / "session")
    for name in ("Movable", "Stoppable", "Locatable", "Readable", "Configurable", "HasHints"):
        assert isinstance(stage, getattr(protocols, name)), name
    for name in ("Stageable", "Triggerable", "Readable", "Configurable", "HasHints"):
        assert isinstance(camera, getattr(protocols, name)), name
    status = WorkStatus(lambda: None, "nothing")
    assert status.exception(timeout=10) is None
    assert isinstance(status, protocols.Status)


@pytest.mark.slow
def test_a_scan_of_heights_writes_a_session(
    bench: standoff.Bench, engine: Any, tmp_path: Path
) -> None:
    out = tmp_path / "session"
    camera = SessionCamera(bench, plan_of(HEIGHTS_MM), out)
    engine(height_scan(HeightStage(bench), camera))
    session = standoff.Session(out)
    assert verify(out).is_ok
    assert session.is_complete
    assert session.manifest.operator == "Zoë"
    seen = events(engine)
    assert [event["camera_sha256"] for event in seen] == [r.sha256 for r in session.records]
    assert [event["camera_height_mm"] for event in seen] == [r.height_mm for r in session.records]
    assert [event["stage_setpoint_mm"] for event in seen] == HEIGHTS_MM
    for event, record in zip(seen, session.records, strict=True):
        images = session.load(record)
        assert event["camera_mean_dn"] == pytest.approx(float(images.mean_dn.mean()), rel=1e-5)
        assert record.frames_used == 4
    start = next(document for name, document in engine.documents if name == "start")
    assert start["num_points"] == 3


@pytest.mark.slow
def test_a_plan_of_blueskys_own_may_visit_the_heights_in_any_order(
    bench: standoff.Bench, engine: Any, tmp_path: Path
) -> None:
    plans = pytest.importorskip("bluesky.plans")
    out = tmp_path / "session"
    camera = SessionCamera(bench, plan_of(HEIGHTS_MM), out)
    engine(plans.list_scan([camera], HeightStage(bench), [300.0, 150.0, 200.0]))
    assert [event["camera_index"] for event in events(engine)] == [2, 0, 1]
    assert standoff.Session(out).is_complete


def test_a_scan_whose_camera_is_lost_is_resumed_by_the_same_scan(
    bench: standoff.Bench, engine: Any, tmp_path: Path
) -> None:
    utils = pytest.importorskip("bluesky.utils")
    out = tmp_path / "session"
    camera = SessionCamera(bench, plan_of(HEIGHTS_MM), out)

    def unplug(name: str, _: object) -> None:
        simulated(bench).camera.faults = CameraFaults(disconnect_at=1 if name == "event" else None)

    with pytest.raises(utils.FailedStatus) as failed:
        engine(height_scan(HeightStage(bench), camera), unplug)
    assert isinstance(failed.value.__cause__, DeviceDisconnectedError)
    session = standoff.Session(out)
    assert len(session.records) == 1
    assert [event.kind for event in session.events if event.kind == "error"] == ["error"]
    bench.close()
    bench.open().home()
    engine(height_scan(HeightStage(bench), SessionCamera(bench, plan_of(HEIGHTS_MM), out)))
    assert standoff.Session(out).is_complete
    assert verify(out).is_ok
    assert len(events(engine)) == 3


def test_a_height_beyond_the_travel_is_refused_before_the_scan(
    bench: standoff.Bench, engine: Any, tmp_path: Path
) -> None:
    camera = SessionCamera(bench, plan_of([150.0, 500.0]), tmp_path / "session")
    with pytest.raises(StageLimitError):
        engine(height_scan(HeightStage(bench), camera))
    assert not (tmp_path / "session").exists()


def test_a_trigger_that_is_repeated_before_its_event_takes_no_other_capture(
    bench: standoff.Bench, tmp_path: Path
) -> None:
    camera = SessionCamera(bench, plan_of([150.0], repeats=2), tmp_path / "session")
    bench.move(150.0)
    camera.stage()
    for _ in range(2):  # as by a RunEngine that was paused in between
        assert camera.trigger().exception(timeout=60) is None
    assert camera.read()["camera_index"]["value"] == 0
    assert camera.trigger().exception(timeout=60) is None
    assert camera.read()["camera_index"]["value"] == 1
    assert isinstance(camera.trigger().exception(timeout=60), PlanError)  # none is left
    camera.unstage()
    camera.unstage()
    assert len(standoff.Session(tmp_path / "session").records) == 2


def test_a_height_that_the_plan_lacks_is_refused(bench: standoff.Bench, tmp_path: Path) -> None:
    camera = SessionCamera(bench, plan_of([150.0]), tmp_path / "session")
    bench.move(160.0)
    assert isinstance(camera.trigger().exception(timeout=60), SessionError)  # not staged
    camera.stage()
    with pytest.raises(SessionError):
        camera.stage()
    assert isinstance(camera.trigger().exception(timeout=60), PlanError)
    camera.unstage()


def test_flats_have_no_focus(bench: standoff.Bench, tmp_path: Path) -> None:
    plan = height_series("flat", [150.0], {"kind": "flat", "target": "flat"})
    camera = SessionCamera(bench, plan, tmp_path / "session")
    bench.move(150.0)
    camera.stage()
    assert camera.trigger().exception(timeout=60) is None
    camera.unstage()
    assert math.isnan(camera.read()["camera_focus_value"]["value"])


def test_a_plan_of_several_targets_is_not_a_scan(bench: standoff.Bench, tmp_path: Path) -> None:
    turned = {**COINS, "orientations_deg": [0.0, 90.0]}
    with pytest.raises(PlanError):
        SessionCamera(bench, height_series("two", [150.0], turned), tmp_path / "session")
    with pytest.raises(PlanError):
        SessionCamera(bench, plan_of([150.0], auto_exposure=True), tmp_path / "session")


def test_without_bluesky_the_scan_names_the_extra(
    bench: standoff.Bench, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "bluesky", None)
    camera = SessionCamera(bench, plan_of([150.0]), tmp_path / "session")
    with pytest.raises(ApplicationError) as refused:
        next(height_scan(HeightStage(bench), camera))
    assert "standoff[bluesky]" in str(refused.value)
