"""What becomes of a STOP, by what the stage is seen to do afterwards."""

import time

import pytest

from acquisition.errors import DeviceError, DeviceTimeoutError
from standoff.console.devices import DeviceStatus, StageService, StageView
from standoff.console.jobs import StageStop, StopView, stage_stop
from tests.standoff.console.hub_fixtures import wait_for


class WatchedStage(StageService):
    """A stage that is told to stop, and of which a test says what is read."""

    def __init__(self, fault: DeviceError | None = None) -> None:
        super().__init__(lambda _: pytest.fail("not opened"), limits_mm=(0.0, 400.0))
        self.fault = fault
        self.told = 0
        self.seen = StageView(status=DeviceStatus(state="ready"), state="moving", read_s=0.0)

    @property
    def view(self) -> StageView:
        return self.seen

    def stop(self) -> None:
        self.told += 1
        if self.fault is not None:
            raise self.fault

    def read(self, state: str, status: str = "ready") -> None:
        self.seen = StageView(
            status=DeviceStatus(state=status),  # type: ignore[arg-type]  # of a parameter
            state=state,  # type: ignore[arg-type]
            read_s=time.monotonic(),
        )


def outcome(stop: StageStop) -> str:
    """What became of the stop, asked anew."""
    return stop.view.outcome


def ordered(stage: WatchedStage) -> StageStop:
    stop = StageStop(stage, lambda _: None)
    assert stop.view == StopView(number=0, outcome="none")
    before = stage.told
    assert stop.order(None) == 1
    wait_for(lambda: stage.told > before, "told")
    return stop


@pytest.mark.parametrize("state", ["idle", "alarm", "hold", "door"])
def test_it_has_succeeded_once_the_stage_is_read_at_rest_afterwards(state: str) -> None:
    stage = WatchedStage()
    stage.read("idle")  # before: says nothing
    stop = ordered(stage)
    assert outcome(stop) == "waiting"
    stage.read("moving")
    assert outcome(stop) == "waiting"
    stage.read(state)
    assert outcome(stop) == "stopped"


def test_a_stage_that_cannot_be_told_is_a_fault_until_it_is_seen_at_rest() -> None:
    stage = WatchedStage(DeviceTimeoutError("no answer to the stop"))
    stop = ordered(stage)
    wait_for(lambda: outcome(stop) == "failed", "failed")
    assert stop.view.fault == "no answer to the stop"
    stage.read("unknown", status="lost")
    assert outcome(stop) == "failed"
    stage.read("idle")
    assert outcome(stop) == "stopped"


@pytest.mark.parametrize(
    ("state", "status"), [("moving", "ready"), ("homing", "ready"), ("unknown", "lost")]
)
def test_a_stage_that_was_told_and_is_not_seen_at_rest_in_time_is_a_fault(
    state: str, status: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    stage = WatchedStage()
    stop = ordered(stage)
    stage.read(state, status)
    assert outcome(stop) == "waiting"
    monkeypatch.setattr(stage_stop, "AT_REST_WITHIN_S", 0.0)
    assert outcome(stop) == "failed"
    assert "not seen at rest" in stop.view.fault


def test_the_next_stop_begins_anew() -> None:
    stage = WatchedStage(DeviceTimeoutError("no answer to the stop"))
    stop = ordered(stage)
    wait_for(lambda: outcome(stop) == "failed", "failed")
    stage.fault = None
    assert stop.order(None) == 2
    assert stop.view == StopView(number=2, outcome="waiting")
