"""The pages about sessions: captures with their levels, notes, comparisons, and results."""

import re
from base64 import b64encode
from collections.abc import Iterator
from dataclasses import replace
from hashlib import sha256
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZipFile

import cv2
import numpy as np
import pytest
from PIL import Image

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("httpx2", reason="starlette's test client needs httpx2")


from starlette.testclient import TestClient

from acquisition.choices import CaptureKind
from acquisition.errors import SessionError
from acquisition.session import Session, SessionNotes
from analysis.reports import views_script
from standoff import correct_height, export_session, import_photographs
from standoff.console.bench_hub import BenchHub, ConsoleHub
from standoff.console.jobs import Job
from standoff.console.session_library import SessionLibrary
from standoff.console.session_run import RunView
from standoff.console.web._session_pages import (
    BLOCKED,
    REPORT_POLICY,
    ROWS_A_PAGE,
    _pair,
    has_foreign_script,
    report_response,
    session_document,
)
from standoff.errors import ApplicationError
from tests.acquisition.records import RECORD
from tests.analysis.reports.test_changes import page
from tests.standoff.conftest import Command
from tests.standoff.console.hub_fixtures import idle_hub
from tests.standoff.console.long_session import lengthen
from tests.standoff.console.served import page_client
from tests.standoff.console.test_bench_hub import Operator

OTHER = b"<body class=x><script>steal()</script></body>"


def test_the_policy_names_the_script_that_a_report_of_changes_has_and_no_other() -> None:
    document, _ = page()
    begin = document.index("<script>") + len("<script>")
    script = document[begin : document.index("</script>")]
    assert script == views_script()
    assert f"'sha256-{b64encode(sha256(script.encode()).digest()).decode()}'" in REPORT_POLICY
    assert "unsafe-inline'; img" in REPORT_POLICY  # of styles
    assert REPORT_POLICY.count("script-src") == 1
    assert "allow-same-origin" not in REPORT_POLICY
    assert not has_foreign_script(document.encode())


@pytest.mark.parametrize(
    "document",
    [
        OTHER,
        b"<SCRIPT src=x.js></SCRIPT >",
        b"<body><script>" + views_script().encode()[:-9] + b"</script>",
    ],
)
def test_a_page_whose_script_does_not_run_says_so_at_its_top(document: bytes) -> None:
    assert has_foreign_script(document)
    answer = bytes(report_response(document).body)
    assert answer.replace(BLOCKED.encode(), b"") == document
    assert answer.index(b"does not run in the console") < answer.lower().index(b"<script")


def test_a_page_without_a_script_is_served_as_it_is() -> None:
    plain = b"<!doctype html><body>a report</body>"
    answer = report_response(plain)
    assert bytes(answer.body) == plain
    assert answer.headers["Content-Security-Policy"] == REPORT_POLICY


def shown(session: Path) -> dict[str, Any]:
    return session_document(SessionLibrary(session.parent), session.name)


def test_a_capture_taken_again_is_shown_beside_the_one_that_took_its_place(
    command: Command, session_dir: Path, bench_file: Path, plan_file: Path
) -> None:
    words = ("capture", "--bench", bench_file, "--plan", plan_file, "--out", session_dir, "--yes")
    assert command(*words, "--retake", 2).status == 0
    taken = [c for c in shown(session_dir)["captures"] if c["index"] == 2]
    assert [c["state"] for c in taken] == ["superseded", "used"]
    assert [(c["is_current"], c["is_used"]) for c in taken] == [(False, False), (True, True)]


def test_notes_skips_and_errors_are_told_with_the_capture_they_are_about(
    command: Command, bench_file: Path, plan_file: Path, tmp_path: Path
) -> None:
    answers, session = tmp_path / "answers.txt", tmp_path / "s"
    answers.write_text("\ns\n")  # the second orientation is skipped, the third one not answered
    words = ("capture", "--bench", bench_file, "--plan", plan_file, "--out", session)
    assert command(*words, "--answers", answers).status == 1
    SessionNotes(session, operator="Ada").note("lamp changed")
    told = [note["text"] for note in shown(session)["notes"]]
    assert told[:2] == [
        "capture 2: stopped or skipped by the operator",
        "capture 3: stopped or skipped by the operator",
    ]
    assert "has no answer left for" in told[2]
    assert told[3] == "lamp changed"


