"""``standoff calibrate`` without an edge target."""

import json
from pathlib import Path

import numpy as np
import pytest
import tifffile

from tests.calibration.blob_scene import blob_photograph
from tests.calibration.squares import chart
from tests.standoff.conftest import Command

PSF = np.array([[0.45, 0.06], [0.06, 0.33]])
NOISE_DN = 8.0


@pytest.fixture(scope="module")
def photographs(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """A scene from once, one and a half times and twice as far, with noise."""
    folder = tmp_path_factory.mktemp("scene")
    rng = np.random.default_rng(5)
    paths = []
    for zoom in (1.0, 1.5, 2.0):
        image = blob_photograph(zoom, PSF) + rng.normal(0, NOISE_DN, (240, 320))
        path = folder / f"at_{zoom}.tif"
        tifffile.imwrite(path, image.astype(np.float32))
        paths.append(path)
    return paths


@pytest.fixture
def noise_file(tmp_path: Path) -> Path:
    path = tmp_path / "noise.json"
    gain = 1e9  # no shot noise to speak of
    path.write_text(
        json.dumps(
            {
                "schema": "standoff.noise/1",
                "gain_e_per_dn": gain,
                "read_noise_e": NOISE_DN * gain,
                "black_level_dn": 0.0,
                "saturation_dn": 65535.0,
                "frames_averaged": 1,
            }
        )
    )
    return path


@pytest.mark.slow
def test_a_height_series_calibrates_itself(
    command: Command, photographs: list[Path], noise_file: Path, tmp_path: Path
) -> None:
    out = tmp_path / "psf.json"
    words = ("calibrate", *photographs, "--method", "two-distance", "--out", out)
    done = command.done(*words, "--noise", noise_file, "--json")
    document = json.loads(done.out)
    assert document == json.loads(out.read_text())
    assert document["method"] == "two-distance"
    assert [round(pair["zoom"], 2) for pair in document["pairs"]] == [1.5, 2.0]
    # The truth of the closed form.
    assert document["sigma_x_px"] == pytest.approx(np.sqrt(0.45), rel=0.02)
    assert document["sigma_y_px"] == pytest.approx(np.sqrt(0.33), rel=0.02)
    assert document["rho"] == pytest.approx(0.06 / np.sqrt(0.45 * 0.33), abs=0.04)
    expected = np.sqrt(document["sigma_x_px"] ** 2 - 1 / 12)
    assert document["optical_sigma_x_px"] == pytest.approx(expected)
    assert document["edges"] == []
    assert 0.001 < document["sigma_x_err_px"] / document["sigma_x_px"] < 0.03
    assert document["transfer_2d"]["pairs"] == 2
    far = tmp_path / "far.tif"
    command.done("simulate", photographs[0], "--zoom", 2, "--psf", out, "--out", far)


@pytest.mark.slow
def test_without_the_noise_a_note_says_so_and_a_given_zoom_needs_no_features(
    command: Command, photographs: list[Path], tmp_path: Path
) -> None:
    out = tmp_path / "psf.json"
    words = ("--method", "two-distance", "--zoom", 2, "--out", out)
    done = command.done("calibrate", photographs[0], photographs[2], *words)
    assert "give --noise" in done.err
    assert json.loads(out.read_text())["sigma_x_px"] == pytest.approx(np.sqrt(0.45), rel=0.1)


@pytest.mark.slow
def test_photographs_in_the_wrong_order_are_refused_in_one_line(
    command: Command, photographs: list[Path], noise_file: Path, tmp_path: Path
) -> None:
    out = tmp_path / "psf.json"
    words = ("--method", "two-distance", "--noise", noise_file, "--out", out)
    err = command.refused(1, "calibrate", photographs[2], photographs[0], *words)
    assert "the second photograph is the nearer one" in err
    assert not out.exists()


@pytest.mark.slow
def test_the_edges_of_a_scene_tell_the_psf_and_how_little_that_is(
    command: Command, tmp_path: Path
) -> None:
    scene, out = tmp_path / "scene.tif", tmp_path / "psf.json"
    cover = chart(240, 320, pitch_px=70.0, side_px=46.0, turn_deg=24.0, sigma_px=0.7)
    noise = np.random.default_rng(1).normal(0.0, 2.0, cover.shape)
    tifffile.imwrite(scene, (200.0 - 150.0 * cover + noise).astype(np.float32))
    done = command.done("calibrate", scene, "--method", "single-image", "--out", out)
    found = json.loads(out.read_text())
    assert found["optical_sigma_x_px"] == pytest.approx(0.7, rel=0.1)
    assert found["sigma_x_err_px"] == pytest.approx(0.2 * found["sigma_x_px"], rel=0.1)
    assert "note: the errors include 20 %" in done.err


def test_an_image_without_edges_tells_no_psf(
    command: Command, photographs: list[Path], tmp_path: Path
) -> None:
    out = tmp_path / "psf.json"
    err = command.refused(1, "calibrate", photographs[0], "--method", "single-image", "--out", out)
    assert "use a scene with sharp edges" in err
    assert not out.exists()


@pytest.mark.parametrize("region", ["-300,0,100,100", "0,200,100,41", "5000,0,10,10"])
def test_a_region_beyond_the_nearest_photograph_is_named_as_it_was_typed(
    command: Command, photographs: list[Path], tmp_path: Path, region: str
) -> None:
    out = tmp_path / "psf.json"
    words = ("--method", "two-distance", "--zoom", 1.5, "--region", region, "--out", out)
    err = command.refused(1, "calibrate", *photographs[:2], *words)
    inside = f"region {region} is not within {photographs[0]} (320x240)"
    assert inside in err.splitlines()[-1]
    assert not out.exists()
