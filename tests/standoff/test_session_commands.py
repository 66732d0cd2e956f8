import json
from pathlib import Path

import pytest

import standoff.commands.sessions
from acquisition.plan import PlanEntry
from tests.standoff.conftest import SMALL_PLAN, Command


def test_a_plan_is_captured_verified_and_found_again(
    command: Command, bench_file: Path, plan_file: Path, tmp_path: Path
) -> None:
    arguments = ("capture", "--bench", bench_file, "--plan", plan_file, "--out", tmp_path / "s")
    first = json.loads(command(*arguments, "--yes", "--json").out)
    assert (first["captured"], first["already_captured"]) == (6, 0)
    again = json.loads(command(*arguments, "--yes", "--json").out)
    assert (again["captured"], again["already_captured"]) == (0, 6)
    verified = json.loads(command("verify", tmp_path / "s", "--json").out)
    assert verified["ok"] is True
    assert len(verified["files"]) == 7  # six captures and session.json


def test_a_damaged_capture_is_found_and_taken_again(
    command: Command, session_dir: Path, bench_file: Path, plan_file: Path
) -> None:
    victim = sorted((session_dir / "captures").glob("*.tif"))[2]
    data = bytearray(victim.read_bytes())
    data[-5] ^= 1
    victim.write_bytes(data)
    done = command("verify", session_dir)
    assert done.status == 1
    assert victim.name in done.out
    again = command(
        "capture",
        "--bench",
        bench_file,
        "--plan",
        plan_file,
        "--out",
        session_dir,
        "--yes",
        "--json",
    )
    assert json.loads(again.out)["captured"] == 1
    assert command("verify", session_dir).status == 0


def test_a_changed_plan_is_refused(
    command: Command, session_dir: Path, bench_file: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other.toml"
    other.write_text(SMALL_PLAN.replace("300.0", "310.0"))
    done = command("capture", "--bench", bench_file, "--plan", other, "--out", session_dir, "--yes")
    assert done.status == 1
    assert "310" in done.err


def test_a_dry_run_lists_the_captures_and_writes_nothing(
    command: Command, bench_file: Path, plan_file: Path, tmp_path: Path
) -> None:
    out = tmp_path / "s"
    arguments = ("capture", "--bench", bench_file, "--plan", plan_file, "--out", out, "--dry-run")
    assert len(json.loads(command(*arguments, "--json").out)) == 6
    assert "orientation" in command(*arguments).out
    assert not out.exists()


def test_the_operator_is_asked_at_every_new_target_and_may_skip_it(
    command: Command,
    bench_file: Path,
    plan_file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    answers = iter(["", "s", ""])
    monkeypatch.setattr("typer.prompt", lambda *_, **__: next(answers))
    done = command(
        "capture", "--bench", bench_file, "--plan", plan_file, "--out", tmp_path / "s", "--json"
    )
    summary = json.loads(done.out)
    assert (summary["captured"], summary["skipped"]) == (4, 2)
    assert "50 degrees" in done.err


def test_ctrl_c_leaves_a_session_that_resumes(
    command: Command,
    bench_file: Path,
    plan_file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[PlanEntry] = []

    def interrupt_at_the_second(_: object) -> object:
        def place(entry: PlanEntry) -> str:
            calls.append(entry)
            if len(calls) == 2:
                raise KeyboardInterrupt
            return "ready"

        return place

    arguments = ("capture", "--bench", bench_file, "--plan", plan_file, "--out", tmp_path / "s")
    with monkeypatch.context() as patch:
        patch.setattr(standoff.commands.sessions, "place_in_simulation", interrupt_at_the_second)
        assert command(*arguments, "--yes").status == 130
    resumed = json.loads(command(*arguments, "--yes", "--json").out)
    assert resumed == {
        "session": str(tmp_path / "s"),
        "captured": 4,
        "already_captured": 2,
        "skipped": 0,
    }


def test_a_target_the_bench_does_not_have_is_named(
    command: Command, bench_file: Path, tmp_path: Path
) -> None:
    plan = tmp_path / "odd.toml"
    plan.write_text(SMALL_PLAN.replace('target = "edge"', 'target = "elephant"'))
    done = command(
        "capture", "--bench", bench_file, "--plan", plan, "--out", tmp_path / "s", "--yes"
    )
    assert done.status == 1
    assert "elephant" in done.err


def test_a_driver_that_is_not_there_is_named(
    command: Command, bench_file: Path, plan_file: Path, tmp_path: Path
) -> None:
    done = command(
        "capture", "--bench", bench_file, "--plan", plan_file, "--out", tmp_path / "s",
        "--set", "camera.driver=files",
    )  # fmt: skip
    assert done.status == 1
    assert "files" in done.err


def test_the_report_shows_the_captures_and_then_the_psf(
    command: Command, session_dir: Path
) -> None:
    before = command("report", session_dir)
    assert before.status == 0
    assert "psf.json" in before.err
    page = session_dir / "results" / "report.html"
    assert "6 of 6 planned" in page.read_text()
    command("calibrate", "--session", session_dir, "--out", session_dir / "results" / "psf.json")
    after = command("report", session_dir, "--json")
    assert json.loads(after.out)["report"] == str(page)
    assert "Point spread function" in page.read_text()
