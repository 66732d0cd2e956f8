"""What the holder of control asks for, beyond a session: gain, alarm, pose, lost devices, stops."""

import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from threading import Thread
from typing import Any, NoReturn

import numpy as np
import pytest

from acquisition.capture._runner import CaptureProgress
from acquisition.errors import DeviceDisconnectedError, DeviceError, DeviceTimeoutError
from acquisition.session._reader import Session
from analysis.pose._tracker import PoseVerdict
from hil_mocks import SimulatedBench
from hil_mocks.devices import StageFaults
from simulation.arrays import AnyArray
from standoff.console.bench_hub import BenchHub
from standoff.console.devices import bench_drivers
from standoff.console.jobs import BusyError, Job
from standoff.console.session_run import RunView
from standoff.console.web._view_model import pose_document
from standoff.errors import ApplicationError
from tests.standoff.console.hub_fixtures import (
    DEADLINE_S,
    PLAN,
    SimulatedHub,
    idle_hub,
    pose_verdict,
    running_hub,
    small_bench,
    wait_for,
)
from tests.standoff.console.test_bench_hub import Operator, run_state, states


@contextmanager
def faulty_hub(
    folder: Path, **drivers: Callable[..., Any]
) -> Iterator[tuple[BenchHub, SimulatedBench]]:
    """A hub with the simulated bench behind it, whose faults can be set; started."""
    simulated = SimulatedHub(folder, **drivers)
    simulated.hub.start()
    try:
        yield simulated.hub, simulated.bench
    finally:
        simulated.hub.close()


class SizeTracker:
    """Accepts every frame of its reference's size; stands for a tracker that needs texture."""

    is_searching = False

    def __init__(self, reference: AnyArray) -> None:
        self._reference = reference

    def update(self, image: AnyArray) -> PoseVerdict:
        if image.shape != self._reference.shape:
            raise ValueError(f"the frames changed from {self._reference.shape} to {image.shape}")
        return pose_verdict(reason="of its size")


def pose_hub(folder: Path) -> BenchHub:
    """A hub that may judge poses; its devices are not opened."""
    bench = small_bench()
    hub = BenchHub(bench, bench_drivers(bench), sessions=folder / "sessions")
    hub.pose.judge_by(SizeTracker)  # type: ignore[arg-type]  # it has all that is asked
    return hub


def test_the_gain_is_set_for_the_live_picture(hub: BenchHub) -> None:
    Operator(hub).say(do="gain", gain_db=6.0)
    wait_for(lambda: getattr(hub.camera.settings, "gain_db", 0) == 6.0, "gain")


@pytest.mark.slow
def test_an_alarm_is_shown_and_cleared(hub: BenchHub) -> None:
    operator = Operator(hub)
    hub.stage.lent().emergency_stop()
    wait_for(lambda: hub.stage.view.state == "alarm", "alarm")
    operator.say(do="home")
    operator.wait_idle()
    assert "Homing the stage failed" in hub.notices[-1].text
    assert "emergency stop" in hub.notices[-1].text
    operator.say(do="unlock")
    operator.wait_idle()
    wait_for(lambda: hub.stage.view.state == "idle", "no alarm")
    operator.say(do="home")
    operator.wait_idle()
    wait_for(lambda: hub.stage.view.is_homed, "homed")


@pytest.mark.parametrize(
    ("name", "remedy"),
    [("camera", "power, cable and address"), ("stage", "the port in the bench")],
)
def test_without_a_device_no_session_begins_and_the_remedy_is_told(
    tmp_path: Path, name: str, remedy: str
) -> None:
    def absent(*_: object) -> NoReturn:
        raise DeviceDisconnectedError("nobody answers")

    with faulty_hub(tmp_path, **{f"open_{name}": absent}) as (hub, _):
        wait_for(lambda: getattr(hub, name).status.state == "lost", "lost")
        other = hub.stage if name == "camera" else hub.camera
        wait_for(lambda: other.status.is_ready, "the other device")
        with pytest.raises(DeviceDisconnectedError):
            Operator(hub).say(do="run", plan="two", session="first")
        assert getattr(hub, name).status.text == "nobody answers"
        assert remedy in getattr(hub, name).status.remedy
        assert run_state(hub) == "idle"
        assert not hub.sessions.folder.exists()


def test_a_second_session_waits_until_the_first_has_ended(hub: BenchHub) -> None:
    operator = Operator(hub)
    operator.say(do="run", plan="two", session="first")
    with pytest.raises(BusyError) as refused:
        operator.say(do="run", plan="two", session="second")
    assert refused.value.job == "session first"
    assert hub.run.view.session == "first"
    operator.answer("skip")
    operator.wait_idle()


def test_closing_the_console_stops_a_session_which_can_be_resumed(tmp_path: Path) -> None:
    with running_hub(tmp_path) as hub:
        operator = Operator(hub)
        operator.say(do="run", plan="two", session="first")
        wait_for(lambda: hub.prompts.current is not None, "a question")
    assert hub.jobs.current is None
    assert run_state(hub) == "stopped"
    assert Session(tmp_path / "sessions" / "first").events[-1].kind == "stop"