@pytest.mark.parametrize(
    ("kinds", "names", "heights_mm", "pair"),
    [
        # Two photographs that were imported: each is a target of its own, at one height.
        ("tt", "ab", (250.0, 250.0), (0, 1)),
        ("tt", "aa", (250.0, 240.0), (1, 0)),
        ("ttt", "aba", (250.0, 230.0, 240.0), (2, 0)),
        ("tee", "abc", (250.0, 240.0, 230.0), (2, 0)),
        ("fdt", "abc", (1.0, 2.0, 3.0), (None, 2)),
        ("fd", "ab", (1.0, 2.0), (None, None)),
    ],
)
def test_two_captures_are_proposed_for_a_comparison_and_never_one_with_itself(
    kinds: str, names: str, heights_mm: tuple[float, ...], pair: tuple[int | None, int | None]
) -> None:
    spelt: dict[str, CaptureKind] = {"t": "texture", "e": "edge", "f": "flat", "d": "dark"}
    records = [
        replace(RECORD, index=at, kind=spelt[kind], target=name, height_mm=height_mm)
        for at, (kind, name, height_mm) in enumerate(zip(kinds, names, heights_mm, strict=True))
    ]
    proposed = _pair(records)
    assert (proposed.get("reference"), proposed.get("followup")) == pair


def test_a_session_without_a_report_says_so(session_dir: Path, tmp_path: Path) -> None:
    hub = idle_hub(tmp_path)
    hub.sessions.folder.mkdir()
    session_dir.rename(hub.sessions.folder / "first")
    with page_client(hub) as client:
        absent = client.get("/sessions/first/report")
        assert absent.status_code == 404
        assert "first has no report yet" in absent.text
        folder = hub.sessions.folder / "first" / "results"
        folder.mkdir()
        (folder / "report.html").write_text("<p>the report</p>")
        there = client.get("/sessions/first/report")
        assert (there.status_code, there.text) == (200, "<p>the report</p>")
        assert "'none'" in there.headers["content-security-policy"]


def test_the_captures_of_a_long_session_are_shown_a_page_at_a_time(
    session_dir: Path, tmp_path: Path
) -> None:
    hub = idle_hub(tmp_path)
    hub.sessions.folder.mkdir()
    session_dir.rename(hub.sessions.folder / "long")
    lengthen(hub.sessions.folder / "long", 2 * ROWS_A_PAGE + 1)
    with page_client(hub) as client:
        pages = [client.get(f"/sessions/long?page={number}").text for number in (1, 2, 3)]
        shown_rows = [page.count("data-retake") for page in pages]
        assert shown_rows == [ROWS_A_PAGE, ROWS_A_PAGE, 1]
        assert "201 to 400 of 401" in pages[1]
        assert max(len(page) for page in pages) < 1.7e5  # all 10 000 captures were 4 MB
        for number in ("0", "-1", "x", "²", "9" * 9):
            assert client.get("/sessions/long", params={"page": number}).status_code == 404


def test_what_a_received_session_holds_does_nothing_to_its_page(
    session_dir: Path, tmp_path: Path
) -> None:
    hub = idle_hub(tmp_path)
    hub.sessions.folder.mkdir()
    session_dir.rename(hub.sessions.folder / "got")
    folder = hub.sessions.folder / "got"
    SessionNotes(folder, operator="Ada").note("\x1b[31mred\u202etxt.exe <script>" + "x" * 10_000)
    with page_client(hub) as client:
        page = client.get("/sessions/got").text
    assert "\\x1b[31mred\\u202etxt.exe &lt;script&gt;" in page
    assert "\x1b" not in page
    assert "\u202e" not in page
    assert "x" * 501 not in page


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
    with page_client(hub) as made:
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
    with page_client(hub) as client:
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
    monkeypatch.setattr(hub.run, "view", running)

    def wait(_: Job) -> None:
        hub.prompts.ask("wait")

    job = hub.jobs.begin("session first", wait)
    try:
        with pytest.raises(ApplicationError, match="running"):
            operator.say(do="exclude", session="first", index=2, reason="a hair")
    finally:
        job.ask_stop()
        job.ended.wait()


