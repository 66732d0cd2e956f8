"""``standoff lens``: one report, one table and one document of a lens and its camera."""

import csv
import json
from pathlib import Path

import numpy as np
import pytest
import tifffile

import standoff
from benchmarks.studies.siemens_star import edges_beside
from benchmarks.truth.dead_leaves import Print, dead_leaves, photograph
from benchmarks.truth.focus_scenes import FocusedLens, chart, squares
from benchmarks.truth.siemens_stars import Star
from calibration.errors import CalibrationError
from standoff.errors import ArgumentError
from tests.analysis.html_page import Page
from tests.calibration.closed_form import edge_image
from tests.standoff.conftest import SMALL_BENCH, Command

PLAN = """
schema = "standoff.plan/1"
name = "lens"
heights_mm = [200.0]
frames_per_capture = 4

[[targets]]
kind = "edge"
target = "edge"
orientations_deg = [5.0, 50.0, 95.0]
"""
NOISE = """
[[targets]]
kind = "dark"
target = "dark"
exposure_us = [21.0, 8000.0]

[[targets]]
kind = "flat"
target = "flat"
exposure_us = [1000.0, 2000.0, 4000.0, 6000.0, 8000.0, 16000.0]
"""


def frames(folder: Path, electrons: float, seed: int, count: int = 6) -> Path:
    """Frames of a sensor of 4 e/DN with a read noise of 6 e."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(seed)
    for number in range(count):
        light = rng.poisson(electrons, (60, 80)) + rng.normal(0, 6.0, (60, 80))
        tifffile.imwrite(folder / f"{number}.tif", np.round(50 + light / 4).astype(np.uint16))
    return folder


@pytest.mark.slow
def test_a_session_gives_everything_on_one_page(command: Command, tmp_path: Path) -> None:
    session = command.captured(tmp_path, f"{SMALL_BENCH}read_noise_e = 14.0\n", PLAN + NOISE)
    out = tmp_path / "lens.html"
    said = command.done("lens", "--session", session, "--out", out)
    assert "EMVA 1288: read noise 1" in said.out
    document = json.loads((tmp_path / "lens.json").read_text("utf-8"))
    assert document["noise"]["read_noise_e"] == pytest.approx(14.0, rel=0.02)
    operator = standoff.Session(session).manifest.operator
    assert operator
    assert document["labels"]["operator"] == operator
    assert document["capacity"]["noise_from"] == "darks and flats"
    assert not document["sharpening"]["is_sharpened"]
    assert [one["path"] for one in document["provenance"]["inputs"]]
    page = Page(out.read_text("utf-8"))
    assert "EMVA 1288 data sheet, linear model" in page.headings
    with (tmp_path / "lens.csv").open(encoding="utf-8", newline="") as table:
        rows = list(csv.DictReader(table))
    gains = [row for row in rows if row["figure"] == "gain_e_per_dn"]
    assert float(gains[0]["value"]) == document["noise"]["gain_e_per_dn"]
    assert gains[0]["unit"] == "e/DN"


@pytest.mark.slow
def test_limits_take_the_figures_of_the_camera(
    command: Command, edge_file: Path, noise_file: Path, tmp_path: Path
) -> None:
    limits = tmp_path / "limits.toml"
    limits.write_text(
        "[sharpening]\nmax_overshoot = 0.05\n\n[camera]\nmin_information_bits_per_px = 60\n"
        "max_prnu = 0.02\n"
    )
    lens = standoff.measure_lens(edge_file, noise=noise_file, limits=limits)
    assert lens.verdict is not None
    outcomes = {one.limit: one.outcome for one in lens.verdict.limits}
    assert outcomes == {
        "sharpening.max_overshoot": "pass",
        "camera.min_information_bits_per_px": "fail",
        "camera.max_prnu": "unsure",  # a noise.json has no frames
    }
    command.done("lens", edge_file, "--limits", limits, "--out", tmp_path / "lens.html")
    assert "FAIL" in Page((tmp_path / "lens.html").read_text("utf-8")).text.upper()


@pytest.mark.slow
def test_frames_of_ones_own_give_the_data_sheet(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    dark = frames(tmp_path / "dark", 0.0, 1)
    flats = [
        frames(tmp_path / f"flat-{e}", e, seed)
        for seed, e in enumerate((1500, 4000, 8000, 12000), 2)
    ]
    out = tmp_path / "lens.html"
    words = [word for flat in flats for word in ("--flat", flat)]
    command.done("lens", edge_file, "--dark", dark, *words, "--out", out)
    document = json.loads((tmp_path / "lens.json").read_text("utf-8"))
    assert document["noise"]["gain_e_per_dn"] == pytest.approx(4.0, rel=0.05)
    assert document["noise"]["read_noise_e"] == pytest.approx(6.0, rel=0.1)
    page = Page(out.read_text("utf-8"))
    assert any("so saturation is taken from the pixel format" in text for text in page.texts)


@pytest.mark.slow
def test_darks_and_flats_are_listed_with_the_photographs(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    dark, *flats = (
        frames(tmp_path / f"light-{e}", e, seed)
        for seed, e in enumerate((0.0, 1500.0, 6000.0, 12000.0))
    )
    out = tmp_path / "lens.html"
    words = [word for flat in flats for word in ("--flat", flat)]
    command.done("lens", edge_file, "--dark", dark, *words, "--out", out)
    document = json.loads((tmp_path / "lens.json").read_text("utf-8"))
    listed = {Path(one["path"]) for one in document["provenance"]["inputs"]}
    given = {file for folder in (dark, *flats) for file in folder.glob("*.tif")}
    assert listed == given | {edge_file}
    sheet = {(one["figure"], one["unit"]): one for one in document["emva"]}
    assert sheet["threshold", "e"]["value"] == pytest.approx(6.5, rel=0.1)
    assert sheet["dynamic_range", "dB"]["err"] is None  # no flat is saturated


@pytest.mark.slow
def test_a_session_with_too_few_flats_is_reported_without_them(
    command: Command, tmp_path: Path
) -> None:
    few = NOISE.replace("[21.0, 8000.0]", "[21.0]").replace(
        "[1000.0, 2000.0, 4000.0, 6000.0, 8000.0, 16000.0]", "[4000.0]"
    )
    session = command.captured(tmp_path, SMALL_BENCH, PLAN + few)
    found = standoff.measure_lens(standoff.Session(session))
    assert found.noise is None
    assert found.emva == ()
    assert any("darks and flats are not used: " in note for note in found.notes)
    assert found.main.edges > 0


@pytest.mark.slow
def test_the_read_noise_of_a_noise_json_is_judged(edge_file: Path, tmp_path: Path) -> None:
    limits, noise = tmp_path / "limits.toml", tmp_path / "noise.json"
    limits.write_text("[camera]\nmax_read_noise_e = 9\nmax_prnu = 0.02\n")
    noise.write_text(
        '{"schema": "standoff.noise/1", "gain_e_per_dn": 4.0, "gain_e_per_dn_err": 0.01,'
        ' "read_noise_e": 8.0, "read_noise_e_err": 0.1, "black_level_dn": 0.0,'
        ' "frames_averaged": 1}'
    )
    lens = standoff.measure_lens(edge_file, noise=noise, limits=limits)
    assert lens.verdict is not None
    read, prnu = lens.verdict.limits
    assert (read.outcome, read.value) == ("pass", 8.0)
    assert prnu.outcome == "unsure"
    assert "give --dark and --flat" in (prnu.reason or "")


def test_results_that_are_there_already_are_kept(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    (tmp_path / "lens.csv").write_text("mine")
    done = command("lens", edge_file, "--out", tmp_path / "lens.html")
    assert done.status != 0
    assert "lens.csv" in done.err
    assert (tmp_path / "lens.csv").read_text() == "mine"
    assert not (tmp_path / "lens.html").exists()


def test_colours_are_measured_in_one_run(tmp_path: Path) -> None:
    grey = tifffile.imread(Path(__file__).parents[2] / "data" / "edges" / "v_edge.tif")
    lens = standoff.measure_lens([grey, grey.copy()])
    assert [one.colour for one in lens.colours] == ["luma", "red", "green", "blue"]
    assert {edge.colour for edge in lens.edges} == {"luma", "red", "green", "blue"}
    assert {one.colour for one in lens.lateral_colour} == {"red", "blue"}
    said = [note for note in lens.notes if "Rec. 601 luma" in note]
    assert len(said) == 1
    alone = standoff.calibrate_psf(grey, channel="red")
    red = sorted(
        edge.figures.mtf50_cy_per_px.value
        for edge in lens.edges
        if edge.colour == "red" and edge.figures.mtf50_cy_per_px is not None
    )
    assert red[::2] == pytest.approx(
        sorted(edge.esfr_mtf50_cy_per_px or 0.0 for edge in alone.edges_used), rel=1e-6
    )


def test_a_grey_photograph_stored_as_colour_has_one_colour(edge_file: Path) -> None:
    grey = tifffile.imread(edge_file)
    lens = standoff.measure_lens(np.repeat(grey[:, :, np.newaxis], 3, axis=2))
    assert [one.colour for one in lens.colours] == ["grey"]
    assert lens.lateral_colour == ()


def test_a_raw_mosaic_has_three_colours_and_no_quanta(tmp_path: Path) -> None:
    images = [edge_image(0.9, normal, shape=(260, 260)) for normal in (7.0, 97.0)]
    page = tmp_path / "lens.html"
    lens = standoff.measure_lens(images, bayer="RGGB", report=page)
    assert "its own Nyquist frequency is 0.25 cy/px" in Page(page.read_text("utf-8")).text
    assert [one.colour for one in lens.colours] == ["green", "red", "blue"]
    assert lens.capacity is None
    assert any("no noise-equivalent quanta for raw mosaics" in note for note in lens.notes)


def test_noise_and_frames_exclude_each_other(edge_file: Path, noise_file: Path) -> None:
    with pytest.raises(ArgumentError, match="give either noise or darks"):
        standoff.measure_lens(edge_file, darks=["a"], flats=["b"], noise=noise_file)
    with pytest.raises(ArgumentError, match="expected a noise calibration"):
        standoff.measure_lens(
            edge_file,
            noise=standoff.CaptureNoise(gain_e_per_dn=4, read_noise_e=6, black_level_dn=50),
        )


FOCUS_MM = tuple(np.round(np.linspace(-0.2, 0.2, 9), 3).tolist())


@pytest.fixture(scope="module")
def through_focus(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Photographs of a chart at the positions, behind a lens with tilt and curvature."""
    folder, rng = tmp_path_factory.mktemp("focus"), np.random.default_rng(3)
    lens = FocusedLens(
        width_px=420,
        height_px=320,
        best_mm=0.01,
        sigma_px=0.6,
        blur_px_per_mm=9.0,
        tangential_mm=-0.08,
        sagittal_mm=-0.04,
        tilt_x_mm=0.05,
        tilt_y_mm=0.0,
    )
    files = []
    for number, position in enumerate(FOCUS_MM):
        image = chart(lens, squares(lens, 3, 2), 28.0, 6.0, position)
        files.append(folder / f"z{number}.tif")
        noisy = image + rng.normal(0, 20.0, image.shape)
        tifffile.imwrite(files[-1], np.round(noisy).astype(np.uint16))
    return files


