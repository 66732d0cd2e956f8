import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from tests.calibration.closed_form import edge_image
from tests.standoff.conftest import Command


def test_a_photograph_of_a_vertical_edge_gives_sigma_x(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    document = command.document("calibrate", edge_file, "--out", tmp_path / "psf.json")
    assert document == json.loads((tmp_path / "psf.json").read_text())
    assert document["sigma_x_px"] == pytest.approx(0.8, rel=5e-4)
    assert document["sigma_y_px"] is None
    assert document["edges"][0]["orientation"] == "vertical"
    assert document["edges"][0]["image"] == str(edge_file)


def test_people_get_a_table_with_intervals(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    done = command.done("calibrate", edge_file, "--out", tmp_path / "psf.json")
    assert "0.8000" in done.out
    # What one edge cannot tell is said once, in one line.
    assert "sigma_y" not in done.out
    [line] = [line for line in done.err.splitlines() if "not determined" in line]
    assert "not determined by 1 edge: sigma_y, rho and the change over the frame" in line


def test_srgb_photographs_are_linearised(command: Command, tmp_path: Path) -> None:
    linear = edge_image(0.8, 5.0) / 65535.0
    # IEC 61966-2-1, the encoding this time, written out here.
    encoded = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    tifffile.imwrite(tmp_path / "srgb.tif", np.rint(encoded * 65535).astype(np.uint16))
    widths = {}
    psf = tmp_path / "p.json"
    for option in ("--srgb", "--linear"):
        widths[option] = command.document(
            "calibrate", tmp_path / "srgb.tif", option, "--out", psf, "--force"
        )["sigma_x_px"]
    assert widths["--srgb"] == pytest.approx(0.8, rel=1e-3)
    assert widths["--linear"] != pytest.approx(0.8, rel=0.02)


def test_colour_is_read_as_luma_with_a_note_and_a_channel_by_name(
    command: Command, tmp_path: Path
) -> None:
    grey = edge_image(0.8, 5.0) / 256.0
    red = edge_image(1.2, 5.0) / 256.0
    Image.fromarray(np.rint(np.dstack([red, grey, grey])).astype(np.uint8)).save(
        tmp_path / "colour.png"
    )
    psf = tmp_path / "p.json"
    luma = command("calibrate", tmp_path / "colour.png", "--linear", "--out", psf, "--json")
    assert "Rec. 601 luma" in luma.err
    only_red = command(
        f"calibrate {tmp_path / 'colour.png'} --channel red --linear "
        f"--out {tmp_path / 'red.json'} --json"
    )
    assert "Rec. 601 luma" not in only_red.err
    assert json.loads(only_red.out)["sigma_x_px"] == pytest.approx(1.2, rel=0.01)
    assert 0.8 < json.loads(luma.out)["sigma_x_px"] < 1.2


def test_a_jpeg_is_measured_with_a_remark(command: Command, tmp_path: Path) -> None:
    image = np.rint(edge_image(0.9, 5.0) / 256.0).astype(np.uint8)
    Image.fromarray(image).save(tmp_path / "edge.jpg", quality=92)
    done = command.done("calibrate", tmp_path / "edge.jpg", "--out", tmp_path / "p.json")
    assert "JPEG" in done.err


def test_a_region_leaves_out_what_lies_beside_it(command: Command, tmp_path: Path) -> None:
    psf = tmp_path / "p.json"
    both = np.hstack([edge_image(0.7, 3.0), edge_image(1.4, 183.0)])
    tifffile.imwrite(tmp_path / "both.tif", np.rint(both).astype(np.uint16))
    done = command(f"calibrate {tmp_path / 'both.tif'} --region 110,0,110,90 --out {psf} --json")
    document = json.loads(done.out)
    assert document["sigma_x_px"] == pytest.approx(1.4, rel=1e-3)
    assert document["region"] == "110,0,110,90"
    assert all(edge["x_px"] > 110 for edge in document["edges"])


@pytest.mark.slow
def test_the_report_is_one_page_without_links_to_elsewhere(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    page = tmp_path / "report.html"
    command.done("calibrate", edge_file, "--out", tmp_path / "p.json", "--report", page)
    text = page.read_text()
    assert "PSF calibration" in text
    assert 'src="http' not in text
    assert "<link" not in text


def test_a_session_is_calibrated_from_its_edge_captures(
    command: Command, session_dir: Path
) -> None:
    psf = session_dir / "results" / "psf.json"
    psf.parent.mkdir()
    document = command.document("calibrate", "--session", session_dir, "--out", psf)
    # The bench's optical widths; 160-pixel edges in 4 noisy frames are good to about 0.2 %.
    assert document["optical_sigma_x_px"] == pytest.approx(0.7, rel=0.01)
    assert document["optical_sigma_y_px"] == pytest.approx(0.6, rel=0.01)
    assert document["edges"][0]["chi2_reduced"] == pytest.approx(1.0, abs=0.3)
    assert {edge["capture"] for edge in document["edges"]} == set(range(6))


def test_what_a_correlation_may_hide_is_said_where_no_diagonal_edge_tells_it(
    command: Command, tmp_path: Path
) -> None:
    for name, lean_deg in (("leaning", 6.0), ("upright", 0.6)):
        path = tmp_path / f"{name}.tif"
        tifffile.imwrite(path, edge_image(0.8, lean_deg).astype(np.float32))
        done = command.done("calibrate", path, "--linear", "--out", tmp_path / f"{name}.json")
        # tan 6 degrees times 0.1 is 1.05 %; tan 0.6 degrees 0.1 %, not worth a word.
        assert ("off by 1.1 %" in done.err) is (name == "leaning")
