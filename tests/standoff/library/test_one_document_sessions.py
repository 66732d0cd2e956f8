"""Capture sessions: the command prints what the function returns."""

import json
from pathlib import Path

import pytest

import standoff
from calibration.documents import json_object
from tests.standoff.conftest import SMALL_BENCH, Command
from tests.standoff.library.one_document import printed, without_caller

TEXTURE_PLAN = """
schema = "standoff.plan/1"
name = "texture"
heights_mm = [180.0, 260.0]
frames_per_capture = 4

[[targets]]
kind = "texture"
target = "coins"
"""


def test_import(command: Command, edge_file: Path, tmp_path: Path) -> None:
    words = ("--kind", "edge", "--height-mm", 250, "--scale", 12)
    out = tmp_path / "session"
    done = command("import", edge_file, *words, "--out", out, "--json")
    found = standoff.import_photographs(
        [edge_file], tmp_path / "again", kind="edge", height_mm=250, scale_px_per_mm=12
    )
    assert printed(done) == {**found.to_json(), "session": str(out)}
    with pytest.raises(standoff.ArgumentError, match="scale"):
        standoff.import_photographs(
            [edge_file], out, kind="edge", height_mm=250, scale_px_per_mm=-1
        )


def test_verify_list_and_show(command: Command, session_dir: Path) -> None:
    found = standoff.verify_session(session_dir)
    assert found.is_ok
    assert printed(command("verify", session_dir, "--json")) == found.to_json()
    repaired = standoff.verify_session(session_dir, repair=True)
    assert printed(command("verify", session_dir, "--repair", "--json")) == repaired.to_json()
    standoff.exclude_capture(session_dir, 1, "a hair", operator="somebody")
    standoff.add_note(session_dir, "warm day")
    listed = json.loads(command("session", "list", session_dir, "--json").out)
    assert listed == standoff.list_sessions(session_dir)
    shown = printed(command("session", "show", session_dir, "--json"))
    assert shown == without_caller(standoff.show_session(session_dir))
    assert shown["excluded"] == 1
    table = standoff.Session(session_dir).to_dataframe()
    assert table["excluded_because"].dropna().tolist() == ["a hair"]
    assert set(table["height_mm"]) == {180.0, 300.0}


def test_what_is_decided_about_a_capture_stands_in_the_session(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    session = tmp_path / "session"
    standoff.import_photographs([edge_file], session, kind="edge", height_mm=250)
    standoff.exclude_capture(session, 0, "a hair", operator="Ada")
    standoff.include_capture(standoff.Session(session), 0, "no hair", operator="Ada")
    (event,) = standoff.correct_height(session, [0], 262.5, "a tape", operator="Ada")
    standoff.add_note(session, "warm day", operator="Ada")
    assert (event.facts["was_mm"], event.facts["height_mm"]) == (250.0, 262.5)
    by_function = [dict(one.facts) for one in standoff.Session(session).events[-4:]]
    words = ("--operator", "Ada")
    for done in (
        command("session", "exclude", 0, session, "--reason", "a hair", *words),
        command("session", "include", 0, session, "--reason", "no hair", *words),
        command("session", "set-height", 0, session, "--height-mm", 262.5, "--reason", "a tape",
                *words),
        command("session", "note", "warm day", session, *words),
    ):  # fmt: skip
        assert done.status == 0, done.err
    by_command = [dict(one.facts) for one in standoff.Session(session).events[-4:]]
    assert by_command == [
        one | ({"was_mm": 262.5} if "was_mm" in one else {}) for one in by_function
    ]
    with pytest.raises(ValueError, match="height_mm"):
        standoff.correct_height(session, [0], float("nan"), "a slip")


def test_export(command: Command, session_dir: Path, tmp_path: Path) -> None:
    out = tmp_path / "session.ome.tif"
    done = command("export", session_dir, "--format", "ome-tiff", "--out", out, "--json")
    found = standoff.export_session(session_dir, tmp_path / "again.ome.tif", format="ome-tiff")
    assert printed(done) == without_caller(found.to_json())
    assert all(note in done.err for note in found.notes)


@pytest.mark.slow
def test_validate_and_report(command: Command, tmp_path: Path, psf_file: Path) -> None:
    larger = SMALL_BENCH.replace("160", "240").replace("128", "192")
    session = command.captured(tmp_path, larger, TEXTURE_PLAN)
    asked = ("--session", session, "--psf", psf_file, "--models", "lmmse,paper")
    done = command("validate", *asked, "--out", tmp_path / "by-command", "--json")
    found = standoff.validate(
        session, psf_file, tmp_path / "by-function", models=["paper", "lmmse"]
    )
    assert printed(done) == without_caller(json_object(found))
    with pytest.raises(standoff.ArgumentError, match="models: expected"):
        standoff.validate(session, psf_file, tmp_path / "none", models=["cubic"])  # type: ignore[list-item]  # on purpose
    table = found.to_dataframe()
    first = found.pairs[0].models[0]
    assert table["agreement.mse_dn2"][0] == first.agreement.mse_dn2
    assert len(table) == sum(len(pair.models) for pair in found.pairs)

    page = tmp_path / "report.html"
    done = command("report", session, "--out", page, "--json")
    written = standoff.write_report(session, page)
    assert printed(done) == written.to_json()
    assert all(note in done.err for note in written.notes)
    assert written.notes