def test_a_stage_that_cannot_be_stopped_is_told_once(
    hub: BenchHub, monkeypatch: pytest.MonkeyPatch
) -> None:
    tries: list[int] = []

    def mute() -> None:
        tries.append(1)
        raise DeviceTimeoutError("the stage does not answer to a stop")

    monkeypatch.setattr("standoff.console.jobs.STOP_AGAIN_S", 0.01)
    monkeypatch.setattr(hub.stage, "stop", mute)

    def until_tried_again(job: Job) -> None:
        wait_for(lambda: len(tries) > 2, "tries")
        job.check()

    hub.jobs.begin("waiting", until_tried_again)
    hub.stop()
    wait_for(lambda: hub.jobs.current is None, "the job to end")
    told = [notice.text for notice in hub.notices]
    assert told.count("STOP: the stage does not answer to a stop") == 1
    assert "Stopped: waiting." in told


def test_a_stop_without_a_job_reaches_the_stage_once(
    hub: BenchHub, monkeypatch: pytest.MonkeyPatch
) -> None:
    def gone() -> None:
        raise DeviceError("nobody there")

    monkeypatch.setattr(hub.stage, "stop", gone)
    hub.stop()
    wait_for(lambda: bool(hub.notices), "a notice")
    assert [notice.text for notice in hub.notices] == ["STOP: nobody there"]


def test_a_question_of_no_job_waits_for_its_answer(tmp_path: Path) -> None:
    hub = idle_hub(tmp_path)
    answers: list[str] = []
    asking = Thread(target=lambda: answers.append(hub.prompts.ask("Height, in mm")))
    asking.start()
    Operator(hub).answer("ok", "251.5")
    asking.join(DEADLINE_S)
    assert answers == ["251.5"]


@pytest.mark.slow
def test_the_pose_is_judged_against_a_capture_of_a_session(hub: BenchHub, tmp_path: Path) -> None:
    operator = Operator(hub)
    operator.say(do="run", plan="two", session="first")
    operator.answer("ready")
    operator.wait_idle()
    other = pose_hub(tmp_path)
    viewer = Operator(other)
    assert other.frames.latest is None
    with pytest.raises(ApplicationError):
        viewer.say(do="pose-reference")
    viewer.say(do="pose-reference", session="first", index=1)
    assert other.pose.view.reference == "first, capture 1 at 301.0 mm"
    shown = pose_document(other.pose.view)
    assert (shown["verdict"], shown["reason"]) == ("…", "waiting for a picture")
    with pytest.raises(ApplicationError):
        viewer.say(do="pose-reference", session="first", index=7)
    viewer.say(do="pose-clear")
    assert other.pose.view.reference == ""


def test_the_pose_is_judged_no_more_when_the_frames_change_their_size(tmp_path: Path) -> None:
    hub = pose_hub(tmp_path)
    hub.start()
    try:
        wait_for(lambda: hub.frames.latest is not None, "a picture")
        Operator(hub).say(do="pose-reference")
        assert hub.pose.view.reference == "the picture taken just now"
        wait_for(lambda: hub.pose.view.verdict is not None, "a verdict")
        hub.pose.choose("a larger picture", np.zeros((480, 640), np.uint16))
        wait_for(lambda: hub.pose.view.reference == "", "given up")
        wait_for(lambda: bool(hub.notices), "a notice")
        assert hub.notices[-1].text == (
            "The pose is no longer judged: the frames changed from (480, 640) to (48, 64)"
        )
    finally:
        hub.close()


@pytest.mark.slow
def test_a_session_that_fails_names_the_capture_and_the_fault_and_is_resumed(
    tmp_path: Path,
) -> None:
    with faulty_hub(tmp_path) as (hub, bench):
        wait_for(lambda: hub.camera.status.is_ready and hub.stage.status.is_ready, "ready")
        operator = Operator(hub)
        bench.stage.faults = StageFaults(alarm="hard limit")
        operator.say(do="run", plan="two", session="first")
        operator.answer("ready")
        operator.wait_idle()
        assert run_state(hub) == "failed"
        assert "hard limit" in hub.run.view.message
        assert states(hub) == ["failed", "pending"]
        assert hub.run.view.rows[0].note == hub.run.view.message
        assert hub.notices[-1].text.startswith("Session first failed: the simulated stage")
        bench.stage.faults = StageFaults()
        operator.say(do="unlock")
        operator.wait_idle()
        # The target is where it was placed: nobody is asked again.
        operator.say(do="resume", session="first")
        operator.wait_idle()
        assert states(hub) == ["done", "done"]


