"""What the page of a session shows of retakes, notes and results, whatever its files hold."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

pytest.importorskip("starlette", reason="the console's extra is not installed")
pytest.importorskip("httpx2", reason="starlette's test client needs httpx2")

from starlette.testclient import TestClient

from acquisition.choices import CaptureKind
from acquisition.session.writer import SessionNotes
from standoff.console.session_library import SessionLibrary
from standoff.console.web.application import console_app
from standoff.console.web.session_page import ROWS_A_PAGE, _pair, session_document
from tests.acquisition.records import RECORD
from tests.standoff.conftest import Command
from tests.standoff.console.hub_fixtures import idle_hub
from tests.standoff.console.long_session import lengthen


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
    with TestClient(
        console_app(hub), client=("127.0.0.1", 1), base_url="http://127.0.0.1"
    ) as client:
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
    with TestClient(
        console_app(hub), client=("127.0.0.1", 1), base_url="http://127.0.0.1"
    ) as client:
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
    with TestClient(
        console_app(hub), client=("127.0.0.1", 1), base_url="http://127.0.0.1"
    ) as client:
        page = client.get("/sessions/got").text
    assert "\\x1b[31mred\\u202etxt.exe &lt;script&gt;" in page
    assert "\x1b" not in page
    assert "\u202e" not in page
    assert "x" * 501 not in page