@pytest.mark.slow
def test_photographs_through_focus_give_focus_over_the_field(
    command: Command, through_focus: list[Path], tmp_path: Path
) -> None:
    out, limits = tmp_path / "lens.html", tmp_path / "limits.toml"
    limits.write_text("[focus]\nmax_tilt_mm = 0.02\nmin_depth_mm = 0.1\nmax_astigmatism_mm = 0.2\n")
    positions = ",".join(f"{one:g}" for one in FOCUS_MM)
    words = ("--focus-mm", positions, "--pixel-pitch-um", 6.0, "--limits", limits)
    said = command.done("lens", *through_focus, *words, "--out", out)
    assert "best focus at 0.0" in said.out
    assert "all figures except those through focus are from the 1 photograph at 0 mm" in said.err
    document = json.loads((tmp_path / "lens.json").read_text("utf-8"))
    found = document["through_focus"]
    assert found["field"]["tilt_x_mm"]["value"] == pytest.approx(0.05, abs=0.004)
    assert found["field"]["tangential_mm"]["value"] == pytest.approx(-0.08, abs=0.004)
    assert {one["image"] for one in document["edges"]} == {str(through_focus[4])}
    assert len(document["provenance"]["inputs"]) == len(through_focus) + 1
    outcomes = {one["limit"]: one["outcome"] for one in document["verdict"]["limits"]}
    assert outcomes == {
        "focus.max_tilt_mm": "fail",
        "focus.min_depth_mm": "pass",
        "focus.max_astigmatism_mm": "pass",
    }
    assert "Focus over the field" in Page(out.read_text("utf-8")).headings
    with (tmp_path / "lens.csv").open(encoding="utf-8", newline="") as table:
        rows = list(csv.DictReader(table))
    tilts = {row["unit"]: float(row["value"]) for row in rows if row["figure"] == "focus_tilt"}
    assert tilts["mm"] == found["field"]["tilt_mm"]["value"]
    assert tilts["deg"] == found["field"]["tilt_deg"]["value"]
    best = [row for row in rows if row["figure"] == "best_through_focus"]
    assert len(best) == len(found["points"])


