"""Which commands compute the results of a session, and what is said of them."""

import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from acquisition.errors import OperatorStopError
from acquisition.session import Session, SessionNotes
from standoff.console.jobs import Job
from standoff.console.results import ResultJobs, ResultRequest, page_path, results_of
from standoff.console.results.command_process import CommandResult
from standoff.errors import ApplicationError


class Commands:
    """Takes the place of processes: writes a psf.json where one is calibrated."""

    def __init__(self, document: object = None, error: Exception | None = None) -> None:
        self.given: list[list[str]] = []
        self._document, self._error = document, error

    def __call__(self, words: Sequence[str], **_: Any) -> CommandResult:
        self.given.append(list(words))
        if self._error is not None:
            raise self._error
        if words[0] == "calibrate":
            out = next(w for w in words if w.startswith("--out=")).removeprefix("--out=")
            write_psf(Path(out), "2026-02-02T00:00:00.000000Z")
        return CommandResult(document=self._document, remarks=("one remark",))


def write_psf(
    path: Path,
    captured_utc: str,
    *,
    serial: str = "7",
    lens: str = "8 mm",
    heights_mm: Sequence[float] = (),
) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    document = {
        "sigma_x_px": 0.7,
        "camera": {"serial": serial},
        "photograph": {"lens": lens},
        "captured_utc": captured_utc,
        "edges": [{"height_mm": height_mm} for height_mm in heights_mm],
    }
    path.write_text(json.dumps(document))


def computed(jobs: ResultJobs, session: Path, **fields: Any) -> str:
    jobs.work(Job("result"), ResultRequest(session=session, **fields))
    return jobs.view.message


COMPARED = {"verdict": "no significant change", "is_changed": False, "shared_inputs": []}


def test_what_a_session_lacks_is_said_for_each_result(session_dir: Path) -> None:
    views = {view.kind: view for view in results_of(Session(session_dir), has_curves=False)}
    assert {kind for kind, view in views.items() if not view.missing} == {
        "calibrate", "changes", "report",
    }  # fmt: skip
    assert "lens cap" in views["noise"].missing
    assert "--curves" in views["pose"].missing
    assert "two heights" in views["geometry"].missing
    jobs = ResultJobs(session_dir.parent)
    with pytest.raises(ApplicationError, match="lens cap"):
        jobs.refuse_impossible(ResultRequest(session=session_dir, kind="noise"))
    with pytest.raises(ApplicationError, match="two captures"):
        jobs.refuse_impossible(ResultRequest(session=session_dir, kind="changes"))


def test_a_calibration_is_compared_with_the_last_one_of_the_same_camera_and_lens(
    session_dir: Path,
) -> None:
    folder = session_dir.parent
    for name, day, serial, lens in (
        ("old", "2026-01-01", "7", "8 mm"),
        ("last", "2026-01-09", "7", "8 mm"),
        ("later", "2026-03-03", "7", "8 mm"),
        ("other camera", "2026-01-20", "8", "8 mm"),
        ("other lens", "2026-01-20", "7", "12 mm"),
    ):
        path = folder / name / "results/psf.json"
        write_psf(path, f"{day}T00:00:00.000000Z", serial=serial, lens=lens)
    run = Commands(COMPARED)
    said = computed(ResultJobs(folder, run=run), session_dir, kind="calibrate")
    psf = session_dir / "results" / "psf.json"
    assert run.given[0][0] == "calibrate"
    assert run.given[1] == ["compare", "--", str(folder / "last/results/psf.json"), str(psf)]
    assert said == (
        "The lens has not moved since last (2026-01-09), as far as this shows: no significant "
        "change."
    )
    shown = {view.kind: view for view in results_of(Session(session_dir), has_curves=False)}
    assert shown["compare"].figures == said
    assert shown["calibrate"].figures == "σx 0.7000 px"
    moved = Commands(COMPARED | {"is_changed": True, "verdict": "the PSF has changed: sigma_x"})
    jobs = ResultJobs(folder, run=moved)
    said = computed(jobs, session_dir, kind="compare")
    assert said == (
        "The lens has moved, or its focus has changed, since last (2026-01-09): sigma_x."
    )
    assert jobs.view.is_alarming


def test_a_calibration_at_other_heights_says_nothing_of_the_lens(session_dir: Path) -> None:
    folder, changed = session_dir.parent, COMPARED | {"is_changed": True}
    own = session_dir / "results/psf.json"
    write_psf(own, "2026-02-02T00:00:00.000000Z", heights_mm=[200.0, 240.0])
    higher = folder / "higher/results/psf.json"
    write_psf(higher, "2026-01-09T00:00:00.000000Z", heights_mm=[300.0])
    jobs = ResultJobs(folder, run=Commands(changed | {"verdict": "the PSF has changed: sigma_x"}))
    said = computed(jobs, session_dir, kind="compare")
    assert "calibrated at 300 mm and this at 200 to 240 mm" in said
    assert "lens has moved" not in said
    assert not jobs.view.is_alarming
    # An older one at the same heights, to a per cent, does.
    write_psf(
        folder / "same/results/psf.json", "2026-01-01T00:00:00.000000Z", heights_mm=[240.5, 201.0]
    )
    said = computed(jobs, session_dir, kind="compare")
    assert said.startswith("The lens has moved, or its focus has changed, since same (2026-01-01)")
    assert jobs.view.is_alarming


