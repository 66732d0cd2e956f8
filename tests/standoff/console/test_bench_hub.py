"""The bench behind the pages: sessions, stops, prompts, focus; over the simulated bench."""

import json
import shutil
from pathlib import Path

import pytest

from acquisition.capture._runner import CaptureProgress
from acquisition.errors import StageLimitError
from acquisition.session._reader import Session, verify
from standoff.console.bench_hub import BenchHub
from standoff.console.jobs import BusyError
from standoff.console.web._command_handler import CommandHandler, parse_message
from standoff.console.web._session_commands import NotInControlError
from standoff.console.web._view_model import plan_document, state_document
from standoff.errors import ApplicationError
from tests.standoff.console.hub_fixtures import PLAN, running_hub, wait_for


class Operator:
    """One page that talks to the hub."""

    def __init__(self, hub: BenchHub, name: str = "Ada") -> None:
        self.hub = hub
        self._handler = CommandHandler(hub)
        self._name = name
        hub.control.join(name, name)

    def say(self, **fields: object) -> dict[str, object] | None:
        return self._handler.carry_out(self._name, parse_message(json.dumps(fields)))

    def wait_idle(self) -> None:
        wait_for(lambda: self.hub.jobs.current is None, "the job to end")

    def answer(self, choice: str, text: str = "") -> None:
        wait_for(lambda: self.hub.prompts.current is not None, "a question")
        prompt = self.hub.prompts.current
        assert prompt is not None
        self.say(do="answer", number=prompt.number, choice=choice, text=text)


@pytest.fixture
def operator(hub: BenchHub) -> Operator:
    return Operator(hub)


def run_state(hub: BenchHub) -> str:
    return hub.run.view.state


def states(hub: BenchHub) -> list[str]:
    return [row["state"] for row in plan_document(hub.run.view)["rows"]]


@pytest.mark.slow
def test_a_plan_is_run_as_a_session_with_the_exposure_of_the_live_picture(
    hub: BenchHub, operator: Operator
) -> None:
    operator.say(do="exposure", exposure_us=7000.0)
    wait_for(lambda: getattr(hub.camera.settings, "exposure_us", 0) == 7000.0, "exposure")
    preview = operator.say(do="preview", plan="two")
    assert preview is not None
    assert preview["captures"] == 2
    operator.say(do="run", plan="two", session="first")
    assert states(hub) == ["next", "pending"]
    with pytest.raises(BusyError):
        operator.say(do="home")
    with pytest.raises(BusyError):
        operator.say(do="exposure", exposure_us=1.0)
    operator.answer("ready")
    operator.wait_idle()
    assert hub.run.view.state == "finished"
    assert states(hub) == ["done", "done"]
    session = Session(hub.sessions.folder / "first")
    assert session.is_complete
    assert verify(session.path).is_ok
    assert session.manifest.operator == "Ada"
    assert {record.exposure_us for record in session.records} == {7000.0}
    assert session.bench["camera"]["exposure_us"] == 7000.0
    (summary,) = hub.sessions.summaries()
    assert (summary.name, summary.captured, summary.is_complete) == ("first", 2, True)


@pytest.mark.slow
def test_a_session_is_paused_stopped_resumed_and_retaken(hub: BenchHub, operator: Operator) -> None:
    operator.say(do="run", plan="two", session="first")
    operator.say(do="pause")
    operator.answer("ready")
    wait_for(lambda: run_state(hub) == "paused", "paused")
    assert hub.run.view.captured == 0
    operator.say(do="stop")
    operator.wait_idle()
    assert run_state(hub) == "stopped"
    # Another exposure now does not change what the session began with.
    operator.say(do="exposure", exposure_us=3000.0)
    wait_for(lambda: getattr(hub.camera.settings, "exposure_us", 0) == 3000.0, "exposure")
    operator.say(do="resume", session="first")
    operator.answer("ready")
    operator.wait_idle()
    assert run_state(hub) == "finished"
    operator.say(do="retake", session="first", index=1)
    assert states(hub)[0] == "done"
    operator.answer("ready")
    operator.wait_idle()
    session = Session(hub.sessions.folder / "first")
    kinds = [event.kind for event in session.events]
    assert kinds.count("stop") == 1
    assert kinds.count("retake") == 1
    assert len(session.captures) == 3
    assert {record.exposure_us for record in session.records} == {9000.0}


@pytest.mark.slow
def test_captures_are_compared_with_the_photograph_that_their_plan_names(
    tmp_path: Path,
) -> None:
    plan = PLAN.replace('kind = "edge"\ntarget = "edge"', 'kind = "texture"\ntarget = "coins"')
    (tmp_path / "plain.toml").write_text(plan)
    with running_hub(tmp_path, simulated__width_px=220, simulated__height_px=170) as hub:
        operator = Operator(hub)
        operator.say(do="run", plan="plain", session="before")
        operator.answer("ready")
        operator.wait_idle()
        first = min((hub.sessions.folder / "before" / "captures").glob("*.tif"))
        shutil.copy(first, tmp_path / "before.tif")
        (tmp_path / "again.toml").write_text(f'{plan}reference = "before.tif"\n')
        operator.say(do="run", plan="again", session="after")
        operator.answer("ready")
        operator.wait_idle()
        assert run_state(hub) == "finished"
        notes = [row.note for row in hub.run.view.rows]
        assert all("against before.tif: the same distance" in note for note in notes)
        assert any("captures differ from before.tif" in one.text for one in hub.notices)
    assert (hub.sessions.folder / "after/results/changes/texture-coins/series.json").is_file()


