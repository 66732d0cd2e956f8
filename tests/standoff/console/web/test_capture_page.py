"""The page of one capture: its images with their real levels, and captures that do not count."""

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("httpx2", reason="starlette's test client needs httpx2")

from starlette.testclient import TestClient

from acquisition.errors import SessionError
from acquisition.session import Session
from standoff.console.bench_hub import BenchHub
from standoff.console.jobs import Job, RunView
from standoff.console.web.application import console_app
from standoff.errors import ApplicationError
from tests.standoff.conftest import Command
from tests.standoff.console.hub_fixtures import idle_hub
from tests.standoff.console.test_bench_hub import Operator

BRACKET_PLAN = """
schema = "standoff.plan/1"
name = "bracket"
heights_mm = [300.0]
frames_per_capture = 2
keep_frames = true

[[targets]]
kind = "chart"
target = "step tablet"
exposure_us = 3000
bracket = { exposures = 2, ratio = 8 }
"""


@pytest.fixture
def hub(session_dir: Path, tmp_path: Path) -> BenchHub:
    made = idle_hub(tmp_path)
    made.sessions.folder.mkdir()
    session_dir.rename(made.sessions.folder / "first")
    return made


@pytest.fixture
def client(hub: BenchHub) -> Iterator[TestClient]:
    with TestClient(console_app(hub), client=("127.0.0.1", 1), base_url="http://127.0.0.1") as made:
        yield made


def levels(client: TestClient, address: str) -> np.ndarray[tuple[int, int], np.dtype[np.float32]]:
    answer = client.get(address)
    assert answer.status_code == 200
    shape = int(answer.headers["x-rows"]), int(answer.headers["x-cols"])
    return np.frombuffer(answer.content, "<f4").reshape(shape)


def test_the_levels_of_a_capture_are_those_of_its_file(hub: BenchHub, client: TestClient) -> None:
    session = Session(hub.sessions.folder / "first")
    images = session.load(session.records[3])
    assert images.variance_dn2 is not None
    address = "/sessions/first/captures/3/levels"
    np.testing.assert_array_equal(levels(client, f"{address}/mean"), images.mean_dn)
    np.testing.assert_array_equal(levels(client, f"{address}/noise"), np.sqrt(images.variance_dn2))
    for absent in ("exposures", "0", "frames", "Mean", "99999999"):
        assert client.get(f"{address}/{absent}").status_code == 404
    page = client.get("/sessions/first/captures/3").text
    assert 'href="/sessions/first/captures/2"' in page
    assert 'href="/sessions/first/captures/4"' in page
    assert 'data-image="noise"' in page
    assert 'data-image="exposures"' not in page
    assert client.get("/sessions/first/captures/6").status_code == 404
    assert client.get("/sessions/first/captures/3?uid=0").status_code == 404


def test_a_bracket_shows_its_exposures_and_single_frames(
    command: Command, bench_file: Path, tmp_path: Path
) -> None:
    hub, plan = idle_hub(tmp_path), tmp_path / "bracket.toml"
    plan.write_text(BRACKET_PLAN)
    path = hub.sessions.folder / "b"
    done = command("capture", "--bench", bench_file, "--plan", plan, "--out", path, "--yes")
    assert done.status == 0
    session = Session(path)
    used = session.load(session.records[0]).exposures_used
    assert used is not None
    with TestClient(
        console_app(hub), client=("127.0.0.1", 1), base_url="http://127.0.0.1"
    ) as client:
        address = "/sessions/b/captures/0"
        page = client.get(address).text
        assert "Exposures of the bracket" in page
        for exposure in session.records[0].bracket or ():
            assert f"<td>{exposure.exposure_us:g}</td>" in page
        np.testing.assert_array_equal(levels(client, f"{address}/levels/exposures"), used)
        mean = levels(client, f"{address}/levels/mean")
        np.testing.assert_array_equal(np.isnan(mean), used == 0)
        frame = levels(client, f"{address}/levels/0")
        assert frame.shape == mean.shape
        np.testing.assert_array_equal(frame, np.rint(frame))  # levels as they were read out


def test_a_thumbnail_is_a_small_picture_that_is_made_once(
    hub: BenchHub, client: TestClient
) -> None:
    address = "/sessions/first/captures/0/thumbnail"
    answer = client.get(address)
    assert answer.headers["content-type"] == "image/jpeg"
    small = cv2.imdecode(np.frombuffer(answer.content, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert small is not None
    assert small.shape == (96, 120)  # of 128 x 160 pixels
    assert np.ptp(small) > 150  # an edge: dark on one side, bright on the other
    session = Session(hub.sessions.folder / "first")
    (session.path / session.records[0].file).unlink()
    assert client.get(address).content == answer.content
    assert client.get("/sessions/first/captures/0/levels/mean").status_code == 409


def test_a_changed_file_and_a_link_are_refused(hub: BenchHub, client: TestClient) -> None:
    session = Session(hub.sessions.folder / "first")
    first, second = (session.path / record.file for record in session.records[:2])
    with first.open("ab") as file:
        file.write(b"more")
    answer = client.get("/sessions/first/captures/0/levels/mean")
    assert answer.status_code == 409
    assert "sha256 differs" in answer.text
    moved = second.rename(session.path.parent / "elsewhere.tif")
    second.symlink_to(moved)
    for image in ("levels/mean", "thumbnail"):
        answer = client.get(f"/sessions/first/captures/1/{image}")
        assert answer.status_code == 409
        assert "not followed" in answer.text


def test_a_capture_is_excluded_with_a_reason_and_included_again(
    hub: BenchHub, client: TestClient, monkeypatch: pytest.MonkeyPatch
) -> None:
    operator = Operator(hub)
    with pytest.raises(ApplicationError, match="why"):
        operator.say(do="exclude", session="first", index=2, reason="  ")
    assert operator.say(do="exclude", session="first", index=2, reason="a hair") == {
        "type": "changed"
    }
    session = Session(hub.sessions.folder / "first")
    assert [record.index for record in session.records] == [0, 1, 3, 4, 5]
    assert session.events[-1].facts["operator"] == "Ada"
    assert "excluded: a hair" in client.get("/sessions/first").text
    assert 'id="include"' in client.get("/sessions/first/captures/2").text
    operator.say(do="include", session="first", index=2)
    assert len(Session(session.path).records) == 6
    for fields in (
        {"do": "include", "session": "first", "index": 2},
        {"do": "exclude", "session": "first", "index": 77, "reason": "no such"},
        {"do": "exclude", "session": "none", "index": 2, "reason": "no such"},
    ):
        with pytest.raises((ApplicationError, SessionError)):
            operator.say(**fields)
    running = RunView(session="first", state="running")
    monkeypatch.setattr(hub.run, "_view", running)

    def wait(_: Job) -> None:
        hub.prompts.ask("wait")

    job = hub.jobs.begin("session first", wait)
    try:
        with pytest.raises(ApplicationError, match="running"):
            operator.say(do="exclude", session="first", index=2, reason="a hair")
    finally:
        job.ask_stop()
        job.ended.wait()
