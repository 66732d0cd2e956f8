"""Files as cameras write them: raw mosaics to be calibrated, Exif that results keep."""

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from acquisition.session import Session
from tests.acquisition.photographs.made import CELLS, Dng
from tests.calibration.closed_form import edge_image
from tests.standoff.conftest import Command
from tests.standoff.provenance import assert_provenance

SHAPE = (600, 640)
EXIF = {0x010F: "Maker", 0x0110: "Maker Model 1", 0x0112: 6}
EXIF_OF_TAKING = {0x829A: 1 / 160, 0x829D: 5.6, 0x920A: 50.0, 0xA434: "50 mm f/1.4"}


def photograph(path: Path) -> None:
    tags = Image.Exif()
    for number, value in EXIF.items():
        tags[number] = value
    for number, value in EXIF_OF_TAKING.items():
        tags.get_ifd(0x8769)[number] = value
    edge = edge_image(0.8, 5.0, shape=SHAPE, low_dn=30, high_dn=220)
    noise = np.random.default_rng(1).normal(0, 1.0, SHAPE)
    levels = np.clip(np.rint(edge + noise), 0, 255).astype(np.uint8)
    Image.fromarray(levels).save(path, quality=95, exif=tags)


@pytest.mark.slow
@pytest.mark.parametrize("pattern", CELLS)
def test_a_raw_mosaic_has_a_psf_for_each_colour(
    command: Command, tmp_path: Path, pattern: str
) -> None:
    pytest.importorskip("rawpy")
    raw, out = tmp_path / "edge.dng", tmp_path / "psf.json"
    edge = edge_image(0.8, 5.0, shape=SHAPE, low_dn=264, high_dn=3364)
    raw.write_bytes(Dng(levels=np.rint(edge).astype(np.uint16), cells=CELLS[pattern]).to_bytes())
    document = command.document("calibrate", raw, "--out", out, "--report", tmp_path / "r.html")
    assert_provenance(document, "calibrate", raw)
    assert set(document["channels"]) == {"red", "green", "blue"}
    for colour in document["channels"].values():
        assert colour["sigma_x_px"] == pytest.approx(0.8, rel=0.005)
    assert document["channel"] == "green"
    red = json.loads(
        command("calibrate", raw, "--channel", "red", "--out", out, "--force", "--json").out
    )
    assert red["channel"] == "red"


def test_other_commands_ask_for_a_developed_image(
    command: Command, psf_file: Path, tmp_path: Path
) -> None:
    pytest.importorskip("rawpy")
    raw = tmp_path / "edge.dng"
    raw.write_bytes(Dng(levels=np.full((64, 96), 900, np.uint16)).to_bytes())
    asked = ("simulate", raw, "--zoom", 2, "--psf", psf_file, "--out", tmp_path / "far.tif")
    done = command(*asked)
    assert (done.status, done.err.count("\n")) == (1, 1)
    assert "edge.dng" in done.err
    assert "linear TIFF" in done.err


@pytest.mark.slow
def test_what_the_camera_wrote_is_in_the_result_and_its_report(
    command: Command, tmp_path: Path
) -> None:
    image, page = tmp_path / "edge.jpg", tmp_path / "r.html"
    photograph(image)
    done = command.done(
        "calibrate", image, "--linear", "--out", tmp_path / "p.json", "--report", page, "--json"
    )
    assert json.loads(done.out)["photograph"] == {
        "camera": "Maker Model 1",
        "lens": "50 mm f/1.4",
        "focal_length_mm": 50.0,
        "f_number": pytest.approx(5.6),
        "exposure_s": pytest.approx(1 / 160),
    }
    text = page.read_text()
    assert "Maker Model 1" in text
    assert "50 mm f/1.4" in text
    assert "turned by 90 degrees clockwise" in done.err
    # Not turned: the edge is vertical in the sensor's own axes.
    assert json.loads(done.out)["edges"][0]["orientation"] == "vertical"


def test_an_import_keeps_camera_lens_and_exposure(command: Command, tmp_path: Path) -> None:
    photograph(tmp_path / "edge.jpg")
    out = tmp_path / "session"
    done = command.done(
        "import", tmp_path / "edge.jpg", "--kind", "edge", "--height-mm", 100, "--out", out
    )
    session = Session(out)
    assert session.records[0].exposure_us == pytest.approx(6250.0)
    assert session.devices["camera"]["DeviceModelName"] == "Maker Model 1"
    assert session.devices["lens"] == {
        "lens": "50 mm f/1.4",
        "focal_length_mm": 50.0,
        "f_number": pytest.approx(5.6),
    }
    assert "levels taken as srgb" in done.err