@pytest.fixture
def photographed(tmp_path: Path) -> ConsoleHub:
    """A console without a bench that has a session of two photographs, of unknown height."""
    rng = np.random.default_rng(7)
    paths = [tmp_path / f"{name}.png" for name in ("before", "after")]
    for path in paths:
        Image.fromarray(rng.integers(0, 255, (96, 128), dtype=np.uint8)).save(path)
    hub = ConsoleHub(sessions=tmp_path / "sessions")
    hub.sessions.folder.mkdir()
    import_photographs(paths, hub.sessions.folder / "wall", kind="texture", height_mm=0)
    return hub


def test_a_height_that_is_not_known_is_shown_nowhere_as_a_number(photographed: ConsoleHub) -> None:
    folder = photographed.sessions.folder / "wall"
    with page_client(photographed) as pages:
        for path in ("/sessions/wall", "/photographs", "/sessions/wall/captures/0"):
            shown = pages.get(path).text
            assert not re.search(r"(?<!h000)(?<!\d)0\.000", shown), path
            assert "0.0 mm" not in shown, path
        assert "not known" in pages.get("/sessions/wall/captures/0").text
        # The null: a height that is known is shown.
        correct_height(folder, [0], 412.5, "measured")
        assert "412.500 mm" in pages.get("/sessions/wall/captures/0").text
        assert "412.500" in pages.get("/sessions/wall").text
    opened = Session(folder)
    assert [opened.known_height_mm(record) for record in opened.records] == [412.5, None]


def test_a_reference_is_chosen_by_what_the_consoles_own_page_sends_alone(
    photographed: ConsoleHub,
) -> None:
    path = "/guide/to/wall/0"
    with page_client(photographed) as pages:
        own = {"Origin": str(pages.base_url).rstrip("/")}
        assert pages.get(path).status_code == 404
        assert pages.post(path).status_code == 403
        assert pages.post(path, headers={"Origin": "http://elsewhere.test"}).status_code == 403
        assert list(photographed.references) == []
        answer = pages.post(path, headers=own)  # noise can be followed
        assert answer.status_code == 200
        (name,) = photographed.references
        assert pages.get(answer.json()["address"]).status_code == 200
        assert name in pages.get(answer.json()["address"]).text
        missing = pages.post("/guide/to/wall/9", headers=own)
        assert missing.status_code in (404, 409)
    photographed.references.close()


def test_an_ome_zarr_folder_is_fetched_as_one_zip_file(photographed: ConsoleHub) -> None:
    pytest.importorskip("zarr", reason="zarr is not installed")
    folder = photographed.sessions.folder / "wall"
    out = folder / "results" / "export.ome.zarr"
    address = "/sessions/wall/exports/export.ome.zarr"
    with page_client(photographed) as pages:
        assert pages.get(address).status_code == 404
        out.parent.mkdir(exist_ok=True)
        export_session(folder, out, format="ome-zarr")
        (out / "link").symlink_to(folder / "session.json")
        answer = pages.get(address)
        assert "wall%20export.ome.zarr.zip" in answer.headers["Content-Disposition"]
        with ZipFile(BytesIO(answer.content)) as archive:
            assert archive.testzip() is None
            found = {one: archive.read(one) for one in archive.namelist()}
        files = [path for path in out.rglob("*") if path.is_file() and not path.is_symlink()]
        assert found == {f"{out.name}/{path.relative_to(out)}": path.read_bytes() for path in files}
        assert len(found) > 4
        assert "export.ome.zarr" in pages.get("/sessions/wall").text
        elsewhere = out.rename(out.with_name("elsewhere"))
        out.symlink_to(elsewhere)
        assert pages.get(address).status_code == 404
