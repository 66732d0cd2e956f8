"""Exposures that one waits for: on the clock, and by the thread that owns the camera."""

import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from acquisition.errors import OperatorStopError
from hil_mocks.devices import CameraFaults
from standoff.console.camera_service import ExposureClock
from standoff.errors import ApplicationError
from tests.acquisition.fakes import FakeClock
from tests.standoff.console.hub_fixtures import SimulatedHub, wait_for
from tests.standoff.console.test_bench_hub import Operator

LONG_US = 60e6


class Bench(SimulatedHub):
    """A hub, the simulated bench behind it, and its operator."""

    def __init__(self, folder: Path) -> None:
        super().__init__(folder)
        self.operator = Operator(self.hub)

    @property
    def exposure_us(self) -> float:
        settings = self.hub.camera.settings
        assert settings is not None
        return settings.exposure_us

    def expose_long(self) -> None:
        self.operator.say(do="exposure", exposure_us=LONG_US, is_long_wanted=True)
        wait_for(lambda: self.exposure_us == LONG_US, "a long exposure")
        wait_for(lambda: self.hub.camera.exposing is not None, "exposing")

    def pull_cable(self) -> None:
        self.bench.camera.faults = CameraFaults(disconnect_at=0)

    def wait_for_pictures(self) -> None:
        before = self.hub.frames.counts.complete
        wait_for(lambda: self.hub.frames.counts.complete > before, "pictures")


@pytest.fixture
def bench(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Bench]:
    monkeypatch.setattr("standoff.console.camera_service.RETRY_S", 0.01)
    made = Bench(tmp_path)
    made.hub.start()
    try:
        wait_for(lambda: made.hub.frames.latest is not None, "a picture")
        yield made
    finally:
        made.hub.close()


def test_only_an_exposure_above_two_seconds_is_counted_down() -> None:
    now = FakeClock()
    clock = ExposureClock(now)
    clock.began(2e6)
    assert clock.view is None
    assert not clock.break_off()
    clock.began(10e6)
    now.now_s += 4.0
    view = clock.view
    assert view is not None
    assert (view.seconds, view.left_s, view.is_dropped) == (10.0, 6.0, False)
    now.now_s += 7.0
    assert clock.view is not None
    assert clock.view.left_s == 0.0
    assert clock.shorter_us == 2e6
    clock.ended()
    assert clock.view is None


def test_the_frame_of_an_exposure_broken_off_is_dropped_and_no_other() -> None:
    now = FakeClock()
    clock = ExposureClock(now)
    clock.began(10e6)
    now.now_s += 4.0
    assert clock.break_off()
    clock.began(9000.0)
    view = clock.view
    assert view is not None
    # A camera that cannot abort is still busy for the six seconds that were left.
    assert (view.left_s, view.is_dropped) == (6.0, True)
    assert clock.is_broken_off
    now.now_s += 6.0
    assert clock.view is None
    assert clock.is_dropped()
    assert not clock.is_dropped()
    assert not clock.is_broken_off


def test_a_long_exposure_after_another_loses_no_frame_of_its_own() -> None:
    now = FakeClock()
    clock = ExposureClock(now)
    clock.began(60e6)
    assert clock.break_off()
    clock.began(5e6)
    view = clock.view
    assert view is not None
    assert (view.seconds, view.is_dropped) == (5.0, False)
    now.now_s += 5.0
    assert not clock.is_dropped()


def test_a_long_exposure_that_nobody_asked_for_is_refused(bench: Bench) -> None:
    before = bench.exposure_us
    with pytest.raises(ApplicationError) as refused:
        bench.operator.say(do="exposure", exposure_us=LONG_US)
    assert "60 s" in str(refused.value)
    bench.operator.say(do="exposure", exposure_us=2e6)
    wait_for(lambda: bench.exposure_us == 2e6, "two seconds, unasked")
    assert before != 2e6


@pytest.mark.slow
def test_a_long_exposure_is_broken_off_at_once_and_the_one_before_is_back(bench: Bench) -> None:
    before = bench.exposure_us
    bench.expose_long()
    began_s = time.monotonic()
    bench.operator.say(do="break-off")
    wait_for(lambda: bench.exposure_us == before, "the exposure of before")
    bench.wait_for_pictures()
    assert time.monotonic() - began_s < 20.0  # far from 60, whatever else the computer does
    assert bench.hub.camera.exposing is None
    latest = bench.hub.frames.latest
    assert latest is not None
    assert latest.settings.exposure_us == before


@pytest.mark.slow
@pytest.mark.parametrize("job", ["auto-exposure", "snapshot", "sweep-focus", "run"])
def test_a_stop_never_waits_for_a_frame_and_leaves_the_camera_open(bench: Bench, job: str) -> None:
    words: dict[str, dict[str, object]] = {
        "auto-exposure": {},
        "snapshot": {"frames": 10},
        "sweep-focus": {"low_mm": 300.0, "high_mm": 310.0, "steps": 7},
        "run": {"plan": "two", "session": "first"},
    }
    bench.expose_long()
    camera = bench.bench.camera
    bench.operator.say(do=job, **words[job])
    time.sleep(0.3)  # in which it takes its turn and waits for its first frame
    assert bench.hub.jobs.current is not None
    began_s = time.monotonic()
    bench.operator.say(do="stop")
    bench.operator.wait_idle()
    assert time.monotonic() - began_s < 20.0
    bench.operator.say(do="break-off")
    bench.wait_for_pictures()
    assert bench.bench.camera is camera  # it was never lost
    assert camera.is_open


def test_who_is_stopped_before_his_turn_does_not_stop_the_live_picture(bench: Bench) -> None:
    service = bench.hub.camera
    stops: list[bool] = []

    def check() -> None:
        if stops:
            raise OperatorStopError("stopped by the operator")

    with service.lent(check) as lent:
        stops.append(True)
        with pytest.raises(OperatorStopError):
            lent.start()
        lent.stop()  # as whoever averages frames does after any failure
        bench.wait_for_pictures()
    assert service.status.is_ready


@pytest.mark.slow
def test_a_simulated_camera_that_was_lost_comes_back(bench: Bench) -> None:
    bench.operator.say(do="exposure", exposure_us=4000.0)
    wait_for(lambda: bench.exposure_us == 4000.0, "exposure")
    lost = bench.bench.camera
    bench.pull_cable()
    wait_for(lambda: bench.bench.camera is not lost, "opened again")
    wait_for(lambda: bench.hub.camera.status.is_ready, "ready")
    bench.wait_for_pictures()
    assert not lost.is_open
    assert bench.exposure_us == 4000.0


@pytest.mark.slow
def test_a_session_a_sweep_and_a_snapshot_go_on_when_the_camera_is_back(bench: Bench) -> None:
    hub, operator = bench.hub, bench.operator
    operator.say(do="snapshot", frames=10)
    bench.pull_cable()
    operator.wait_idle()
    assert hub.snapshots.latest

    operator.say(do="home")
    operator.wait_idle()
    operator.say(do="sweep-focus", low_mm=300.0, high_mm=360.0, steps=7)
    wait_for(lambda: hub.sweep.view.taken >= 2, "two heights")
    bench.pull_cable()
    operator.wait_idle()
    assert hub.sweep.view.taken == 7

    operator.say(do="run", plan="two", session="first")
    operator.answer("ready")
    wait_for(lambda: hub.run.view.captured == 1, "a capture")
    bench.pull_cable()
    operator.wait_idle()
    assert (hub.run.view.state, hub.run.view.captured) == ("finished", 2)
