import json
from pathlib import Path

import pytest

from calibration.psf._document import PSF_SCHEMA
from tests.analysis.bench_session import chart_session
from tests.standoff.conftest import Command


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sigma_y_px", "seeds", "reason"),
    [(None, (3, 3), "sigma_y_px is null"), (0.7, (3, 77), "no pair of captures can be")],
)
def test_the_report_leaves_out_what_it_cannot_compare_and_says_why(
    command: Command,
    tmp_path: Path,
    sigma_y_px: float | None,
    seeds: tuple[int, int],
    reason: str,
) -> None:
    session = chart_session(tmp_path / "s", *seeds)
    results = session.path / "results"
    results.mkdir()
    content = {"schema": PSF_SCHEMA, "sigma_x_px": 0.7, "sigma_y_px": sigma_y_px}
    (results / "psf.json").write_text(json.dumps(content))
    done = command.done("report", session.path)
    assert "note: the report leaves out the comparison of heights" in done.err
    assert reason in done.err
    text = (results / "report.html").read_text()
    assert "<h2>Left out</h2>" in text
    assert reason in text


@pytest.mark.slow
def test_one_capture_that_cannot_be_aligned_is_noted_and_the_others_are_reported(
    command: Command, tmp_path: Path
) -> None:
    session = chart_session(tmp_path / "s", 3, 3, 77)
    results = session.path / "results"
    results.mkdir()
    content = {"schema": PSF_SCHEMA, "sigma_x_px": 0.7, "sigma_y_px": 0.7}
    (results / "psf.json").write_text(json.dumps(content))
    done = command.done("report", session.path)
    [line] = [line for line in done.err.splitlines() if "excluded: capture" in line]
    assert "capture 2" in line
    compared = json.loads((results / "validation.json").read_text())
    assert len(compared["pairs"]) == 1
    assert [one["capture"] for one in compared["excluded"]] == [2]
    assert "Left out: capture 2" in (results / "report.html").read_text()
