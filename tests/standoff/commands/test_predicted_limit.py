"""``detectability --observer changes`` and ``changes --curves``: one limit by two roads."""

import json
from pathlib import Path

import pytest

from tests.standoff.changed_photographs import changed_pair, write_levels, write_psf
from tests.standoff.conftest import Command
from tests.standoff.provenance import assert_provenance

pytestmark = pytest.mark.slow


@pytest.fixture
def pair(tmp_path: Path) -> tuple[Path, Path, Path]:
    """A PSF, a reference, and a follow-up in which nothing changed."""
    made = changed_pair(2, 0.0)
    return (
        write_psf(tmp_path / "psf.json"),
        write_levels(tmp_path / "near.tif", made.reference),
        write_levels(tmp_path / "far.tif", made.followup),
    )


def predicted(
    command: Command, pair: tuple[Path, Path, Path], out: Path, noise: str = "2", zooms: str = "1,2"
) -> Path:
    asked = ("--observer", "changes", "--model", "matched", "--reference-zoom", "1")
    sizes = ("--zooms", zooms, "--window", "25", "--noise", noise)
    command.done("detectability", pair[1], "--psf", pair[0], *asked, *sizes, "--out", out)
    return out


def test_a_comparison_says_how_its_limit_compares_with_the_predicted_one_of_its_noise(
    command: Command, pair: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    curves, out = predicted(command, pair, tmp_path / "curves.json", noise="1,2"), tmp_path / "out"
    words = ("changes", *pair[1:], "--psf", pair[0], "--curves", curves, "--out", out)
    assert "choose one with --curve-noise (1.0, 2.0)" in command.refused(2, *words)
    told = command.done(*words, "--curve-noise", 2)
    document = json.loads((out / "changes.json").read_text())
    assert_provenance(document, "changes", pair[1], pair[2], pair[0], curves)
    limit = document["detection_limit"]["predicted"]
    assert limit["noise_dn"] == 2.0
    assert limit["ratio"] == pytest.approx(limit["shown_dn"] / limit["median_dn"])
    assert set(limit["factors"]) == {"focus", "light", "registration", "texture"}
    assert "DN were predicted" in told.out
    assert "DN were predicted" in (out / "report.html").read_text()


def test_a_zoom_beyond_the_curve_is_said(
    command: Command, pair: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    curves = predicted(command, pair, tmp_path / "curves.json", zooms="1,1.05")
    words = ("changes", *pair[1:], "--psf", pair[0], "--curves", curves)
    done = command.done(*words, "--out", tmp_path / "out")
    assert "the curves do not cover zoom" in done.err


def test_curves_of_another_observer_are_refused(
    command: Command, pair: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    words = ("--observer", "npw", "--model", "bicubic", "--zooms", "1,1.5", "--noise", "2")
    command.done("detectability", pair[1], *words, "--out", tmp_path / "curves.json")
    asked = ("changes", *pair[1:], "--curves", tmp_path / "curves.json")
    assert "--observer changes" in command.refused(2, *asked, "--out", tmp_path / "out")