def test_focus_positions_belong_to_the_photographs(edge_file: Path) -> None:
    with pytest.raises(ArgumentError, match="1 photographs, but 2 focus positions"):
        standoff.measure_lens(edge_file, focus_mm=[0.0, 0.1])
    with pytest.raises(ArgumentError, match="5 different focus positions at least"):
        standoff.measure_lens([edge_file] * 6, focus_mm=[0.0, 0.1, 0.2, 0.3, 0.3, 0.3])


def test_photographs_without_a_best_focus_are_refused(edge_file: Path) -> None:
    with pytest.raises(CalibrationError, match="no edge is sharpest between the first"):
        standoff.measure_lens([edge_file] * 5, focus_mm=[0.0, 0.1, 0.2, 0.3, 0.4])


def test_a_limit_on_focus_says_what_it_takes(edge_file: Path, tmp_path: Path) -> None:
    limits = tmp_path / "limits.toml"
    limits.write_text("[focus]\nmax_tilt_mm = 0.02\n")
    verdict = standoff.measure_lens(edge_file, limits=limits).verdict
    assert verdict is not None
    assert verdict.outcome == "unsure"
    assert "--focus-mm" in (verdict.limits[0].reason or "")


HEIGHTS = """
schema = "standoff.plan/1"
name = "focus"
heights_mm = [267.0, 277.0, 287.0, 297.0, 307.0, 317.0, 327.0]
frames_per_capture = 4

[[targets]]
kind = "edge"
target = "edge"
orientations_deg = [5.0, 95.0]
"""


