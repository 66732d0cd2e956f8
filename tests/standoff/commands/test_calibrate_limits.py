import json
import re
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.analysis.html_page import Page
from tests.calibration.closed_form import edge_image
from tests.calibration.edges.test_image import mosaic
from tests.standoff.conftest import Command


@pytest.fixture
def limits_file(tmp_path: Path) -> Path:
    path = tmp_path / "limits.toml"
    path.write_text("[mtf50]\nmin_cy_per_px = 0.2\n\n[sigma]\nmax_px = 0.7\n")
    return path


def test_the_terminal_prints_an_edges_mtf50_in_every_unit_with_its_error(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    out = tmp_path / "psf.json"
    done = command.done("calibrate", edge_file, "--out", out, "--pixel-pitch-um", "5")
    document = json.loads(out.read_text())
    [edge] = document["edges"]
    rows = document["picture_height_px"]
    value = edge["esfr_mtf50_cy_per_px"]
    lines = {
        cells[1].strip(): cells[2].strip()
        for cells in (line.split("│") for line in done.out.splitlines())
        if len(cells) == 4
    }
    reach = 1.959964 * edge["esfr_mtf50_err_cy_per_px"]
    for unit, factor in (("cy/px", 1.0), ("LW/PH", 2.0 * rows), ("lp/mm", 200.0)):
        printed, within = map(float, lines[f"MTF50 / ({unit})"].split(" ± "))
        assert printed == pytest.approx(factor * value, rel=1e-3)
        assert within == pytest.approx(factor * reach, rel=0.5)  # one digit of it
    assert float(lines["sigma / px"].split(" ± ")[0]) == pytest.approx(0.8, abs=2e-4)
    assert "optical sigma / px" in lines
    assert f"picture height (PH) {rows} px" in done.out
    assert "pixel pitch 5 µm (--pixel-pitch-um)" in done.out
    assert document["pixel_pitch_um"] == 5.0
    assert edge["mtf50_lp_per_mm"] == pytest.approx(200 * edge["mtf50_cy_per_px"])
    assert edge["mtf50_err_cy_per_px"] > 0


def test_without_a_pixel_pitch_it_says_how_to_give_it(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    done = command("calibrate", edge_file, "--out", tmp_path / "p.json")
    assert "lp/mm)" not in done.out
    assert "pixel pitch unknown, so no lp/mm: give --pixel-pitch-um" in done.out
    document = json.loads((tmp_path / "p.json").read_text())
    assert document["pixel_pitch_um"] is None
    assert document["edges"][0]["mtf50_lp_per_mm"] is None


def test_the_pixel_pitch_comes_from_exif_and_the_command_line_overrides_it(
    command: Command, tmp_path: Path
) -> None:
    exif = Image.Exif()
    exif[0x010F] = "Canon"
    # 25.4 mm / 4000 pixels an inch.
    exif.get_ifd(0x8769).update({0xA20E: 4000.0, 0xA210: 2, 0x829D: 2.8})
    grey = np.rint(edge_image(0.8, 5.0) / 256.0).astype(np.uint8)
    Image.fromarray(grey).save(tmp_path / "e.png", exif=exif)
    arguments = (
        "calibrate",
        tmp_path / "e.png",
        "--linear",
        "--out",
        tmp_path / "p.json",
        "--json",
    )
    stated = json.loads(command(*arguments).out)
    assert stated["pixel_pitch_um"] == pytest.approx(6.35)
    assert stated["pixel_pitch_from"] == "EXIF"
    given = json.loads(command(*arguments, "--pixel-pitch-um", "3 um", "--force").out)
    assert (given["pixel_pitch_um"], given["pixel_pitch_from"]) == (3.0, "--pixel-pitch-um")


@pytest.mark.slow
def test_the_pixel_pitch_of_a_session_is_that_of_its_bench_file(
    command: Command, session_dir: Path, tmp_path: Path
) -> None:
    page = tmp_path / "r.html"
    arguments = ("calibrate", "--session", session_dir, "--out", tmp_path / "p.json")
    document = json.loads(command(*arguments, "--report", page, "--json").out)
    assert (document["pixel_pitch_um"], document["pixel_pitch_from"]) == (8.3, "the bench file")
    texts = Page(page.read_text()).texts
    assert "8.3 µm (the bench file)" in texts
    assert "1/83 s" in texts  # 12000 us


def test_many_edges_are_listed_by_their_ends_with_the_way_to_all(
    command: Command, tmp_path: Path
) -> None:
    rows = [
        np.hstack([edge_image(0.7 + 0.01 * (4 * k + i), 5.0) for i in range(4)]) for k in range(4)
    ]
    squares = np.vstack(rows) / 256.0
    Image.fromarray(np.rint(squares).astype(np.uint8)).save(tmp_path / "many.png")
    done = command.done(
        "calibrate", tmp_path / "many.png", "--linear", "--out", tmp_path / "p.json"
    )
    used = json.loads((tmp_path / "p.json").read_text())["edges"]
    assert len(used) > 12
    assert "The 5 softest and 5 sharpest edges" in done.out
    listed = re.findall(r"│ \(\d+, \d+\)", done.out)
    assert len(listed) == 10
    assert "--csv" in done.out


def test_a_verdict_is_printed_and_stored_and_the_exit_status_stays_0(
    command: Command, edge_file: Path, limits_file: Path, tmp_path: Path
) -> None:
    out = tmp_path / "psf.json"
    done = command.done("calibrate", edge_file, "--out", out, "--limits", limits_file)
    assert f"Verdict by {limits_file}: fail" in done.out
    verdict = json.loads(out.read_text())["verdict"]
    assert verdict["outcome"] == "fail"
    by_limit = {one["limit"]: one for one in verdict["limits"]}
    # MTF50 of a Gaussian of 0.8 px is 0.234 cy/px.
    assert by_limit["mtf50.min_cy_per_px"]["outcome"] == "pass"
    assert by_limit["mtf50.min_cy_per_px"]["value"] == pytest.approx(0.2342, abs=1e-3)
    assert by_limit["sigma.max_px"]["outcome"] == "fail"
    assert by_limit["sigma.max_px"]["low"] <= 0.8 <= by_limit["sigma.max_px"]["high"] + 1e-4
    inputs = json.loads(out.read_text())["provenance"]["inputs"]
    assert str(limits_file) in [one["path"] for one in inputs]


def test_without_limits_the_verdict_is_null(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    document = json.loads(
        command("calibrate", edge_file, "--out", tmp_path / "p.json", "--json").out
    )
    assert document["verdict"] is None


def test_a_limits_file_at_fault_is_named_before_anything_is_measured(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    limits = tmp_path / "limits.toml"
    limits.write_text("[mtf50]\nminimum_cy_per_px = 0.2\n")
    out = tmp_path / "p.json"
    err = command.refused(1, "calibrate", edge_file, "--out", out, "--limits", limits)
    assert "unknown key mtf50.minimum_cy_per_px; did you mean mtf50.min_cy_per_px?" in err
    assert not out.exists()
    command.refused(
        2, "calibrate", edge_file, "--method", "single-image", "--out", out, "--limits", limits
    )


def test_the_report_has_every_warning_of_the_terminal_and_numbers_its_figures(
    command: Command, limits_file: Path, tmp_path: Path
) -> None:
    grey = np.rint(edge_image(0.9, 5.0) / 256.0).astype(np.uint8)
    Image.fromarray(np.dstack([grey] * 3)).save(tmp_path / "edge.jpg", quality=92)
    page = tmp_path / "r.html"
    done = command.done(
        f"calibrate {tmp_path / 'edge.jpg'} --out {tmp_path / 'p.json'} --report {page} "
        f"--limits {limits_file}"
    )
    texts = Page(page.read_text()).texts
    notes = [line.removeprefix("note: ") for line in done.err.splitlines()]
    assert len(notes) >= 4  # colour, JPEG, what one edge cannot tell, encoding
    for text in notes:
        assert text in texts
    numbers = re.findall(r"<figcaption>Figure (\d+): ", page.read_text())
    assert numbers == [str(k + 1) for k in range(len(numbers))]
    assert len(numbers) >= 4
    assert "fail" in texts
    [edge] = json.loads((tmp_path / "p.json").read_text())["edges"]
    assert f"{edge['esfr_mtf50_cy_per_px']:.3f} cy/px" in texts


def test_a_colour_file_has_its_lateral_colour_in_json_and_report(
    command: Command, tmp_path: Path
) -> None:
    def moved(shift_px: float) -> np.ndarray:
        return edge_image(0.8, 5.0, offset_px=shift_px) / 256.0

    planes = np.dstack([moved(0.6), moved(0.3), moved(0.1)])
    Image.fromarray(np.rint(planes).astype(np.uint8)).save(tmp_path / "c.png")
    page = tmp_path / "r.html"
    done = command(
        "calibrate", tmp_path / "c.png", "--linear", "--out", tmp_path / "p.json",
        "--report", page, "--json",
    )  # fmt: skip
    [edge] = json.loads(done.out)["edges"]
    # 8-bit rounding: some 0.002 px.
    assert abs(edge["red_shift_px"]) == pytest.approx(0.3, abs=0.01)
    assert abs(edge["blue_shift_px"]) == pytest.approx(0.2, abs=0.01)
    assert edge["red_shift_px"] * edge["blue_shift_px"] < 0
    assert "Lateral colour" in Page(page.read_text()).headings


@pytest.mark.slow
def test_a_mosaic_has_lateral_colour_too(command: Command, tmp_path: Path) -> None:
    import tifffile

    path = tmp_path / "raw.tif"
    tifffile.imwrite(path, np.rint(mosaic(5.0).image_dn).astype(np.uint16))
    done = command("calibrate", path, "--bayer", "GRBG", "--out", tmp_path / "p.json", "--json")
    for edge in json.loads(done.out)["edges"]:
        # All colours of this mosaic have their edge in one place.
        assert edge["red_shift_px"] == pytest.approx(0.0, abs=0.01)
        assert edge["blue_shift_px"] == pytest.approx(0.0, abs=0.01)
