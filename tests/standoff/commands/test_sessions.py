import json
from pathlib import Path

import pytest

from acquisition.bench import load_bench
from acquisition.plan import PlanEntry
from acquisition.session._files import JOURNAL_NAME
from standoff.terminal import time_text
from tests.standoff.conftest import SMALL_PLAN, Command


def test_a_plan_is_captured_verified_and_found_again(
    command: Command, capture_line: str, tmp_path: Path
) -> None:
    for captured, found_done in ((6, 0), (0, 6)):
        document = command.document(capture_line, "--yes")
        assert (document["captured"], document["already_captured"]) == (captured, found_done)
    verified = command.document("verify", tmp_path / "s")
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
        f"capture --bench {bench_file} --plan {plan_file} --out {session_dir} --yes --json"
    )
    assert json.loads(again.out)["captured"] == 1
    command.done("verify", session_dir)


def test_a_changed_plan_is_refused(
    command: Command, session_dir: Path, bench_file: Path, tmp_path: Path
) -> None:
    other = tmp_path / "other.toml"
    other.write_text(SMALL_PLAN.replace("300.0", "310.0"))
    err = command.refused(
        1, "capture", "--bench", bench_file, "--plan", other, "--out", session_dir, "--yes"
    )
    assert "310" in err


def test_a_dry_run_lists_the_captures_and_writes_nothing(
    command: Command, capture_line: str, tmp_path: Path
) -> None:
    out = tmp_path / "s"
    document = command.document(capture_line, "--dry-run")
    assert [len(document["captures"]), document["placements"]] == [6, 3]
    # 128 x 160 pixels of mean and variance, 4 bytes each.
    assert document["bytes"] == 6 * 128 * 160 * 8
    # By hand: 793 mm at 5 mm/s (from 370 mm, down with 2 x 0.5 mm of backlash, up and down), six
    # ramps of 0.3 s and settlings of 0.5 s, six captures of 5 frames at 60 Hz and 0.25 s.
    assert document["seconds"] == pytest.approx(793 / 5 + 6 * (0.8 + 5 / 60 + 0.25), abs=0.1)
    shown = command(capture_line, "--dry-run").out
    assert "orientation" in shown
    assert "6 captures, 3 placements: about" in shown
    assert "MB on disk" in shown
    assert not out.exists()
    out.mkdir()
    (out / "session.json").write_text("{}")
    assert "already contains a session" in command(capture_line, "--dry-run").err


def test_the_operator_is_asked_at_every_new_target_and_may_skip_it(
    command: Command, capture_line: str, tmp_path: Path
) -> None:
    answers = tmp_path / "answers.txt"
    answers.write_text("\nwhat?\ns\n\n")  # what is no answer is asked again
    done = command(capture_line, "--answers", answers, "--json")
    summary = json.loads(done.out)
    assert (summary["captured"], summary["skipped"]) == (4, 2)
    assert "Place edge 'edge' at 50 degrees." in done.err
    assert "'what?' is not a valid answer" in done.err


