import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from tests.standoff.changed_photographs import changed_pair, write_levels, write_psf
from tests.standoff.conftest import Command
from tests.standoff.provenance import assert_provenance

pytestmark = pytest.mark.slow


@pytest.fixture
def psf_file(tmp_path: Path) -> Path:
    return write_psf(tmp_path / "psf.json")


def test_changes_are_registered_found_and_written(
    command: Command, psf_file: Path, tmp_path: Path
) -> None:
    one = pair(2, 25.0)
    for name, image in (("near", one.reference), ("far", one.followup)):
        tifffile.imwrite(tmp_path / f"{name}.tif", image.astype(np.float32))
    noise = tmp_path / "noise.json"
    noise.write_text(
        '{"schema": "standoff.noise/1", "gain_e_per_dn": 60.0, "read_noise_e": 10.0,'
        ' "black_level_dn": 0.0, "frames_averaged": 1}'
    )
    out = tmp_path / "out"
    asked = ("changes", tmp_path / "near.tif", tmp_path / "far.tif", "--psf", psf_file)
    done = command(*asked, "--noise", noise, "--out", out, "--json")
    assert done.status == 0, done.err
    document = json.loads(done.out)
    assert document["zoom"] == pytest.approx(1.5, abs=0.005)
    # The scene was photographed through no lens at all.
    assert document["distortion_k1"] == pytest.approx(0.0, abs=4 * document["distortion_k1_err"])
    images = (tmp_path / "near.tif", tmp_path / "far.tif")
    assert_provenance(document, "changes", *images, psf_file, noise)
    told = command(*asked, "--noise", noise, "--out", tmp_path / "again")
    assert told.out.startswith(
        f"{document['changed_px']} of {document['compared_px']} pixels changed by more than "
    )
    assert told.out.endswith(f"wrote {tmp_path / 'again'}\n")
    mask = np.asarray(Image.open(out / "changes.png")) > 0
    assert mask.sum() == document["changed_px"]
    core = one.truth > 0.5 * one.truth.max()
    assert mask[core].mean() > 0.95
    assert not mask[one.truth < 1e-3 * one.truth.max()].any()
    assert sorted(path.name for path in out.iterdir()) == [
        *("changes-figure.png", "changes.json", "changes.png", "compared.png"),
        *("difference.tif", "plain-difference.tif", "pose-difference.tif"),
        *("significance.tif", "uncertainty.tif"),
    ]


def test_a_follow_up_of_something_else_is_one_line(
    command: Command, psf_file: Path, tmp_path: Path
) -> None:
    rng = np.random.default_rng(0)
    for name in ("near", "far"):
        tifffile.imwrite(
            tmp_path / f"{name}.tif", rng.normal(100, 9, (120, 150)).astype(np.float32)
        )
    done = command(
        *("changes", tmp_path / "near.tif", tmp_path / "far.tif"),
        *("--psf", psf_file, "--out", tmp_path / "out"),
    )
    assert done.status == 1
    assert "far.tif: " in done.err
    assert done.err.count("\n") == 1
    assert not (tmp_path / "out").exists()
