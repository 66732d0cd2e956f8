"""Which commands compute the results of a session, in processes of their own, and what is said."""

import io
import json
import shutil
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

import standoff
from acquisition.errors import OperatorStopError
from acquisition.session import Session, SessionNotes
from standoff.console import result_jobs
from standoff.console.jobs import Job
from standoff.console.result_jobs import (
    CommandProgress,
    ResultJobs,
    ResultProgress,
    ResultRequest,
    run_command,
)
from standoff.console.results import (
    MAX_RESULT_BYTES,
    export_path,
    key_figures,
    page_path,
    results_of,
)
from standoff.errors import ApplicationError


def test_progress_is_told_and_a_remark_is_no_reason_of_a_failure() -> None:
    told: list[CommandProgress] = []
    said = result_jobs._Said(told.append)
    said.hear(
        io.StringIO(
            "note: compiling the numerical code, once: a minute or two\n"
            "measuring edges: 3 of 12 after 4 s\n"
            "note: 8 of 246 edges do not fit\n"
            "standoff: there is no edge\n"
        )
    )
    assert told[0].text.startswith("compiling")
    assert told[1:] == [CommandProgress(text="measuring edges", done=3, total=12)]
    assert said.fault == "there is no edge"


@pytest.mark.slow
def test_a_command_that_fails_gives_its_own_reason(tmp_path: Path) -> None:
    absent = tmp_path / "none.json"
    with pytest.raises(ApplicationError) as error:
        run_command(("compare", str(absent), str(absent)), check=lambda: None)
    assert "none.json" in str(error.value)
    assert "\n" not in str(error.value)


@pytest.mark.slow
def test_a_command_prints_its_document(tmp_path: Path) -> None:
    psf = tmp_path / "psf.json"
    psf.write_text(
        '{"schema": "standoff.psf/1", "sigma_x_px": 0.9, "sigma_x_err_px": 0.01,'
        ' "sigma_y_px": 0.8, "sigma_y_err_px": 0.01, "rho": 0.1, "rho_err": 0.01}'
    )
    result = run_command(("compare", str(psf), str(psf)), check=lambda: None)
    assert isinstance(result, dict)
    assert isinstance(result["verdict"], str)


@pytest.mark.slow
def test_a_command_that_is_stopped_ends_at_once(tmp_path: Path) -> None:
    checks = []

    def stop_at_the_second_check() -> None:
        checks.append(1)
        if len(checks) == 2:
            raise OperatorStopError("stopped")

    with pytest.raises(OperatorStopError):
        run_command(("demo", "--out", str(tmp_path / "demo")), check=stop_at_the_second_check)
    assert not (tmp_path / "demo").exists() or not list((tmp_path / "demo").glob("*.html"))


