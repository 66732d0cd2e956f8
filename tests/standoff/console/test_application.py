"""The pages of a console with a session in it, the pose, and questions with an answer to type."""

import os
import re
from collections.abc import Iterator
from pathlib import Path
from threading import Event, Thread
from typing import NoReturn
from urllib.parse import quote

import numpy as np
import pytest

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("httpx2", reason="starlette's test client needs httpx2")


from acquisition.errors import DeviceDisconnectedError, OperatorStopError
from acquisition.session import SessionNotes
from standoff.console.bench_hub import BenchHub
from standoff.console.devices import DeviceStatus, bench_drivers
from standoff.console.frames import FrameBroadcaster
from standoff.console.jobs import PromptQueue
from standoff.console.monitors import PoseMonitor, tracker_maker
from standoff.console.plans import PlanLibrary
from standoff.console.web import _application as application
from standoff.console.web._application import bench_checks
from standoff.errors import ApplicationError
from tests.acquisition.fakes import SETTINGS, frame
from tests.analysis.detectability.test_curves import curve
from tests.standoff.console.hub_fixtures import (
    DEADLINE_S,
    PLAN,
    idle_hub,
    running_hub,
    small_bench,
    wait_for,
)
from tests.standoff.console.served import answer_of, page_client, sent, served
from tests.standoff.console.test_bench_hub import Operator


@pytest.fixture(scope="module")
def hub(tmp_path_factory: pytest.TempPathFactory) -> Iterator[BenchHub]:
    with running_hub(tmp_path_factory.mktemp("pages")) as made:
        operator = Operator(made)
        operator.say(do="run", plan="two", session="first")
        operator.answer("ready")
        operator.wait_idle()
        # Other commands give sessions any name.
        (made.sessions.folder / "first").rename(made.sessions.folder / "Prüfling <7> & 8")
        yield made


def page(hub: BenchHub, path: str) -> str:
    with page_client(hub) as client:
        answer = client.get(path)
    assert answer.status_code == 200
    return str(answer.text)


@pytest.mark.slow
def test_the_sessions_are_listed(hub: BenchHub) -> None:
    shown = page(hub, "/sessions")
    assert "Prüfling &lt;7&gt; &amp; 8" in shown
    assert "2 of 2" in shown


def test_a_session_has_a_page_with_its_captures_and_its_psf(hub: BenchHub) -> None:
    folder = hub.sessions.folder / "Prüfling <7> & 8"
    SessionNotes(folder, operator="Ada").exclude(1, "a <b>hair</b> on it")
    (folder / "results").mkdir(exist_ok=True)
    (folder / "results" / "psf.json").write_text('{"sigma_x_px": 0.7, "sigma_x_err_px": 0.001}')
    shown = page(hub, "/sessions/" + quote("Prüfling <7> & 8"))
    assert "excluded: a &lt;b&gt;hair&lt;/b&gt; on it" in shown
    assert "0.7000 ± 0.0020 px" in shown
    assert 'data-reference="0"' in shown
    assert 'data-reference="1"' not in shown


def test_the_buttons_of_a_session_wait_for_the_console(hub: BenchHub) -> None:
    shown = page(hub, "/sessions/" + quote("Prüfling <7> & 8"))
    buttons = re.findall(r"<button[^>]*>", shown[shown.index("<main") :])
    assert len(buttons) > 4
    assert all(" disabled" in button for button in buttons)