def test_ctrl_c_leaves_a_session_that_resumes(
    command: Command, capture_line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    calls: list[PlanEntry] = []

    def interrupt_at_the_second(_: object) -> object:
        def place(entry: PlanEntry) -> str:
            calls.append(entry)
            if len(calls) == 2:
                raise KeyboardInterrupt
            return "ready"

        return place

    with monkeypatch.context() as patch:
        where = "standoff.library.bench._devices.place_in_simulation"
        patch.setattr(where, interrupt_at_the_second)
        assert command(capture_line, "--yes").status == 130
    assert command.document(capture_line, "--yes") == {
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
    err = command.refused(
        1, "capture", "--bench", bench_file, "--plan", plan, "--out", tmp_path / "s", "--yes"
    )
    assert "elephant" in err


def test_a_driver_that_is_not_there_is_named(command: Command, capture_line: str) -> None:
    err = command.refused(1, f"{capture_line} --set camera.driver=files --yes")
    assert "files" in err


@pytest.mark.slow
def test_the_report_shows_the_captures_and_then_the_psf(
    command: Command, session_dir: Path
) -> None:
    before = command.done("report", session_dir)
    assert "psf.json" in before.err
    page = session_dir / "results" / "report.html"
    assert "6 of 6 planned" in page.read_text()
    command("calibrate", "--session", session_dir, "--out", session_dir / "results" / "psf.json")
    assert command.document("report", session_dir)["report"] == str(page)
    assert "Point spread function" in page.read_text()


def capture_words(bench: Path, plan: Path, out: Path, *more: object) -> list[object]:
    return ["capture", "--bench", bench, "--plan", plan, "--out", out, *more]


REAL_BENCH = ("--set", "camera.driver=aravis", "--set", "camera.address=127.0.0.1")
REAL_STAGE = ("--set", "stage.driver=grbl", "--set", "stage.port=/dev/null")


@pytest.mark.parametrize("options", [[], ["--yes"], ["--placed"]])
def test_on_a_real_bench_somebody_has_to_place_the_targets(
    command: Command, capture_line: str, tmp_path: Path, options: list[str]
) -> None:
    done = command(capture_line, *REAL_BENCH, *REAL_STAGE, *options)
    assert (done.status, done.out) == (2, "")
    assert done.err.count("\n") == 1
    assert "3 target" in done.err
    assert "--answers" in done.err
    assert not (tmp_path / "s").exists()


def test_a_manual_stage_needs_somebody_though_the_target_is_placed(
    command: Command, bench_file: Path, tmp_path: Path
) -> None:
    plan = tmp_path / "one.toml"
    plan.write_text(SMALL_PLAN.replace("[5.0, 50.0, 95.0]", "[5.0]"))
    words = capture_words(bench_file, plan, tmp_path / "s", *REAL_BENCH, "--placed")
    assert "terminal" in command.refused(2, *words, "--set", "stage.driver=manual")


def test_answers_that_end_too_early_are_named_and_the_session_resumes(
    command: Command, capture_line: str, tmp_path: Path
) -> None:
    answers = tmp_path / "answers.txt"
    answers.write_text("\n\n")
    words = (capture_line, "--answers", answers, "--json")
    done = command(*words)
    assert (done.status, done.out) == (1, "")
    assert "answers.txt has no answer left for: Enter to capture" in done.err
    resumed = json.loads(command(*words).out)
    assert (resumed["captured"], resumed["already_captured"]) == (2, 4)


def test_answers_that_are_not_there_are_named(
    command: Command, capture_line: str, tmp_path: Path
) -> None:
    assert "absent" in command.refused(1, capture_line, "--answers", tmp_path / "absent")
    assert not (tmp_path / "s").exists()


def test_a_capture_is_retaken_shown_and_verified_with_its_reason(
    command: Command, session_dir: Path, bench_file: Path, plan_file: Path
) -> None:
    words = capture_words(bench_file, plan_file, session_dir, "--yes", "--retake", 2, "--json")
    assert json.loads(command(*words).out)["captured"] == 1
    old = next(p for p in sorted((session_dir / "captures").glob("0002_*")) if "take" not in p.name)
    old.write_bytes(b"damaged")
    verified = command.done("verify", session_dir)
    assert f"changed      captures/{old.name} (superseded)" in verified.out
    assert "nothing uses them, so they do not count" in verified.out
    shown = json.loads(command("session", "show", session_dir, "--json").out)
    assert [c["superseded"] for c in shown["captures"] if c["index"] == 2] == [True, False]
    err = command.refused(
        1, *capture_words(bench_file, plan_file, session_dir, "--yes", "--retake", 77)
    )
    assert "no capture with index 77" in err


def test_captures_are_excluded_and_included_with_a_reason_and_notes_are_kept(
    command: Command, session_dir: Path
) -> None:
    command.done("session", "exclude", 3, session_dir, "--reason", "hair")
    command.done("session", "note", "lamp changed", session_dir)
    shown = command("session", "show", session_dir).out
    assert "excluded: hair" in shown
    assert "lamp changed" in shown
    listed = json.loads(command("session", "list", session_dir.parent, "--json").out)
    assert [(row["captured"], row["planned"], row["excluded"]) for row in listed] == [(6, 6, 1)]
    command.done("session", "include", 3, session_dir)
    assert "not excluded" in command.refused(1, "session", "include", 3, session_dir)
    assert command("session", "exclude", 3, session_dir).status == 2  # a reason is asked for
    assert command("session", "exclude", 99, session_dir, "--reason", "x").status == 1


def test_the_catalogue_goes_on_past_a_session_that_cannot_be_read(
    command: Command, session_dir: Path
) -> None:
    broken = session_dir.parent / "broken"
    broken.mkdir()
    (broken / "session.json").write_text("{")
    done = command.done("session", "list", session_dir.parent)
    assert "6 of 6" in done.out
    assert "cannot be read" in done.out
    assert "broken" in done.err
    assert command("session", "list", session_dir / "absent").status == 1


def test_a_real_bench_is_warned_of_the_flicker_of_its_lamps(
    command: Command, capture_line: str
) -> None:
    words = (capture_line, "--dry-run", *REAL_BENCH, "--set", "stage.driver=manual")
    warned = command(*words).err
    assert "12000 us is not a multiple of the 10 ms" in warned
    assert "use 10000 us" in warned
    assert command(*words, "--set", "capture.mains_hz=0").err == ""
    assert command(*words, "--set", "camera.exposure_us=20000").err == ""
    other = ("--set", "camera.exposure_us=17500", "--set", "capture.mains_hz=60")
    assert "16667 us" in command(*words, *other).err


def test_a_journal_cut_short_is_remarked_wherever_the_session_is_read(
    command: Command, session_dir: Path
) -> None:
    journal = session_dir / JOURNAL_NAME
    with journal.open("ab") as file:
        file.write(b'{"kind": "note", "te')
    for words in (("session", "show", session_dir), ("verify", session_dir)):
        done = command.done(*words)
        assert "note: the last line of the journal was cut short and is ignored" in done.err


def test_a_session_taken_again_shows_both_captures_in_its_table(
    command: Command, session_dir: Path, bench_file: Path, plan_file: Path
) -> None:
    words = capture_words(bench_file, plan_file, session_dir, "--yes", "--retake", 2)
    command.done(*words)
    shown = command("session", "show", session_dir).out
    assert shown.count("superseded") == 1
    assert "6 of 6 captured" in shown


def test_what_the_bench_warns_of_is_said_before_the_first_capture(
    command: Command, bench_file: Path, tmp_path: Path
) -> None:
    plan = tmp_path / "drift.toml"
    one = SMALL_PLAN.replace("[5.0, 50.0, 95.0]", "[5.0]").replace("[180.0, 300.0]", "[180.0]")
    plan.write_text(one.replace("frames_per", "drift_check = true\nrepeats = 2\nframes_per"))
    done = command.done(*capture_words(bench_file, plan, tmp_path / "s", "--yes"))
    [remark] = [line for line in done.err.splitlines() if "drift: " in line]
    assert remark.startswith("note: capture ")


@pytest.mark.parametrize(
    ("seconds", "text"),
    [(6.2, "7 s"), (59.5, "1 min 00 s"), (200.0, "3 min 20 s"), (3900.0, "1 h 05 min")],
)
def test_a_duration_is_told_in_the_units_of_its_size(seconds: float, text: str) -> None:
    assert time_text(seconds) == text


def test_the_frame_is_the_bench_files_region_where_it_names_one(bench_file: Path) -> None:
    assert load_bench(bench_file).frame_shape == (128, 160)
    region = {
        "camera.driver": "aravis",
        "camera.address": "127.0.0.1",
        "stage.driver": "manual",
        "camera.region_px": [8, 16, 320, 240],
    }
    assert load_bench(bench_file, region).frame_shape == (240, 320)


def test_the_report_says_which_files_of_a_session_are_gone_or_changed(
    command: Command, session_dir: Path
) -> None:
    files = sorted((session_dir / "captures").glob("*.tif"))
    assert "missing or changed" not in command("report", session_dir).err
    files[0].write_bytes(files[0].read_bytes() + b"x")
    err = command.refused(1, "report", session_dir)
    assert f"missing or changed, the first captures/{files[0].name}" in err
    assert "standoff verify" in err


def test_an_altered_journal_is_refused_by_line_and_repaired_on_demand(
    command: Command, session_dir: Path
) -> None:
    assert json.loads(command("verify", session_dir, "--json").out)["faults"] == []
    journal = session_dir / JOURNAL_NAME
    lines = journal.read_bytes().splitlines(keepends=True)
    number = next(n for n, line in enumerate(lines) if b'"event": "capture"' in line)
    lines[number] = lines[number].replace(b'"height_mm": ', b'"height_mm": 1')
    journal.write_bytes(b"".join(lines))
    for words in (("verify", session_dir), ("session", "show", session_dir)):
        err = command.refused(1, *words)
        assert f"line {number + 1}" in err
        assert "standoff verify --repair" in err
    repaired = command.done("verify", session_dir, "--repair")
    assert "brought back from captures/" in repaired.err
    command.done("verify", session_dir)
    assert list(session_dir.glob("journal-damaged-*.jsonl"))