@pytest.mark.slow
def test_the_heights_of_a_session_tell_the_distance_of_best_focus(
    command: Command, tmp_path: Path
) -> None:
    bench = f"{SMALL_BENCH}focus_distance_mm = 300.0\nf_number = 1.4\n"
    session = command.captured(tmp_path, bench, HEIGHTS)
    focus = standoff.measure_lens(standoff.Session(session)).through_focus
    assert focus is not None
    assert focus.axis == "height"
    assert focus.best_mm.value == pytest.approx(300.0, abs=4 * focus.best_mm.err)
    assert focus.best_mm.err < 0.3  # mm
    assert focus.field is None  # one edge of either direction, in the middle


@pytest.mark.slow
def test_a_session_whose_focus_does_not_change_has_none(command: Command, tmp_path: Path) -> None:
    session = command.captured(tmp_path, SMALL_BENCH, HEIGHTS)
    assert standoff.measure_lens(standoff.Session(session)).through_focus is None


def targets_file(path: Path, light_dn: np.ndarray) -> Path:
    """A photograph of a target with squares beside it, as 16-bit TIFF."""
    both = edges_beside(light_dn, 0.7)
    noisy = both + np.random.default_rng(66).normal(0, 30.0, both.shape)
    tifffile.imwrite(path, np.round(10 * noisy).astype(np.uint16))
    return path


def rows_of(path: Path, part: str) -> list[dict[str, str]]:
    with path.open(encoding="utf-8", newline="") as table:
        return [row for row in csv.DictReader(table) if row["part"] == part]