def test_more_pages_than_can_wait_are_refused_at_once_and_the_others_are_served(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(application, "PAGES_AT_ONCE", 1)
    monkeypatch.setattr(application, "PAGES_WAITING", 2)
    idle, go_on = idle_hub(tmp_path), Event()
    at_work: list[int] = []
    most = 0

    def slow_summaries() -> tuple[()]:
        nonlocal most
        at_work.append(1)
        most = max(most, len(at_work))
        assert go_on.wait(DEADLINE_S)
        at_work.pop()
        return ()

    monkeypatch.setattr(idle.sessions, "summaries", slow_summaries)
    answers: list[bytes] = []
    with served(idle) as address:

        def ask() -> None:
            with sent(address, b"GET /sessions HTTP/1.0\r\nHost: 127.0.0.1\r\n\r\n") as wire:
                answers.append(answer_of(wire))

        askers = [Thread(target=ask) for _ in range(5)]
        for asker in askers:
            asker.start()
        try:
            wait_for(lambda: len(answers) == 2, "two refusals")
            assert all(b"503" in answer.splitlines()[0] for answer in answers)
            assert all(b"retry-after: 1\r\n" in answer for answer in answers)
        finally:
            go_on.set()
            for asker in askers:
                asker.join()
    assert [b"200 OK" in answer.splitlines()[0] for answer in answers[2:]] == [True] * 3
    assert most == 1


def test_a_damaged_session_is_shown_as_such(hub: BenchHub) -> None:
    damaged = hub.sessions.folder / "damaged"
    damaged.mkdir(exist_ok=True)
    (damaged / "session.json").write_text("{")
    assert "damaged" in page(hub, "/sessions")
    with page_client(hub) as client:
        assert client.get("/sessions/damaged").status_code == 409


def test_the_doctor_knows_the_devices_that_the_console_holds(hub: BenchHub) -> None:
    checks = {check.name: check for check in bench_checks(hub)}
    assert checks["camera"].status == "ok"
    assert "Simulated camera" in checks["camera"].found
    assert checks["stage"].status == "ok"
    assert "complete" in checks["frames"].found
    assert "Simulated stage" in page(hub, "/doctor")


def test_the_doctor_says_what_to_do_about_a_lost_camera(tmp_path: Path) -> None:
    idle = idle_hub(tmp_path)
    idle.camera._lost(DeviceDisconnectedError("no camera answers"))
    checks = {check.name: check for check in bench_checks(idle)}
    assert (checks["camera"].status, checks["camera"].found) == ("fail", "no camera answers")
    assert "cable" in checks["camera"].remedy
    assert checks["stage"].status == "warn"
    assert DeviceStatus(state="ready").is_ready


@pytest.mark.parametrize(
    ("address", "status", "found"),
    [
        ("127.0.0.1", "ok", "127.0.0.1 through"),
        ("camera-7", "fail", "the host name 'camera-7' cannot be resolved"),
    ],
)
def test_the_doctor_tells_the_way_to_a_network_camera(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, address: str, status: str, found: str
) -> None:
    if status == "fail":

        def unknown(*_: object) -> NoReturn:
            raise OSError(-2, "Name or service not known")

        monkeypatch.setattr("socket.getaddrinfo", unknown)
    bench = small_bench()
    update = {"driver": "aravis", "address": address}
    real = bench.model_copy(
        update={
            "camera": bench.camera.model_copy(update=update),
            "stage": bench.stage.model_copy(update={"driver": "manual"}),
        }
    )
    hub = BenchHub(real, bench_drivers(real), sessions=tmp_path / "sessions")
    checks = {check.name: check for check in bench_checks(hub)}
    assert checks["network"].status == status
    assert found in checks["network"].found
    assert ("camera.address in the bench file" in checks["network"].remedy) is (status == "fail")
    assert ("MTU" in checks) is (status == "ok")
    assert checks["camera"].found == "The camera is being opened"
    assert "frames" not in checks  # none was opened yet


def test_only_plans_are_offered_and_the_first_of_a_name_counts(tmp_path: Path) -> None:
    near, far = tmp_path / "near", tmp_path / "far"
    for folder, name in ((near, "two"), (far, "two"), (far, "three")):
        folder.mkdir(exist_ok=True)
        (folder / f"{name}.toml").write_text(PLAN.replace("two heights", f"{folder.name} {name}"))
    (near / "bench.toml").write_text("[camera]\n")
    (near / "broken.toml").write_text("= 3")
    os.mkfifo(near / "pipe.toml")
    plans = PlanLibrary((near, far))
    assert plans.names() == ("three", "two")
    assert plans.load("two").name == "near two"
    with pytest.raises(ApplicationError):
        plans.load("bench")


def test_a_question_with_a_line_is_answered_by_it() -> None:
    queue = PromptQueue(lambda: None)
    answers: list[str] = []
    asking = Thread(target=lambda: answers.append(queue.ask("Height shown on the scale, in mm")))
    asking.start()
    wait_for(lambda: queue.current is not None, "the question")
    prompt = queue.current
    assert prompt is not None
    assert prompt.wants_text
    assert not queue.answer(prompt.number + 1, "ok", "1")
    assert not queue.answer(prompt.number, "skip", "1")
    assert queue.answer(prompt.number, "ok", "251.5")
    asking.join(DEADLINE_S)
    assert answers == ["251.5"]
    assert queue.current is None


def test_a_stop_ends_a_question() -> None:
    def stopped() -> None:
        raise OperatorStopError("stopped")

    queue = PromptQueue(stopped)
    with pytest.raises(OperatorStopError):
        queue.ask("anything?")
    assert queue.current is None


def texture() -> np.ndarray[tuple[int, int], np.dtype[np.uint16]]:
    """Blobs of several sizes, 320 x 240 px."""
    rng = np.random.default_rng(5)
    rows, cols = np.mgrid[0:240, 0:320]
    image = np.full((240, 320), 800.0)
    for _ in range(250):
        y, x, sigma = rng.uniform(0, 240), rng.uniform(0, 320), rng.uniform(2, 8)
        bump = np.exp(-((rows - y) ** 2 + (cols - x) ** 2) / (2 * sigma**2))
        image += rng.uniform(-400, 900) * bump
    levels: np.ndarray[tuple[int, int], np.dtype[np.uint16]] = np.clip(image, 0, 4095).astype(
        np.uint16
    )
    return levels


@pytest.mark.slow
def test_the_pose_is_judged_against_the_chosen_picture() -> None:
    broadcaster = FrameBroadcaster()
    monitor = PoseMonitor(broadcaster, tracker_maker(curve(), 1e-6))
    monitor.start()
    try:
        monitor.choose("before", texture())
        broadcaster.publish(frame(texture(), 1), SETTINGS)
        wait_for(lambda: monitor.view.verdict is not None, "a verdict")
        verdict = monitor.view.verdict
        assert verdict is not None
        assert verdict.accepted
        assert verdict.zoom == pytest.approx(1.0, abs=0.01)
        broadcaster.publish(frame(np.full((240, 320), 700, np.uint16), 2), SETTINGS)
        wait_for(
            lambda: monitor.view.verdict is not None and not monitor.view.verdict.accepted, "lost"
        )
        with pytest.raises(ApplicationError):
            monitor.choose("grey", np.full((240, 320), 700, np.uint16))
        monitor.clear()
        assert monitor.view.reference == ""
    finally:
        monitor.close()
