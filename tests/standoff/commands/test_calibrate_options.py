import csv
import json
import sys
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from calibration.edges import gaussian_mtf50
from tests.calibration.closed_form import edge_image
from tests.calibration.edges.test_image import SIGMAS, mosaic
from tests.standoff.conftest import Command


def test_the_papers_way_is_a_method(command: Command, edge_file: Path, tmp_path: Path) -> None:
    out = tmp_path / "psf.json"
    document = command.document("calibrate", edge_file, "--method", "paper", "--out", out)
    assert document["method"] == "paper"
    # sqrt(0.8^2 + 5/12 (1/4)^2), as docs/calibration.md says.
    assert document["sigma_x_px"] == pytest.approx(0.8161, rel=0.005)
    assert document["optical_sigma_x_px"] is None
    assert document["rho"] is None


def test_the_table_has_a_row_for_each_edge_with_its_contrast_by_frequency(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    table = tmp_path / "edges.csv"
    words = ("--out", tmp_path / "p.json", "--csv", table)
    [edge] = command.document("calibrate", edge_file, *words)["edges"]
    with table.open(newline="", encoding="utf-8") as file:
        [row] = csv.DictReader(file)
    assert row.keys() >= edge.keys()
    assert float(row["sigma_px"]) == edge["sigma_px"]
    assert row["is_used"] == "yes"
    assert float(row["esfr_mtf50_cy_per_px"]) == pytest.approx(gaussian_mtf50(0.8), rel=1e-3)
    for freq in (0.05, 0.25, 0.5):
        expected = np.exp(-2 * (np.pi * 0.8 * freq) ** 2)
        assert float(row[f"sfr_{freq:.2f}"]) == pytest.approx(expected, abs=2e-4)
    assert [name for name in row if name.startswith("sfr_")] == [
        f"sfr_{0.05 * k:.2f}" for k in range(1, 11)
    ]


@pytest.mark.slow
def test_a_mosaic_gives_every_colour_and_green_by_default(command: Command, tmp_path: Path) -> None:
    paths = []
    for normal in (5.0, 95.0):
        paths.append(tmp_path / f"raw{normal:g}.tif")
        tifffile.imwrite(paths[-1], np.rint(mosaic(normal).image_dn).astype(np.uint16))
    out, page = tmp_path / "psf.json", tmp_path / "r.html"
    arguments = ("--bayer", "GRBG", "--out", out, "--report", page)
    document = json.loads(command("calibrate", *paths, *arguments, "--json").out)
    assert document["channel"] == "green"
    for colour, sigma in SIGMAS.items():
        assert document["channels"][colour]["optical_sigma_x_px"] == pytest.approx(sigma, rel=0.006)
    assert document["sigma_x_px"] == document["channels"]["green"]["sigma_x_px"]
    assert "Widths by colour of the mosaic" in page.read_text()
    blue = command(
        "calibrate", *paths, "--bayer", "GRBG", "--channel", "blue", "--out", out, "--force"
    )
    assert "Colours" in blue.out
    assert json.loads(out.read_text())["optical_sigma_y_px"] == pytest.approx(0.9, rel=0.006)


def test_a_colour_photograph_is_no_mosaic(command: Command, tmp_path: Path) -> None:
    image = np.rint(edge_image(0.8, 5.0) / 256).astype(np.uint8)
    Image.fromarray(np.dstack([image] * 3)).save(tmp_path / "c.png")
    err = command.refused(
        1, "calibrate", tmp_path / "c.png", "--bayer", "RGGB", "--out", tmp_path / "p.json"
    )
    assert "c.png: a colour photograph is not a raw mosaic; leave out --bayer" in err


@pytest.mark.parametrize(
    ("option", "name"), [("--out", "r.json"), ("--report", "r.html"), ("--csv", "r.csv")]
)
def test_a_folder_that_is_not_there_is_said_before_any_work(
    command: Command, edge_file: Path, tmp_path: Path, option: str, name: str
) -> None:
    psf = tmp_path / "p.json"
    nowhere = tmp_path / "nowhere" / name
    outputs = ("--out", nowhere) if option == "--out" else ("--out", psf, option, nowhere)
    err = command.refused(1, "calibrate", edge_file, *outputs)
    assert f"cannot write {nowhere}: {nowhere.parent} is not a folder" in err
    assert not psf.exists()


@pytest.mark.slow
def test_a_pdf_is_made_where_the_extra_is_installed(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    pytest.importorskip("weasyprint")
    page = tmp_path / "report.pdf"
    command.done("calibrate", edge_file, "--out", tmp_path / "p.json", "--report", page)
    assert page.read_bytes().startswith(b"%PDF-")


def test_without_the_extra_a_pdf_is_refused_in_one_line(
    command: Command, edge_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "weasyprint", None)
    psf = tmp_path / "p.json"
    err = command.refused(
        1, "calibrate", edge_file, "--out", psf, "--report", tmp_path / "report.pdf"
    )
    assert "pip install standoff[pdf]" in err
    assert err.count("\n") == 1
    assert not psf.exists()


def test_a_region_outside_is_named_as_it_was_typed(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    err = command.refused(
        1, "calibrate", edge_file, "--region", "0,0,400,90", "--out", tmp_path / "psf.json"
    )
    assert "region 0,0,400,90 is not within" in err


def test_one_clipped_colour_rejects_the_edge_though_its_luma_is_below_the_top(
    command: Command, tmp_path: Path
) -> None:
    grey = edge_image(0.8, 5.0) / 256.0
    red = np.minimum(grey * 1.4, 255)
    image = np.rint(np.dstack([red, grey, grey])).astype(np.uint8)
    Image.fromarray(image).save(tmp_path / "c.png")
    assert image[..., 1].max() < 250
    err = command.refused(1, "calibrate", tmp_path / "c.png", "--out", tmp_path / "p.json")
    assert "saturated: shorten the exposure" in err
    green = ("--channel", "green", "--out", tmp_path / "p.json")
    command.done("calibrate", tmp_path / "c.png", *green)


def test_the_plateau_of_a_narrower_adc_is_seen_through_the_srgb_curve(
    command: Command, tmp_path: Path
) -> None:
    clipped = np.minimum(edge_image(0.8, 5.0) / 10.0, 4095.0)  # 12 bits in a 16-bit file
    tifffile.imwrite(tmp_path / "e.tif", np.rint(clipped).astype(np.uint16))
    err = command.refused(
        1, "calibrate", tmp_path / "e.tif", "--srgb", "--out", tmp_path / "p.json"
    )
    assert "saturated" in err


@pytest.mark.slow
def test_a_session_says_which_camera_and_when(
    command: Command, session_dir: Path, tmp_path: Path
) -> None:
    page, out = tmp_path / "r.html", tmp_path / "psf.json"
    document = command.document(
        "calibrate", "--session", session_dir, "--out", out, "--report", page
    )
    assert document["camera"]["serial"]
    assert document["captured_utc"].endswith("Z")
    assert document["height_trend"] is None or len(document["height_trend"]["heights"]) == 2
    text = page.read_text()
    for heading in ("Captures", "Noise", "Stage", "From centre to corner"):
        assert f"<h2>{heading}</h2>" in text
    assert "sha256" in text