@pytest.mark.slow
def test_a_paused_session_goes_on_where_it_was(
    hub: BenchHub, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen: list[str] = []
    captured = hub.run._captured

    def look(progress: CaptureProgress) -> None:
        seen.append(run_state(hub))
        captured(progress)

    monkeypatch.setattr(hub.run, "_captured", look)
    operator = Operator(hub)
    operator.say(do="run", plan="two", session="first")
    operator.say(do="pause")
    operator.answer("ready")
    wait_for(lambda: run_state(hub) == "paused", "paused")
    assert hub.run.is_pause_wanted
    operator.say(do="go-on")
    operator.wait_idle()
    assert seen == ["running", "running"]
    assert states(hub) == ["done", "done"]


@pytest.mark.slow
def test_after_a_session_with_exposures_of_its_own_the_live_picture_has_its_own_again(
    hub: BenchHub, tmp_path: Path
) -> None:
    (tmp_path / "ladder.toml").write_text(PLAN + "exposure_us = [2000.0, 4000.0]\n")
    operator = Operator(hub)
    operator.say(do="exposure", exposure_us=7000.0)
    operator.say(do="gain", gain_db=2.0)
    wait_for(lambda: getattr(hub.camera.settings, "gain_db", 0) == 2.0, "gain")
    operator.say(do="run", plan="ladder", session="first")
    operator.answer("ready")
    operator.wait_idle()
    session = Session(hub.sessions.folder / "first")
    assert {record.exposure_us for record in session.records} == {2000.0, 4000.0}
    wait_for(lambda: getattr(hub.camera.settings, "exposure_us", 0) == 7000.0, "exposure")
    # What a session began with is set again when it goes on, whatever was set meanwhile.
    operator.say(do="gain", gain_db=5.0)
    wait_for(lambda: getattr(hub.camera.settings, "gain_db", 0) == 5.0, "gain")
    operator.say(do="retake", session="first", index=0)
    operator.answer("ready")
    operator.wait_idle()
    assert run_state(hub) == "finished"
    retaken = Session(hub.sessions.folder / "first").records
    assert {record.gain_db for record in retaken} == {2.0}


@pytest.mark.slow
@pytest.mark.parametrize("has_failed", [False, True])
def test_after_a_session_that_broke_off_too_the_live_picture_has_its_exposure_again(
    tmp_path: Path, has_failed: bool
) -> None:
    with faulty_hub(tmp_path) as (hub, bench):
        (tmp_path / "ladder.toml").write_text(PLAN + "exposure_us = [2000.0, 4000.0]\n")
        wait_for(lambda: hub.camera.status.is_ready and hub.stage.status.is_ready, "ready")
        operator = Operator(hub)
        operator.say(do="exposure", exposure_us=7000.0)
        wait_for(lambda: getattr(hub.camera.settings, "exposure_us", 0) == 7000.0, "exposure")
        captured = hub.run._captured

        def break_off(progress: CaptureProgress) -> None:
            captured(progress)
            if has_failed:
                bench.stage.faults = StageFaults(alarm="hard limit")
            else:
                operator.say(do="stop")

        hub.run._captured = break_off  # type: ignore[method-assign]  # observed, then broken off
        operator.say(do="run", plan="ladder", session="first")
        operator.answer("ready")
        operator.wait_idle()
        assert run_state(hub) == ("failed" if has_failed else "stopped")
        [record, *_] = Session(hub.sessions.folder / "first").records
        assert record.exposure_us == 2000.0
        wait_for(lambda: getattr(hub.camera.settings, "exposure_us", 0) == 7000.0, "exposure")


@pytest.mark.slow
def test_a_capture_found_bad_is_taken_again_or_kept_as_the_operator_says(hub: BenchHub) -> None:
    operator = Operator(hub)
    # White paper gives 1.5 e- a microsecond; the ADC ends near 20 000.
    operator.say(do="exposure", exposure_us=40000.0)
    wait_for(lambda: getattr(hub.camera.settings, "exposure_us", 0) == 40000.0, "exposure")
    operator.say(do="run", plan="two", session="first")
    operator.answer("ready")
    for choice in ("retake", "keep", "keep"):
        wait_for(lambda: "saturated" in getattr(hub.prompts.current, "text", ""), "a review")
        asked = hub.prompts.current
        operator.answer(choice)
        wait_for(lambda asked=asked: hub.prompts.current is not asked, "taken")  # type: ignore[misc]  # bound at once
    operator.wait_idle()
    assert states(hub) == ["done", "done"]
    assert all("saturated" in row.note for row in hub.run.view.rows)
    assert [c.record.index for c in Session(hub.sessions.folder / "first").captures] == [
        0,
        0,
        1,
    ]


def test_a_job_that_breaks_off_unforeseen_is_told_and_frees_the_bench(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    hub = idle_hub(tmp_path)
    shown: list[str] = []
    monkeypatch.setattr(threading, "excepthook", lambda said: shown.append(str(said.exc_value)))

    def broken(_: Job) -> None:
        raise ZeroDivisionError("unforeseen")

    hub.jobs.begin("measuring", broken)
    wait_for(lambda: bool(shown), "the terminal")
    assert hub.jobs.current is None
    assert [notice.text for notice in hub.notices] == ["Measuring crashed; see the terminal."]
    assert shown == ["unforeseen"]
    assert hub.run.view == RunView()
