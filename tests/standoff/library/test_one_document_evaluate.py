"""An evaluation: the command prints what the function returns; limits read it."""

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile

import standoff
from calibration.documents import json_object
from tests.standoff.conftest import Command
from tests.standoff.library.one_document import printed, without_caller


@pytest.fixture
def photographs(tmp_path: Path) -> Path:
    folder = tmp_path / "photographs"
    folder.mkdir()
    rng = np.random.default_rng(1)
    for number in range(3):
        image = 300 + 3 * rng.standard_normal((150, 160))
        tifffile.imwrite(folder / f"scene-{number}.tif", image.astype(np.float32))
    return folder


def words(photographs: Path, psf_file: Path) -> tuple[object, ...]:
    return (
        *("absolute-difference", "--photographs", photographs, "--psf", psf_file),
        *("--zooms", "1,1.4", "--contrast", 25, "--pairs", 8, "--crop", 56, "--model", "matched"),
    )


@pytest.mark.slow
def test_evaluate(command: Command, psf_file: Path, photographs: Path, tmp_path: Path) -> None:
    out, report = tmp_path / "evaluation.json", tmp_path / "evaluation.html"
    done = command(
        "evaluate", *words(photographs, psf_file), "--out", out, "--report", report, "--json"
    )
    found = standoff.evaluate(
        "absolute-difference",
        photographs,
        psf_file,
        standoff.EvaluationTask(
            zooms=(1.0, 1.4), contrasts_dn=(25.0,), crops=8, crop_px=56, model="matched"
        ),
    )
    assert found.evaluation is not None
    document = printed(done)
    figures = [f"evaluation-{name}{kind}" for name in ("auc", "roc") for kind in (".png", ".svg")]
    assert [Path(one).name for one in document.pop("figures")] == figures
    assert document == without_caller(json_object(found.evaluation))
    assert without_caller(json.loads(out.read_text())) == document
    assert document["schema"] == "standoff.evaluation/1"
    assert "no score" not in done.err
    assert "AUC against zoom" in report.read_text()
    assert {Path(one["path"]).name for one in document["provenance"]["inputs"]} == {
        "psf.json",
        *(f"scene-{number}.tif" for number in range(3)),
    }
    assert found.write(tmp_path / "again.json")[0].name == "again-auc.png"
    assert without_caller(json.loads((tmp_path / "again.json").read_text())) == document
    # The same command goes on from its scores; the results of another one are not replaced.
    other = ("evaluate", *words(photographs, psf_file), "--seed", 1, "--out", out)
    assert command(*other).status == 1
    assert "<caption>AUC against zoom</caption>" in found.evaluation._repr_html_()
    limits = ("limits", "--curves", out, "--focal-length-px", 900, "--image-size", "780x580")
    allowed = command.done(*limits, "--min-dprime", 0.2)
    assert "absolute-difference" in allowed.out
    refused = command(*limits, "--min-dprime", 0.2, "--at-zoom", 1.2)
    assert refused.status == 2
    assert "evaluate it with --contrast" in refused.err


def test_a_detector_that_nobody_knows_is_refused_before_any_work(
    command: Command, psf_file: Path, photographs: Path, tmp_path: Path
) -> None:
    asked = list(words(photographs, psf_file))
    asked[0] = "my-detector"
    done = command("evaluate", *asked, "--out", tmp_path / "evaluation.json")
    assert done.status == 1
    assert "absolute-difference" in done.err
    assert not (tmp_path / "evaluation.json").exists()