@pytest.mark.parametrize(
    ("kind", "document", "line"),
    [
        ("calibrate", [1, 2], ""),
        ("calibrate", {"sigma_x_px": "wide", "rho": None}, ""),
        (
            "calibrate",
            {"sigma_x_px": 0.7, "sigma_x_err_px": 0.001, "rho": 0.25, "rho_err": 0.01},
            "σx 0.7000 ± 0.0020 px, ρ 0.2500 ± 0.0196",  # 1.96 standard errors
        ),
        ("calibrate", {"sigma_y_px": 0.6}, "σy 0.6000 px"),
        (
            "noise",
            {"gain_e_per_dn": 5.0, "gain_e_per_dn_err": 0.01, "saturation_dn": 4095},
            "K 5.000 ± 0.020 e/DN, saturation 4095 DN",
        ),
        ("geometry", {"tilt_deg": 0.1, "tilt_err_deg": 0.01}, "tilt 0.100 ± 0.020°"),
        (  # the bench file's focal length, which nothing measured
            "geometry",
            {"pupil_offset_mm": 12.5, "pupil_offset_err_mm": 0.1}
            | {"focal_length_px": 963.86, "focal_length_err_px": 0.0},
            "entrance pupil 12.50 ± 0.20 mm",
        ),
        (
            "geometry",
            {"focal_length_px": 963.86, "focal_length_err_px": 1.5},
            "focal length 963.86 ± 2.94 px",
        ),
        (
            "changes",
            {"changes": [{}], "changed_px": 7, "compared_px": 100},
            "1 change: 7 of 100 pixels",
        ),
        ("changes", {"changes": 3}, ""),
        (
            "pose",
            {"is_accepted": False, "dprime_decisive": 1.5, "min_dprime": 2, "overlap": 0.5},
            "rejected: d' 1.50, threshold 2, overlap 50 %",
        ),
        (
            "validate",
            {
                "table_2": [
                    {"alignment": "followup-grid", "model": name, "ssim": ssim} | {"pairs": 3}
                    | {"psnr_db": 30.0}
                    for name, ssim in (("bicubic", 0.8), ("matched", 0.9))
                ]
            },
            "3 pairs, closest model: matched (SSIM 0.900, PSNR 30.0 dB)",
        ),
        ("validate", {"table_2": []}, ""),
        (
            "calibrate",
            {"sigma_x_px": 0.7, "method": "single-image"},
            "σx 0.7000 px; from edges that the scene happens to have, taken for sharp",
        ),
        ("verify", {"files": [{"state": "ok"}, {"state": "ok"}, {"state": "changed"}]},
         "2 of 3 files match the journal"),
        ("verify", {"files": 3}, ""),
    ],
)  # fmt: skip
def test_a_line_says_what_the_file_tells_and_junk_says_nothing(
    tmp_path: Path, kind: str, document: object, line: str
) -> None:
    path = tmp_path / f"{kind}.json"
    path.write_text(json.dumps(document))
    found = key_figures(kind, path)
    assert found is not None
    assert found.text == line


def test_a_file_that_is_replaced_is_read_again(tmp_path: Path) -> None:
    path = tmp_path / "psf.json"
    path.write_text('{"sigma_x_px": 0.6}')
    first = key_figures("calibrate", path)
    path.write_text('{"sigma_x_px": 0.65}')
    second = key_figures("calibrate", path)
    assert [each.text for each in (first, second) if each] == ["σx 0.6000 px", "σx 0.6500 px"]


def test_links_missing_files_and_very_large_ones_are_not_read(tmp_path: Path) -> None:
    path, elsewhere = tmp_path / "psf.json", tmp_path / "secret.json"
    assert key_figures("calibrate", path) is None
    elsewhere.write_text('{"sigma_x_px": 0.7}')
    path.symlink_to(elsewhere)
    assert key_figures("calibrate", path) is None
    path.unlink()
    path.write_text('{"sigma_x_px": 0.7}')
    with path.open("ab") as file:
        file.truncate(MAX_RESULT_BYTES + 1)
    found = key_figures("calibrate", path)
    assert found is not None
    assert found.text == ""


class Commands:
    """Takes the place of processes: writes a psf.json where one is calibrated."""

    def __init__(self, document: object = None, error: Exception | None = None) -> None:
        self.given: list[list[str]] = []
        self._document, self._error = document, error

    def __call__(self, words: Sequence[str], **_: Any) -> object:
        self.given.append(list(words))
        if self._error is not None:
            raise self._error
        if words[0] == "calibrate":
            out = next(w for w in words if w.startswith("--out=")).removeprefix("--out=")
            write_psf(Path(out), "2026-02-02T00:00:00.000000Z")
        return self._document


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
        "calibrate", "changes", "report", "verify", "export",
    }  # fmt: skip
    assert "lens cap" in views["noise"].missing
    assert "--curves" in views["pose"].missing
    assert "two heights" in views["geometry"].missing
    jobs = ResultJobs(session_dir.parent)
    with pytest.raises(ApplicationError, match="lens cap"):
        jobs.refuse_impossible(ResultRequest(session=session_dir, kind="noise"))
    with pytest.raises(ApplicationError, match="two captures"):
        jobs.refuse_impossible(ResultRequest(session=session_dir, kind="changes"))


