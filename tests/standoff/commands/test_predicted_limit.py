"""``detectability --observer changes`` and ``changes --curves``: one limit by two roads."""

import json
from pathlib import Path
from typing import Any

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
    done = command("detectability", pair[1], "--psf", pair[0], *asked, *sizes, "--out", out)
    assert done.status == 0, done.err
    return out


def compared(
    command: Command, pair: tuple[Path, Path, Path], curves: Path, out: Path, *more: object
) -> dict[str, Any]:
    words = ("changes", *pair[1:], "--psf", pair[0], "--curves", curves, *more)
    done = command(*words, "--out", out, "--json")
    assert done.status == 0, done.err
    document: dict[str, Any] = json.loads(done.out)
    return document


def test_a_comparison_says_how_its_limit_and_the_predicted_one_compare(
    command: Command, pair: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    curves = predicted(command, pair, tmp_path / "curves.json")
    document = compared(command, pair, curves, tmp_path / "out")
    assert_provenance(document, "changes", pair[1], pair[2], pair[0], curves)
    limit = document["detection_limit"]["predicted"]
    assert limit["ratio"] == pytest.approx(limit["shown_dn"] / limit["median_dn"])
    assert set(limit["factors"]) == {"focus", "light", "registration", "texture"}
    told = command(
        *("changes", *pair[1:], "--psf", pair[0], "--curves", curves, "--out", tmp_path / "again")
    )
    assert "DN were predicted" in told.out
    assert "DN were predicted" in (tmp_path / "again" / "report.html").read_text()


def test_one_of_several_curves_is_chosen_by_its_noise(
    command: Command, pair: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    curves = predicted(command, pair, tmp_path / "curves.json", noise="1,2")
    words = ("changes", *pair[1:], "--curves", curves, "--out", tmp_path / "out")
    refused = command(*words)
    assert refused.status == 2
    assert "choose by --curve-noise (1.0, 2.0)" in refused.err
    document = compared(command, pair, curves, tmp_path / "out", "--curve-noise", 2)
    assert document["detection_limit"]["predicted"]["noise_dn"] == 2.0


def test_a_zoom_beyond_the_curve_is_said(
    command: Command, pair: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    curves = predicted(command, pair, tmp_path / "curves.json", zooms="1,1.05")
    words = ("changes", *pair[1:], "--psf", pair[0], "--curves", curves)
    done = command(*words, "--out", tmp_path / "out")
    assert done.status == 0, done.err
    assert "the curves say nothing of zoom" in done.err


def test_curves_of_another_observer_are_refused(
    command: Command, pair: tuple[Path, Path, Path], tmp_path: Path
) -> None:
    words = ("--observer", "npw", "--model", "bicubic", "--zooms", "1,1.5", "--noise", "2")
    made = command("detectability", pair[1], *words, "--out", tmp_path / "curves.json")
    assert made.status == 0, made.err
    asked = ("changes", *pair[1:], "--curves", tmp_path / "curves.json")
    refused = command(*asked, "--out", tmp_path / "out")
    assert refused.status == 2
    assert "--observer changes" in refused.err
