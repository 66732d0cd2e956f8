"""Who is in control, and what becomes of a STOP."""

import time

import pytest
from hypothesis import given, strategies as st

from acquisition.errors import DeviceError, DeviceTimeoutError
from standoff.console import jobs as stage_stop
from standoff.console.control_arbiter import AWAY_S, UNANSWERED_S, ControlArbiter
from standoff.console.devices import DeviceStatus
from standoff.console.jobs import StageStop, StopView
from standoff.console.server import PING_S, PONG_S
from standoff.console.stage_service import StageService, StageView
from tests.acquisition.fakes import FakeClock
from tests.standoff.console.hub_fixtures import wait_for


def two_pages() -> tuple[ControlArbiter, FakeClock]:
    """Ada in control, Ben watching."""
    clock = FakeClock()
    clock.now_s = 0.0
    arbiter = ControlArbiter(clock=clock)
    arbiter.join("one", "Ada")
    arbiter.join("two", "Ben")
    return arbiter, clock


def test_the_first_page_is_in_control_and_the_second_watches() -> None:
    arbiter, _ = two_pages()
    assert arbiter.is_holder("one")
    assert not arbiter.is_holder("two")
    assert arbiter.view("two").holder == "Ada"
    assert arbiter.view("two").viewers == 2


def test_control_is_asked_for_and_granted() -> None:
    arbiter, _ = two_pages()
    assert not arbiter.take("two")
    assert arbiter.is_holder("one")
    assert arbiter.view("one").asked_by == "Ben"
    assert arbiter.view("two").is_asking
    arbiter.grant("two")  # is not for him to say
    assert arbiter.is_holder("one")
    arbiter.grant("one")
    assert arbiter.is_holder("two")
    assert arbiter.operator() == "Ben"
    assert arbiter.view("two").asked_by == ""


def test_control_that_is_refused_stays_and_may_be_asked_for_again() -> None:
    arbiter, _ = two_pages()
    arbiter.take("two")
    arbiter.refuse("one")
    assert arbiter.is_holder("one")
    assert not arbiter.view("two").is_asking
    arbiter.take("two")
    arbiter.refuse("two")  # changed his mind
    assert arbiter.view("one").asked_by == ""


def test_a_request_that_nobody_answers_may_be_taken_as_granted() -> None:
    arbiter, clock = two_pages()
    arbiter.take("two")
    clock.now_s = UNANSWERED_S - 0.1
    assert not arbiter.view("two").may_take
    assert not arbiter.take("two")
    clock.now_s = UNANSWERED_S
    assert arbiter.view("two").may_take
    assert arbiter.take("two")


def test_a_page_that_is_not_there_gets_nothing() -> None:
    arbiter = ControlArbiter()
    arbiter.join("one", "Ada")
    assert not arbiter.take("two")
    assert arbiter.is_holder("one")


def test_a_page_that_comes_back_at_once_keeps_its_control() -> None:
    arbiter, clock = two_pages()
    arbiter.leave("one")
    assert arbiter.view("two").is_away
    clock.now_s = AWAY_S - 0.1
    assert not arbiter.take("two")
    arbiter.join("one", "Ada")
    assert arbiter.view("one").is_mine


def test_a_dead_page_is_free_after_ten_seconds() -> None:
    assert PING_S + PONG_S + AWAY_S <= 10
    arbiter, clock = two_pages()
    arbiter.leave("one")
    clock.now_s = AWAY_S
    assert arbiter.view("two").holder == ""
    assert arbiter.operator() == ""
    assert arbiter.take("two")


def test_control_of_a_dead_page_goes_to_who_asked_for_it() -> None:
    arbiter, clock = two_pages()
    arbiter.take("two")
    arbiter.leave("one")
    clock.now_s = AWAY_S
    assert arbiter.view("two").is_mine


def test_who_gives_control_away_leaves_it_to_who_asks_or_to_the_next() -> None:
    arbiter, _ = two_pages()
    arbiter.release("two")
    assert arbiter.is_holder("one")
    arbiter.release("one")
    assert arbiter.view("one").holder == ""
    arbiter.join("three", "Cy")
    assert arbiter.is_holder("three")
    arbiter.take("two")
    arbiter.release("three")
    assert arbiter.is_holder("two")


ACTS = st.tuples(
    st.sampled_from(["join", "leave", "take", "grant", "refuse", "release", "wait"]),
    st.sampled_from(["one", "two", "three"]),
)


@given(st.lists(ACTS, max_size=40))
def test_at_most_one_page_is_in_control_and_nobody_takes_it_from_who_is_there(
    acts: list[tuple[str, str]],
) -> None:
    clock = FakeClock()
    clock.now_s = 0.0
    arbiter = ControlArbiter(clock=clock)
    present: set[str] = set()
    for act, viewer in acts:
        before = next((page for page in present if arbiter.is_holder(page)), None)
        if act == "wait":
            clock.now_s += 2.0  # never as long as a request must wait for its answer
        elif act == "join":
            arbiter.join(viewer, viewer)
            present.add(viewer)
        elif act == "leave":
            arbiter.leave(viewer)
            present.discard(viewer)
        elif act in ("grant", "refuse", "release") or viewer in present:
            getattr(arbiter, act)(viewer)
        views = {page: arbiter.view(page) for page in present}
        mine = [page for page, view in views.items() if view.is_mine]
        assert len(mine) <= 1
        unasked = clock.now_s < UNANSWERED_S and act not in ("grant", "release", "leave")
        if before is not None and unasked:
            assert mine == [before]


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