def test_a_first_calibration_has_nothing_to_be_compared_with(session_dir: Path) -> None:
    run = Commands(COMPARED)
    said = computed(ResultJobs(session_dir.parent, run=run), session_dir, kind="calibrate")
    assert "no earlier calibration" in said
    assert [words[0] for words in run.given] == ["calibrate"]


def test_two_captures_are_compared_and_the_comparison_is_listed(session_dir: Path) -> None:
    record = Session(session_dir).records[1]
    reference = session_dir / "captures" / "first.tif"
    run = Commands({"is_accepted": True, "dprime_decisive": 3, "min_dprime": 2, "overlap": 1})
    jobs = ResultJobs(session_dir.parent, ("--curves=c.json", "--min-dprime=2"), run=run)
    pair: dict[str, Any] = {"reference": (reference, "0 of a/b"), "followup": record}
    computed(jobs, session_dir, kind="pose", is_replacing=True, **pair)
    (words,) = run.given
    assert words[:4] == ["pose", "--force", "--curves=c.json", "--min-dprime=2"]
    assert words[-3:] == ["--", str(reference), str(session_dir / record.file)]
    (found,) = [v for v in results_of(Session(session_dir), has_curves=True) if v.pair]
    assert found.pair == "1 against 0 of a-b"  # no separator in a file's name
    assert found.figures == "accepted: d' 3.00, threshold 2, overlap 100 %"
    assert found.page == ""  # the picture was not written here


def test_a_capture_is_not_compared_with_itself(session_dir: Path) -> None:
    record = Session(session_dir).records[1]
    own = (session_dir / record.file, "1")
    jobs = ResultJobs(session_dir.parent, ("--curves=c.json",), run=Commands({}))
    for kind in ("pose", "changes"):
        request = ResultRequest(session=session_dir, kind=kind, reference=own, followup=record)
        with pytest.raises(ApplicationError, match="with itself"):
            jobs.refuse_impossible(request)


def test_results_are_served_by_their_names_alone(session_dir: Path) -> None:
    results = session_dir / "results"
    (results / "changes/1 against 0").mkdir(parents=True)
    (results / "changes/1 against 0/report.html").write_text("changed")
    (results / "changes/1 against 0/changes.json").write_text("{}")
    (results / "psf.html").write_text("page")
    (results / "psf.json").write_text("{}")
    (results / "noise.html").symlink_to(session_dir / "session.json")
    assert page_path(session_dir, "psf.html") == results / "psf.html"
    pair = "changes/1 against 0/report.html"
    assert page_path(session_dir, pair) == results / pair
    for page in (
        "", ".", "..", "psf.json", "noise.html", "geometry.html", "../session.json",
        "changes/../psf.html", "changes//psf.html", "/etc/passwd", "changes/x/report.html",
    ):  # fmt: skip
        assert page_path(session_dir, page) is None
    shutil.move(results, session_dir / "elsewhere")
    results.symlink_to(session_dir / "elsewhere")
    assert page_path(session_dir, "psf.html") is None


def test_a_failure_and_a_stop_are_said_and_kept(session_dir: Path) -> None:
    for error, state, text in (
        (ApplicationError("no edge is sharp enough"), "failed", "no edge is sharp enough"),
        (OperatorStopError("stopped"), "stopped", "Cancelled"),
    ):
        jobs = ResultJobs(session_dir.parent, run=Commands(error=error))
        with pytest.raises(type(error)):
            computed(jobs, session_dir, kind="calibrate")
        assert jobs.view.state == state
        assert text in jobs.view.message


def test_results_are_not_written_through_links(session_dir: Path, tmp_path: Path) -> None:
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    (session_dir / "results").symlink_to(elsewhere)
    run = Commands()
    with pytest.raises(ApplicationError, match="not followed"):
        computed(ResultJobs(session_dir.parent, run=run), session_dir, kind="calibrate")
    assert run.given == []
    assert list(elsewhere.iterdir()) == []


def test_a_result_is_outdated_once_the_captures_have_changed(session_dir: Path) -> None:
    write_psf(session_dir / "results/psf.json", "2026-01-01T00:00:00.000000Z")
    psf = next(iter(results_of(Session(session_dir), has_curves=False)))
    assert (psf.kind, psf.is_done, psf.is_outdated) == ("calibrate", True, False)
    SessionNotes(session_dir, operator="Ada").exclude(0, "a hair")
    assert next(iter(results_of(Session(session_dir), has_curves=False))).is_outdated
