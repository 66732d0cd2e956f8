"""When a run that is resumed asks for its target, and with which exposure and gain it goes on."""

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from acquisition.capture import CaptureProgress, Placement
from acquisition.errors import DeviceError, DeviceTimeoutError, SessionError
from acquisition.plan import PlanEntry
from acquisition.session import MANIFEST_NAME, Session
from standoff.console.bench_hub import BenchHub
from standoff.console.session_run import PlacementMemory, session_bench
from tests.acquisition.fakes import ScriptedCamera
from tests.acquisition.session_fixtures import bench_of, whole_session
from tests.standoff.console.hub_fixtures import wait_for
from tests.standoff.console.test_bench_hub import Operator, run_state


def begun_with(path: Path, **camera: object) -> None:
    whole_session(path)
    document = json.loads((path / MANIFEST_NAME).read_text())
    document["bench"]["camera"] |= camera
    (path / MANIFEST_NAME).write_text(json.dumps(document))


def test_a_new_session_runs_with_what_the_camera_has_now(tmp_path: Path) -> None:
    camera = ScriptedCamera()
    bench = session_bench(tmp_path / "new", bench_of(exposure_us=77.0), camera)
    assert bench.camera.exposure_us == camera.settings.exposure_us != 77.0
    assert bench.camera.gain_db == camera.settings.gain_db


def test_a_begun_session_goes_on_with_its_own(tmp_path: Path) -> None:
    begun_with(tmp_path, exposure_us=1234.0, gain_db=3.0)
    bench = session_bench(tmp_path, bench_of(exposure_us=77.0), ScriptedCamera())
    assert (bench.camera.exposure_us, bench.camera.gain_db) == (1234.0, 3.0)


@pytest.mark.parametrize("odd", [[], {}, None, "long", -1.0])
@pytest.mark.parametrize("key", ["exposure_us", "gain_db"])
def test_a_begun_session_without_numbers_is_damaged(tmp_path: Path, key: str, odd: object) -> None:
    begun_with(tmp_path, **{key: odd})
    with pytest.raises(SessionError, match=f"session.json: bench.camera.{key}: .*restore it"):
        session_bench(tmp_path, bench_of(), ScriptedCamera())


def entry(target: str, orientation_deg: float = 0.0) -> PlanEntry:
    return PlanEntry(
        index=0, kind="edge", target=target, orientation_deg=orientation_deg, height_mm=300.0
    )


