"""What ``calibrate`` makes of maps, float files, the frame's centre, and a series out of focus."""

import csv
import json
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from calibration.documents import write_document
from calibration.edges import REJECTING_FLAGS
from calibration.errors import NoiseFileError
from calibration.noise import CorrectionMaps, NoiseCalibration, write_map_files
from simulation.arrays import FloatArray
from tests.calibration.closed_form import edge_image
from tests.calibration.edge_field import frame_of_edges
from tests.standoff.conftest import SMALL_BENCH, SMALL_PLAN, Command

DARK_DN = 100.0


def maps_beside(path: Path, response: FloatArray) -> Path:
    """A noise.json with maps of this response, and 100 DN without light."""
    maps = CorrectionMaps(
        dark_dn=np.full(response.shape, DARK_DN, np.float32),
        response=response.astype(np.float32),
        defects=np.zeros(response.shape, np.uint8),
        black_level_dn=DARK_DN,
    )
    noise = NoiseCalibration(
        gain_e_per_dn=4.0,
        read_noise_e=8.0,
        black_level_dn=DARK_DN,
        saturation_dn=65535.0,
        frames_averaged=1,
        maps=write_map_files(path, maps),
    )
    write_document(path, noise, NoiseFileError)
    return path


def test_a_photograph_is_measured_as_its_maps_leave_it(command: Command, tmp_path: Path) -> None:
    clean = edge_image(0.8, 5.0) / 2
    # From column 57 on, two beside the edge, the sensor is less sensitive by a fifth.
    response = np.where(np.arange(clean.shape[1]) < 57, 1.0, 0.8) * np.ones(clean.shape)
    path, out = tmp_path / "edge.tif", tmp_path / "psf.json"
    tifffile.imwrite(path, (clean * response + DARK_DN).astype(np.float32))
    words = ("calibrate", path, "--out", out, "--json")
    corrected = command.done(*words, "--correct", maps_beside(tmp_path / "noise.json", response))
    assert json.loads(corrected.out)["sigma_x_px"] == pytest.approx(0.8, rel=1e-3)
    spoilt = command(*words, "--force")
    assert abs(json.loads(spoilt.out)["sigma_x_px"] / 0.8 - 1) > 0.01


def test_a_pixel_that_clipped_in_the_file_counts_as_clipped_after_the_maps(
    command: Command, tmp_path: Path
) -> None:
    clipped = np.minimum(edge_image(0.8, 5.0) * 1.4, 65535.0)
    path = tmp_path / "edge.tif"
    tifffile.imwrite(path, np.rint(clipped).astype(np.uint16))
    # By a response of 2 the level of the clipped pixels falls to half of the top.
    maps = maps_beside(tmp_path / "noise.json", np.full(clipped.shape, 2.0))
    err = command.refused(1, "calibrate", path, "--out", tmp_path / "psf.json", "--correct", maps)
    assert "saturated: shorten the exposure" in err