@pytest.fixture
def imported(tmp_path: Path) -> Path:
    """A session of two photographs of a scene."""
    rng = np.random.default_rng(1)
    paths = []
    for name in ("near.png", "far.png"):
        paths.append(tmp_path / name)
        Image.fromarray(rng.integers(0, 255, (40, 60), np.uint8)).save(paths[-1])
    session = tmp_path / "sessions" / "wall"
    standoff.import_photographs(paths, session, kind="texture", height_mm=0)
    return session


def test_without_an_edge_the_psf_is_that_of_the_scene_or_of_two_distances(imported: Path) -> None:
    run = Commands()
    jobs = ResultJobs(imported.parent, run=run)
    computed(jobs, imported, kind="calibrate")
    near, far = Session(imported).records
    psf = f"--out={imported / 'results' / 'psf.json'}"
    files = [str(imported / record.file) for record in (near, far)]
    assert run.given == [["calibrate", psf, "--method=single-image", "--", *files]]
    pair = {"reference": (imported / near.file, "0"), "followup": far}
    computed(jobs, imported, kind="calibrate", is_replacing=True, **pair)
    assert run.given[1:] == [["calibrate", "--force", psf, "--method=two-distance", "--", *files]]


def test_what_verify_says_is_kept_and_what_it_said_before_does_not_outlive_a_failure(
    imported: Path,
) -> None:
    kept = imported / "results" / "verify.json"
    computed(
        ResultJobs(imported.parent, run=Commands({"files": [{"state": "ok"}]})),
        imported,
        kind="verify",
    )
    (row,) = [v for v in results_of(Session(imported), has_curves=False) if v.kind == "verify"]
    assert row.figures == "1 of 1 files match the journal"
    jobs = ResultJobs(imported.parent, run=Commands(error=ApplicationError("a file is missing")))
    with pytest.raises(ApplicationError):
        computed(jobs, imported, kind="verify")
    assert not kept.exists()


def test_an_export_is_fetched_by_its_name_alone(imported: Path, tmp_path: Path) -> None:
    run = Commands({})
    computed(ResultJobs(imported.parent, run=run), imported, kind="export", file_format="nexus")
    out = imported / "results" / "export.nxs"
    assert run.given == [["export", "--format=nexus", f"--out={out}", "--", str(imported)]]
    assert export_path(imported, "export.nxs") is None
    out.write_bytes(b"nexus")
    assert export_path(imported, "export.nxs") == out
    assert [v.pair for v in results_of(Session(imported), has_curves=False) if v.pair] == [
        "export.nxs"
    ]
    assert export_path(imported, "../session.json") is None
    out.rename(tmp_path / "elsewhere")
    out.symlink_to(tmp_path / "elsewhere")
    assert export_path(imported, "export.nxs") is None


def test_several_pairs_are_compared_one_after_the_other_and_one_may_fail(imported: Path) -> None:
    near, far = Session(imported).records
    requests = [
        ResultRequest(
            session=imported,
            kind="changes",
            reference=(imported / one.file, str(one.index)),
            followup=other,
        )
        for one, other in ((near, far), (far, near))
    ]
    run = Commands({})
    jobs = ResultJobs(imported.parent, run=run)
    jobs.work_through(Job("changes"), requests)
    files = [str(imported / one.file) for one in (near, far)]
    assert [words[-2:] for words in run.given] == [files, files[::-1]]
    assert jobs.view.state == "done"
    assert jobs.view.title.endswith("2 photographs: 2 of 2")
    assert jobs.view.page == ""

    def fail_once(words: list[str], **_: object) -> object:
        if words[-1] == files[1]:
            raise ApplicationError("it does not overlap")
        return {}

    jobs = ResultJobs(imported.parent, run=fail_once)
    jobs.work_through(Job("changes"), requests)
    assert jobs.view.state == "done"
    assert "it does not overlap" in jobs.view.message
    with pytest.raises(ApplicationError, match="does not overlap"):
        jobs.work_through(Job("changes"), requests[:1])
    view: ResultProgress = jobs.view
    assert view.state == "failed"


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
    assert "calibration was at 300 mm and this one at 200 to 240 mm" in said
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
