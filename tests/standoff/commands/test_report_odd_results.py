"""Results that cannot be read: the report is refused before anything is written."""

import json
from pathlib import Path

import pytest

from calibration.psf._document import PSF_SCHEMA
from tests.analysis.bench_session import chart_session
from tests.fuzz.result_targets import CHANGES, POSE
from tests.standoff.conftest import Command


def results_of(path: Path) -> Path:
    """The results of a session that can be compared, with a pose and changes."""
    results = chart_session(path, 3, 3).path / "results"
    (results / "a" / "b").mkdir(parents=True)
    psf = {"schema": PSF_SCHEMA, "sigma_x_px": 0.7, "sigma_y_px": 0.7}
    (results / "psf.json").write_text(json.dumps(psf))
    (results / "pose.json").write_text(json.dumps(POSE))
    (results / "a" / "b" / "changes.json").write_text(json.dumps(CHANGES))
    return results


@pytest.mark.parametrize("name", ["pose.json", "a/b/changes.json"])
def test_a_damaged_result_is_refused_before_anything_is_written(
    command: Command, tmp_path: Path, name: str
) -> None:
    results = results_of(tmp_path / "s")
    odd = results / name
    for damage in ("cut", "link"):
        odd.unlink()
        if damage == "cut":
            odd.write_text("{")
        else:
            odd.symlink_to("nothing")
        before = sorted(results.rglob("*"))
        assert name in command.refused(1, "report", tmp_path / "s")
        assert sorted(results.rglob("*")) == before


def test_results_are_not_written_into_a_folder_elsewhere(command: Command, tmp_path: Path) -> None:
    session = chart_session(tmp_path / "s", 3, 3).path
    (tmp_path / "elsewhere").mkdir()
    (session / "results").symlink_to(tmp_path / "elsewhere")
    for words in (
        ("report", session),
        ("calibrate", "--session", session, "--out", session / "results" / "psf.json"),
    ):
        assert "results is a link" in command.refused(1, *words)
    assert not list((tmp_path / "elsewhere").iterdir())