@pytest.mark.slow
def test_a_star_stands_in_the_document_the_table_and_the_page(
    command: Command, tmp_path: Path
) -> None:
    star = Star(x_px=205.4, y_px=196.2, cycles=48, radius_px=180.0)
    seen = targets_file(tmp_path / "star.tif", star.photograph((390, 410), 0.7))
    command.done("lens", seen, "--out", tmp_path / "lens.html")
    document = json.loads((tmp_path / "lens.json").read_text("utf-8"))
    [found] = document["stars"]
    assert (found["cycles"], found["scaled_by"], len(found["sectors"])) == (48, "edges", 8)
    half = found["figures"]["mtf50_cy_per_px"]
    assert half["value"] == pytest.approx(0.2468, rel=0.01)
    assert found["mtf50_over_edges"]["value"] == pytest.approx(1.0, abs=0.02)
    whole = {(row["figure"], row["unit"]): row for row in rows_of(tmp_path / "lens.csv", "star")}
    assert float(whole["mtf50", "cy/px"]["value"]) == half["value"]
    assert float(whole["mtf50", "LW/PH"]["value"]) == pytest.approx(2 * 390 * half["value"])
    sectors = [row for row in rows_of(tmp_path / "lens.csv", "star_sector")
               if (row["figure"], row["unit"]) == ("mtf50", "cy/px")]  # fmt: skip
    assert [float(row["angle_deg"]) for row in sectors] == [22.5 + 45 * k for k in range(8)]
    page = Page((tmp_path / "lens.html").read_text("utf-8"))
    assert "Siemens stars" in page.headings
    assert "Texture (dead leaves)" not in page.headings


@pytest.mark.slow
def test_dead_leaves_stand_in_the_document_the_table_and_the_page(
    command: Command, tmp_path: Path
) -> None:
    target = dead_leaves(np.random.default_rng(7), 600, (3.0, 100.0))
    tifffile.imwrite(tmp_path / "target.tif", np.round(60000 * target).astype(np.uint16))
    printed = Print(x_px=21.3, y_px=15.8, scale=0.6)
    light = 3000 * photograph(target, printed, (390, 400), (0.7, 0.7))
    seen = targets_file(tmp_path / "leaves.tif", light)
    limits = tmp_path / "limits.toml"
    limits.write_text("[sharpening]\nmin_texture_over_edges = 0.9\n")
    done = command.done(
        *("lens", seen, "--leaves", tmp_path / "target.tif", "--limits", limits),
        *("--out", tmp_path / "lens.html"),
    )
    assert "No sign that texture is lost" in " ".join(done.out.split())
    document = json.loads((tmp_path / "lens.json").read_text("utf-8"))
    [found] = document["textures"]
    half = found["figures"]["mtf50_cy_per_px"]
    assert half["value"] == pytest.approx(0.2468, rel=0.01)
    assert found["over_edges"]["value"] == pytest.approx(1.0, abs=0.02)
    assert not found["is_lost"]
    assert document["verdict"]["outcome"] == "pass"
    listed = [Path(one["path"]).name for one in document["provenance"]["inputs"]]
    assert "target.tif" in listed
    figures = {
        (row["figure"], row["unit"]): row for row in rows_of(tmp_path / "lens.csv", "texture")
    }
    assert float(figures["mtf50", "cy/px"]["value"]) == half["value"]
    assert float(figures["texture_over_edges", "1"]["value"]) == found["over_edges"]["value"]
    assert rows_of(tmp_path / "lens.csv", "texture_direct")
    page = Page((tmp_path / "lens.html").read_text("utf-8"))
    assert "Texture (dead leaves)" in page.headings
    assert "Siemens stars" not in page.headings


@pytest.mark.slow
def test_leaves_that_no_photograph_shows_are_said_to_be_missing(edge_file: Path) -> None:
    target = dead_leaves(np.random.default_rng(7), 200, (3.0, 60.0))
    limited = standoff.measure_lens(edge_file, leaves=3000 * target)
    assert limited.textures == ()
    assert any("no photograph shows the dead leaves" in note for note in limited.notes)


@pytest.mark.slow
def test_a_picture_that_cannot_be_leaves_is_refused_before_the_work(
    command: Command, edge_file: Path, tmp_path: Path
) -> None:
    grey, text = tmp_path / "grey.tif", tmp_path / "text.png"
    tifffile.imwrite(grey, np.full((300, 300), 900, np.uint16))
    text.write_text("no picture", encoding="utf-8")
    out = tmp_path / "lens.html"
    for given, why in (
        (grey, "one grey all over; give the picture of the dead leaves target"),
        (text, "not an image"),
        (tmp_path, "a folder, not a file"),
        (tmp_path / "none.tif", "No such file"),
    ):
        err = command.refused(1, "lens", edge_file, "--leaves", given, "--out", out)
        assert why in " ".join(err.split())
        assert "measuring" not in err
        assert not out.exists()
