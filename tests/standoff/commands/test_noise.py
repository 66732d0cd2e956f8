import json
import re
from pathlib import Path

import numpy as np
import pytest
import tifffile

from acquisition.plan import load_plan
from calibration.errors import NoiseFileError
from calibration.files import read_correction, read_noise
from standoff.shipped_configs import shipped_config
from tests.standoff.conftest import SMALL_BENCH, Command
from tests.standoff.provenance import assert_provenance

DARK = """
[[targets]]
kind = "dark"
target = "dark"
exposure_us = [21.0, 8000.0]
"""
FLAT = """
[[targets]]
kind = "flat"
target = "flat"
exposure_us = [{exposures}]
"""
EDGE = """
[[targets]]
kind = "edge"
target = "edge"
orientations_deg = [5.0, 95.0]
"""
LADDER = "1000.0, 2000.0, 4000.0, 6000.0, 8000.0, 16000.0"


def captured(command: Command, folder: Path, *targets: str) -> Path:
    heads = 'schema = "standoff.plan/1"\nname = "n"\nheights_mm = [200.0]\nframes_per_capture = 6\n'
    return command.captured(folder, f"{SMALL_BENCH}vignetting = 0.2\n", heads + "".join(targets))


def test_the_shipped_plan_is_a_dark_and_a_ladder_of_flats() -> None:
    plan = load_plan(shipped_config("noise_plan.toml"))
    assert [target.kind for target in plan.targets] == ["dark", "flat", "flat"]
    assert len(plan.targets[1].exposure_us or ()) >= 10


@pytest.mark.slow
def test_a_session_gives_the_benchs_noise_its_maps_and_a_report(
    command: Command, tmp_path: Path
) -> None:
    session = captured(command, tmp_path, DARK, FLAT.format(exposures=LADDER), EDGE)
    out, page = tmp_path / "noise.json", tmp_path / "noise.html"
    document = command.document("noise", "--session", session, "--out", out, "--report", page)
    assert document == json.loads(out.read_text())
    assert_provenance(document, "noise", session / "journal.jsonl")
    assert document["provenance"]["created"] in page.read_text()
    # The truth of the default bench; 20 480 pixels, 6 frames: 0.3 %.
    assert document["gain_e_per_dn"] == pytest.approx(5.0, rel=0.02)
    assert document["read_noise_e"] == pytest.approx(12.0, rel=0.02)
    assert document["black_level_dn"] == pytest.approx(64.0, abs=0.05)
    assert document["saturation_dn"] == pytest.approx(4095.0, abs=1.0)
    assert document["frames_averaged"] == 10
    assert document["camera_serial"] == "SIM-1"
    assert "Photon transfer" in page.read_text()
    assert read_noise(out).gain_e_per_dn == document["gain_e_per_dn"]
    maps = read_correction(out)
    assert maps.response.shape == (128, 160)
    assert maps.response[64, 80] > 1.1 * maps.response[0, 0]  # 20 % of vignetting
    assert tifffile.imread(tmp_path / "noise_defects.tif").dtype == np.uint8

    table = command("noise", "--session", session, "--out", out, "--force").out
    assert "± at 95 %" in table
    half = f"{1.959964 * document['gain_e_per_dn_err']:.4f}"
    assert re.search(rf"gain / \(e/DN\) +│ +{document['gain_e_per_dn']:.4f} │ +{half} ", table)

    psf = tmp_path / "psf.json"
    done = command.done("calibrate", "--session", session, "--out", psf, "--correct", out, "--json")
    sigma = json.loads(done.out)["optical_sigma_x_px"]
    assert sigma == pytest.approx(0.7, rel=0.02)

    photograph = tmp_path / "edge.tif"
    capture = next(iter(sorted((session / "captures").glob("*edge*"))))
    tifffile.imwrite(photograph, tifffile.imread(capture, key=0).astype(np.float32))
    done = command.done("calibrate", photograph, "--out", psf, "--noise", out, "--force", "--json")
    assert json.loads(done.out)["edges"][0]["chi2_reduced"] is not None

    (tmp_path / "noise_flat.tif").write_bytes(b"other")
    with pytest.raises(NoiseFileError):
        read_correction(out)


@pytest.mark.parametrize(
    ("targets", "what"),
    [
        ((FLAT.format(exposures=LADDER),), "no dark capture.*lens cap"),
        ((DARK,), "no flat capture"),
        ((DARK, FLAT.format(exposures="4000.0, 20000.0, 25000.0, 30000.0")), "3 saturated"),
    ],
)
def test_a_session_that_tells_no_noise_is_refused_in_one_line(
    command: Command, tmp_path: Path, targets: tuple[str, ...], what: str
) -> None:
    session = captured(command, tmp_path, *targets)
    err = command.refused(1, "noise", "--session", session, "--out", tmp_path / "noise.json")

    assert re.search(what, err)
    assert err.count("\n") == 1
    assert not (tmp_path / "noise.json").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("darks", "ladder", "row", "is_there"),
    [
        ("21.0, 8000.0", LADDER, "not reached", False),
        ("21.0", "1000.0, 2000.0, 4000.0, 6000.0", "not reached", True),
        ("21.0, 8000.0", LADDER, "dark current", False),
        ("21.0, 4000.0, 8000.0", LADDER, "dark current", True),
        ("21.0", LADDER, "linearity error", True),
        ("21.0", "200.0, 400.0, 4000.0", "linearity error", False),  # 60 and 120 DN of 4031
    ],
)
def test_the_table_shows_what_the_captures_tell(
    command: Command, tmp_path: Path, darks: str, ladder: str, row: str, is_there: bool
) -> None:
    dark = DARK.replace("21.0, 8000.0", darks)
    session = captured(command, tmp_path, dark, FLAT.format(exposures=ladder))
    done = command.done("noise", "--session", session, "--out", tmp_path / "noise.json")
    assert "Noise at 0 dB" in done.out
    assert (row in done.out) is is_there
    count = (len(darks.split(",")), len(ladder.split(",")))
    assert "{} dark and {} flat captures, fitted from".format(*count) in done.out
    written = f"wrote {tmp_path}/noise.json, noise_dark.tif, noise_flat.tif, noise_defects.tif\n"
    assert done.out.endswith(written)
    assert ("no flat saturates" in done.err) is (ladder != LADDER)


@pytest.mark.slow
def test_a_report_is_named_beside_the_maps(command: Command, tmp_path: Path) -> None:
    session = captured(command, tmp_path, DARK, FLAT.format(exposures=LADDER))
    out, page = tmp_path / "noise.json", tmp_path / "noise.html"
    done = command("noise", "--session", session, "--out", out, "--report", page)
    assert done.out.endswith(f"noise_defects.tif and {page}\n")
    assert "Photon transfer" in page.read_text()
