"""A study of a plan: the command prints what the function returns."""

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile

import standoff
from analysis.detectability import curves_of_images
from analysis.study import _change_errors as change_errors
from calibration.documents import json_object
from tests.standoff.asked_once import asked_once
from tests.standoff.conftest import SMALL_BENCH, Command
from tests.standoff.library.one_document import printed, without_caller

PLAN = """
schema = "standoff.plan/1"
name = "study"
heights_mm = [180.0, 280.0]

[[targets]]
kind = "edge"
target = "edge"
orientations_deg = [5.0, 50.0, 95.0, 140.0]
"""


@pytest.mark.slow
def test_plan_study(
    command: Command,
    psf_file: Path,
    noise_file: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Of equal pictures, PSF and task the curves are the same: other ones would be worked out.
    once = asked_once(curves_of_images)
    monkeypatch.setattr(change_errors, "curves_of_images", once)
    bench, plan, scene = tmp_path / "b.toml", tmp_path / "p.toml", tmp_path / "scene.tif"
    bench.write_text(SMALL_BENCH)
    plan.write_text(PLAN)
    texture = np.random.default_rng(3).integers(0, 4000, (140, 150)).astype(np.uint16)
    tifffile.imwrite(scene, texture)
    out = tmp_path / "study.json"
    files = ("--bench", bench, "--plan", plan, "--psf", psf_file, "--noise", noise_file)
    scene_words = ("--photographs", scene, "--photograph-count", 5, "--contrast", 900)
    wants = ("--want", "sigma=0.5%", "--want", "dprime=5%", "--focus-scatter", 0.01)
    more = ("--edges-per-capture", 2, "--edge-length", 60, "--levels", "200,2200")
    words = (*files, *scene_words, *wants, *more)
    done = command("plan-study", *words, "--out", out, "--json")
    found = standoff.plan_study(
        plan,
        bench,
        psf_file,
        noise=noise_file,
        photographs=[scene],
        photograph_count=5,
        contrast_dn=900.0,
        want=["sigma=0.5%", "dprime=5%"],
        focus_scatter_px2=0.01,
        edges_per_capture=2,
        edge_length_px=60,
        levels_dn=(200, 2200),
    )
    document = printed(done)
    assert document == without_caller(json_object(found))
    assert without_caller(json.loads(out.read_text())) == document
    assert document["schema"] == "standoff.study/1"
    assert (document["captures"], document["edges"], document["photographs"]) == (8, 16, 5)
    standoff.write_study(tmp_path / "again.json", found)
    assert without_caller(json.loads((tmp_path / "again.json").read_text())) == document
    assert {Path(one["path"]).name for one in document["provenance"]["inputs"]} == {
        "b.toml",
        "p.toml",
        "psf.json",
        "noise.json",
        "scene.tif",
    }
    assert "16 edges" in repr(found)
    assert found._repr_html_().startswith("<table>")