@pytest.mark.slow
def test_a_retake_during_a_pause_begins_the_run_anew_with_it(
    hub: BenchHub, operator: Operator, monkeypatch: pytest.MonkeyPatch
) -> None:
    captured = hub.run._captured

    def pause_after_the_first(progress: CaptureProgress) -> None:
        captured(progress)
        if progress.captured == 1 and not paused:
            paused.append(progress.entry.index)
            operator.say(do="pause")

    paused: list[int] = []
    monkeypatch.setattr(hub.run, "_captured", pause_after_the_first)
    operator.say(do="run", plan="two", session="first")
    wait_for(lambda: hub.prompts.current is not None, "a question")
    with pytest.raises(ApplicationError):
        operator.say(do="retake", session="first", index=1)
    operator.answer("ready")
    wait_for(lambda: run_state(hub) == "paused", "paused")
    assert states(hub) == ["done", "next"]
    operator.say(do="retake", session="first", index=0)
    wait_for(lambda: states(hub) == ["next", "pending"], "void")
    operator.answer("ready")
    operator.say(do="go-on")
    operator.wait_idle()
    assert states(hub) == ["done", "done"]
    session = Session(hub.sessions.folder / "first")
    assert [capture.record.index for capture in session.captures] == [0, 0, 1]
    assert session.is_complete


def test_what_was_skipped_is_said(hub: BenchHub, operator: Operator) -> None:
    operator.say(do="run", plan="two", session="first")
    operator.answer("skip")
    operator.wait_idle()
    assert "2 captures were skipped" in hub.run.view.message
    assert states(hub) == ["next", "pending"]


@pytest.mark.slow
def test_a_stop_ends_a_move_whoever_says_so(tmp_path: Path) -> None:
    with running_hub(tmp_path, stage__feed_mm_per_min=6000.0) as hub:
        ada, ben = Operator(hub), Operator(hub, "Ben")
        ada.say(do="home")
        ada.wait_idle()
        ada.say(do="move", height_mm=600.0)
        wait_for(lambda: (hub.stage.view.height_mm or 0) > 150.0, "under way")
        assert state_document(hub)["stage"]["target"] == "moving to 600.000 mm"
        with pytest.raises(NotInControlError):
            ben.say(do="move", height_mm=200.0)
        ben.say(do="stop")
        ada.wait_idle()
        height_mm = hub.stage.view.height_mm
        assert height_mm is not None
        assert 150.0 < height_mm < 600.0
        assert hub.notices[-1].text == "Stopped: moving the stage to 600 mm."
        ada.say(do="move", height_mm=1.0, is_relative=True)
        ada.wait_idle()
        wait_for(lambda: abs((hub.stage.view.height_mm or 0) - height_mm - 1) < 0.01, "a step")


def test_what_cannot_be_done_is_refused_with_the_reason(hub: BenchHub, operator: Operator) -> None:
    refused: list[tuple[dict[str, object], type[Exception], str]] = [
        ({"do": "move", "height_mm": 9999.0}, StageLimitError, "620"),
        ({"do": "move", "height_mm": 1.0, "is_relative": True}, ApplicationError, "home"),
        ({"do": "run", "plan": "nothing", "session": "s"}, ApplicationError, "'nothing'"),
        ({"do": "run", "plan": "two", "session": "../s"}, ApplicationError, "letters"),
        ({"do": "resume", "session": "nothing"}, ApplicationError, "'nothing'"),
        ({"do": "result", "result": "report", "session": "nothing"}, ApplicationError, "'nothing'"),
        ({"do": "answer", "number": 7, "choice": "ready"}, ApplicationError, "answered"),
        ({"do": "region", "region": (0, 0, 2, 2)}, ApplicationError, "8 pixels"),
        ({"do": "pose-curve", "file": "../curves.json"}, ApplicationError, "no file"),
    ]
    for fields, kind, shown in refused:
        with pytest.raises(kind) as error:
            operator.say(**fields)
        assert shown in str(error.value)


def test_a_session_that_is_there_is_not_run_over(hub: BenchHub, operator: Operator) -> None:
    (hub.sessions.folder / "first").mkdir(parents=True)
    with pytest.raises(ApplicationError):
        operator.say(do="run", plan="two", session="first")


def test_focus_is_measured_in_the_region_that_was_chosen(hub: BenchHub, operator: Operator) -> None:
    wait_for(lambda: hub.picture.facts.focus is not None, "focus")
    operator.say(do="region", region=(8, 8, 40, 30))
    wait_for(
        lambda: hub.picture.facts.region is not None and hub.picture.facts.focus is not None,
        "focus in the region",
    )
    assert state_document(hub)["focus"]["region"] == [8, 8, 40, 30]
    operator.say(do="metric", metric="tenengrad")
    assert hub.picture.facts.measure == "tenengrad"
    operator.say(do="region", region=(8, 8, 4000, 30))
    wait_for(lambda: hub.picture.facts.region is None, "a region beyond the frame is let go")
    operator.say(do="forget-peak")


@pytest.mark.slow
def test_a_report_is_written_and_served(hub: BenchHub, operator: Operator) -> None:
    operator.say(do="run", plan="two", session="first")
    operator.answer("ready")
    operator.wait_idle()
    assert hub.sessions.report_of("first") is None
    operator.say(do="result", result="report", session="first")
    operator.wait_idle()
    report = hub.sessions.report_of("first")
    assert report is not None
    assert b"two heights" in report
    assert b"<script" not in report
