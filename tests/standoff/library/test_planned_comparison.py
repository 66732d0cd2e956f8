"""A capture plan that names an earlier photograph of its target."""

import json
from pathlib import Path

import numpy as np
import pytest

from analysis.change_series import read_time_line
from tests.analysis.html_page import Page
from tests.standoff.conftest import SMALL_BENCH, Command

BENCH = SMALL_BENCH.replace("width_px = 160", "width_px = 220").replace(
    "height_px = 128", "height_px = 170"
)
PLAN = """
schema = "standoff.plan/1"
name = "followups"
heights_mm = {heights}
frames_per_capture = 4

[[targets]]
kind = "texture"
target = "coins"
{reference}
"""


@pytest.fixture
def bench(tmp_path: Path) -> Path:
    path = tmp_path / "bench.toml"
    path.write_text(BENCH, encoding="utf-8")
    return path


def plan(path: Path, heights: list[float], reference: str = "") -> Path:
    path.write_text(PLAN.format(heights=heights, reference=reference), encoding="utf-8")
    return path


@pytest.mark.slow
def test_each_capture_is_compared_with_the_photograph_that_the_plan_names(
    command: Command, bench: Path, tmp_path: Path
) -> None:
    before = tmp_path / "before"
    first = plan(tmp_path / "first.toml", [200.0])
    own = ("capture", "--bench", bench, "--yes")
    command.done(*own, "--plan", first, "--out", before)
    (photograph,) = before.glob("captures/*.tif")
    reference = f'reference = "before/captures/{photograph.name}"'
    later = plan(tmp_path / "later.toml", [200.0, 260.0], reference)
    after = tmp_path / "after"
    done = command.done(*own, "--plan", later, "--out", after)
    said = [line for line in done.err.splitlines() if "against" in line]
    # The simulated stage returns to its height, and the target lies where it lay.
    assert "capture 0:" in said[0]
    assert "the same distance (zoom 1.000), turned by 0.0 degrees, aside by 0 px" in said[0]
    # From 200 to 260 mm over the simulated pupil.
    assert "further away (zoom 1." in said[1]
    results = after / "results" / "changes" / "texture-coins"
    line = read_time_line(results / "series.json")
    assert len(line.followups) == 2
    assert f"captures differ from {photograph.name}" in done.err
    command.done("report", after)
    page = Page((after / "results" / "report.html").read_text("utf-8"))
    shown = [heading for heading in page.headings if heading.startswith("Changes: changes/")]
    assert len(shown) == 2
    # Nothing is compared twice.
    command.done(*own, "--plan", later, "--out", after)


def test_a_photograph_that_is_not_there_is_told_before_anything_moves(
    command: Command, bench: Path, tmp_path: Path
) -> None:
    path = plan(tmp_path / "plan.toml", [200.0], 'reference = "gone.tif"')
    done = command("capture", "--bench", bench, "--plan", path, "--out", tmp_path / "s", "--yes")
    assert done.status == 1
    assert "gone.tif" in done.err
    assert done.err.count("\n") == 1
    assert not (tmp_path / "s").exists()


def test_poses_and_changes_among_the_results_are_in_the_report(
    command: Command, session_dir: Path
) -> None:
    results = session_dir / "results"
    results.mkdir(exist_ok=True)
    verdict = {
        "is_accepted": False,
        "criterion": "min",
        "min_dprime": 3.0,
        "curve": {
            "model": "matched",
            "observer": "npw",
            "noise_dn": 2.0,
            "contrast_dn": 10.0,
            "signal_sigma_px": 2.0,
        },
        "dprime_decisive": 2.5,
        "dprime_min": 2.5,
        "dprime_max": 4.0,
        "zoom_min": 1.0,
        "zoom_max": 1.5,
        "anisotropy_max": 1.1,
        "overlap": 0.8,
        "beyond_curve": 0.0,
        "homography": np.eye(3).tolist(),
        "warnings": ["the texture repeats"],
    }
    (results / "pose.json").write_text(json.dumps(verdict), encoding="utf-8")
    command.done("report", session_dir)
    page = Page((results / "report.html").read_text("utf-8"))
    assert "Pose: pose.json" in page.headings
    assert "Warning: the texture repeats." in page.texts
    (results / "pose.json").write_text("{}", encoding="utf-8")
    refused = command("report", session_dir)
    assert refused.status == 1
    assert "not what standoff pose --json prints" in refused.err