class Asked:
    """Answers every question, and keeps them."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        self.answer: Placement = "ready"
        self.memory = PlacementMemory(self._ask("place"), self._ask("still"))

    def _ask(self, what: str) -> Callable[[PlanEntry], Placement]:
        def ask(each: PlanEntry) -> Placement:
            self.asked.append(f"{what} {each.target} {each.orientation_deg:g}")
            return self.answer

        return ask


def test_what_was_placed_is_not_asked_for_again_until_somebody_doubts_it(tmp_path: Path) -> None:
    asked = Asked()
    memory = asked.memory
    memory.begin(tmp_path / "new")
    memory.place(entry("a"))
    memory.begin(tmp_path / "new")  # resumed after a loss
    assert memory.place(entry("a")) == ("ready", False)
    memory.place(entry("a", 90.0))
    memory.doubt()
    memory.place(entry("a", 90.0))
    memory.forget()
    memory.place(entry("a", 90.0))
    assert asked.asked == ["place a 0", "place a 90", "still a 90", "place a 90"]


def test_a_target_that_was_skipped_is_not_in_place(tmp_path: Path) -> None:
    asked = Asked()
    asked.memory.begin(tmp_path / "new")
    asked.answer = "skip"
    assert asked.memory.place(entry("a")) == ("skip", True)
    asked.memory.place(entry("a"))
    assert asked.asked == ["place a 0", "place a 0"]


def test_after_a_restart_the_last_capture_says_what_may_be_in_place(session_dir: Path) -> None:
    asked = Asked()
    asked.memory.begin(session_dir)  # its last capture is of the edge at 95 degrees
    asked.memory.place(entry("edge", 5.0))
    asked.memory.forget()
    asked.memory.begin(session_dir.parent / "another")
    asked.memory.begin(session_dir)
    asked.memory.place(entry("edge", 95.0))
    assert asked.memory.place(entry("edge", 95.0)) == ("ready", False)
    assert asked.asked == ["place edge 5", "still edge 95"]


def paused(hub: BenchHub) -> Operator:
    """Pause a session before its first capture, with its target in place."""
    operator = Operator(hub)
    operator.say(do="run", plan="two", session="first")
    operator.say(do="pause")
    operator.answer("ready")
    wait_for(lambda: run_state(hub) == "paused", "paused")
    return operator


def lose_the_camera_once(hub: BenchHub, monkeypatch: pytest.MonkeyPatch) -> None:
    """Fail the second capture, as a camera that is gone does."""
    run, captured = hub.run, hub.run._captured
    lost: list[DeviceError] = []

    def fail_after_the_first(progress: CaptureProgress) -> None:
        captured(progress)
        if not lost:
            lost.append(DeviceTimeoutError("the camera is gone"))
            raise lost[0]

    monkeypatch.setattr(run, "_captured", fail_after_the_first)


@pytest.mark.slow
def test_a_session_that_lost_its_camera_is_resumed_without_a_question(
    hub: BenchHub, monkeypatch: pytest.MonkeyPatch
) -> None:
    lose_the_camera_once(hub, monkeypatch)
    operator = Operator(hub)
    operator.say(do="run", plan="two", session="first")
    operator.answer("ready")
    operator.wait_idle()
    assert run_state(hub) == "failed"
    operator.say(do="resume", session="first")
    wait_for(lambda: hub.run.view.placed != "", "told what is in place")
    assert hub.run.view.placed == "Edge 'edge' at 5 degrees"
    operator.wait_idle()
    assert run_state(hub) == "finished"
    assert Session(hub.sessions.folder / "first").is_complete


@pytest.mark.slow
def test_a_target_that_was_moved_is_asked_for_again(
    hub: BenchHub, monkeypatch: pytest.MonkeyPatch
) -> None:
    lose_the_camera_once(hub, monkeypatch)
    operator = Operator(hub)
    operator.say(do="run", plan="two", session="first")
    operator.answer("ready")
    operator.wait_idle()
    operator.say(do="target-moved")
    operator.say(do="resume", session="first")
    wait_for(lambda: hub.prompts.current is not None, "a question")
    prompt = hub.prompts.current
    assert prompt is not None
    assert prompt.text == "Place edge 'edge' at 5 degrees."
    operator.answer("ready")
    operator.wait_idle()
    assert run_state(hub) == "finished"


@pytest.mark.slow
def test_in_a_pause_a_moved_target_is_asked_for_before_the_next_capture(hub: BenchHub) -> None:
    operator = paused(hub)
    operator.say(do="target-moved")
    operator.answer("ready")  # asked at once
    operator.say(do="go-on")
    operator.wait_idle()
    assert run_state(hub) == "finished"
    assert Session(hub.sessions.folder / "first").is_complete


@pytest.mark.slow
def test_after_a_stop_one_key_says_that_it_is_still_in_place(hub: BenchHub) -> None:
    operator = paused(hub)
    operator.say(do="stop")
    operator.wait_idle()
    operator.say(do="go-on")
    operator.say(do="resume", session="first")
    wait_for(lambda: hub.prompts.current is not None, "a question")
    prompt = hub.prompts.current
    assert prompt is not None
    assert prompt.text.startswith("Edge 'edge' at 5 degrees: still in place?")
    operator.answer("ready")
    operator.wait_idle()
    assert run_state(hub) == "finished"