def test_maps_of_another_camera_are_refused_by_the_photographs_name(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    maps = maps_beside(tmp_path / "noise.json", np.ones((60, 91)))
    words = ("--out", tmp_path / "psf.json", "--correct", maps)
    err = command.refused(1, "calibrate", edge_file, *words)
    problem = "an image of (90, 110) (rows, cols) does not match maps of (60, 91)"
    assert f"{edge_file}: {problem}" in err
    Image.fromarray(np.zeros((60, 91, 3), np.uint8)).save(tmp_path / "colour.png")
    err = command.refused(1, "calibrate", tmp_path / "colour.png", *words)
    assert "colour.png: a colour image, but the maps are of a grey camera" in err
    assert not (tmp_path / "psf.json").exists()


def test_a_float_file_may_be_encoded_too(command: Command, tmp_path: Path) -> None:
    linear = edge_image(0.8, 5.0) / 65535.0
    # IEC 61966-2-1, above its linear part; float files end at 1.
    encoded = 1.055 * linear ** (1 / 2.4) - 0.055
    assert encoded.min() > 0.04045
    tifffile.imwrite(tmp_path / "edge.tif", encoded.astype(np.float32))
    words = ("calibrate", tmp_path / "edge.tif", "--out", tmp_path / "psf.json", "--json")
    done = command(*words, "--srgb")
    assert json.loads(done.out)["sigma_x_px"] == pytest.approx(0.8, rel=1e-3)


def test_the_centre_is_the_middle_half_of_the_frame(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    words = ("calibrate", edge_file, "--out", tmp_path / "psf.json", "--force", "--json")
    centre = json.loads(command(*words, "--region", "centre").out)
    again = json.loads(command(*words, "--region", "center").out)
    assert again | {"provenance": None} == centre | {"provenance": None}
    # A quarter of 110 x 90 px, rounded down, is left out on either side.
    by_hand = json.loads(command(*words, "--region", "27,22,56,46").out)
    whole = json.loads(command(*words).out)
    assert centre["edges"] == by_hand["edges"] != whole["edges"]
    assert centre["region"] == "centre"


def test_the_table_names_its_columns_once(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    other, table = tmp_path / "other.tif", tmp_path / "edges.csv"
    tifffile.imwrite(other, np.rint(edge_image(0.7, 95.0)).astype(np.uint16))
    words = ("calibrate", edge_file, other, "--out", tmp_path / "psf.json", "--csv", table)
    done = command.done(*words)
    assert f", {table}" in done.out
    with table.open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["image"] for row in rows] == [str(edge_file), str(other)]
    assert [float(row["sigma_px"]) for row in rows] == pytest.approx([0.8, 0.7], rel=1e-3)


@pytest.mark.slow
def test_a_focus_that_drifts_over_the_heights_is_told(command: Command, tmp_path: Path) -> None:
    # Sharp at 300 mm; at 180 mm a lens of f/8 adds a blur of its own.
    bench = SMALL_BENCH + "focus_distance_mm = 300.0\nf_number = 8.0\n"
    plan = SMALL_PLAN.replace("[180.0, 300.0]", "[180.0, 240.0, 300.0]")
    session = command.captured(tmp_path, bench, plan)
    done = command.done("calibrate", "--session", session, "--out", tmp_path / "psf.json")
    assert "over the heights: the focus drifts" in done.err
    assert "calibrate at one height or refocus" in done.err


@pytest.mark.slow
def test_one_image_of_a_scene_is_told_to_be_a_guess(command: Command, tmp_path: Path) -> None:
    plan = SMALL_PLAN.replace('kind = "edge"', 'kind = "texture"').replace('"edge"', '"coins"')
    session = command.captured(tmp_path, SMALL_BENCH, plan)
    done = command.done(
        "calibrate", "--session", session, "--method", "single-image", "--out", tmp_path / "p.json"
    )
    assert "edges are clear enough" in done.out
    assert "the scene's own edges have a mean blur of" in done.out
    assert "--method two-distance does better" in done.err


@pytest.mark.slow
def test_the_report_of_a_corrected_session_shows_what_was_measured(
    command: Command, session_dir: Path, tmp_path: Path
) -> None:
    page, out = tmp_path / "r.html", tmp_path / "psf.json"
    # A response of 1 and a dark level that is the black level: nothing is taken off.
    maps = maps_beside(tmp_path / "noise.json", np.ones((128, 160)))
    words = ("calibrate", "--session", session_dir, "--out", out, "--json")
    plain = json.loads(command(*words).out)
    done = command.done(*words, "--correct", maps, "--report", page, "--force")
    assert json.loads(done.out)["sigma_x_px"] == pytest.approx(plain["sigma_x_px"], rel=1e-9)
    assert "<h2>From centre to corner</h2>" in page.read_text()


@pytest.mark.slow
def test_a_psf_that_changes_over_the_frame_is_told_and_stored_as_a_field(
    command: Command, tmp_path: Path
) -> None:
    paths = []
    for edge in frame_of_edges():
        paths.append(tmp_path / edge.name)
        tifffile.imwrite(paths[-1], edge.image_dn.astype(np.float32))
    done = command.done("calibrate", *paths, "--out", tmp_path / "psf.json")
    assert "the PSF changes over the frame: psf.json holds its field" in done.out
    assert json.loads((tmp_path / "psf.json").read_text())["field"] is not None


@pytest.mark.slow
def test_edges_that_are_left_out_are_counted_by_their_flags(
    command: Command, tmp_path: Path
) -> None:
    board = Path(__file__).parents[2] / "data" / "chessboards" / "left01.jpg"
    done = command("calibrate", board, "--out", tmp_path / "psf.json")
    edges = json.loads((tmp_path / "psf.json").read_text())["edges"]
    used = [edge for edge in edges if not REJECTING_FLAGS & set(edge["flags"])]
    line = next(line for line in done.out.splitlines() if "edges used" in line)
    assert line.startswith(f"{len(used)} of {len(edges)} edges used; left out: ")
    left_out = [each.split(" ", 1) for each in line.split("left out: ")[1].split(", ")]
    rejected = [REJECTING_FLAGS.intersection(edge["flags"]) for edge in edges]
    counted = Counter(" and ".join(sorted(flags)) for flags in rejected if flags)
    assert any(" and " in flags for flags in counted)
    assert {flags: int(count) for count, flags in left_out} == counted
    assert sum(int(count) for count, _ in left_out) == len(edges) - len(used)
    assert [int(count) for count, _ in left_out] == sorted(counted.values(), reverse=True)
