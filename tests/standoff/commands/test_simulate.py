import json
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from calibration.documents import write_document
from calibration.errors import NoiseFileError
from calibration.noise import CorrectionMaps, NoiseCalibration, write_map_files
from simulation import GaussianPsf, zoom_out_image
from simulation.arrays import FloatArray
from tests.standoff.conftest import FLAT_DN, FLAT_VARIANCE_DN2, TEXTURE, Command


@pytest.mark.parametrize("model", ["matched", "lmmse", "paper", "bicubic"])
def test_the_file_holds_what_the_model_gives_as_float32(
    command: Command, image_file: Path, psf_file: Path, tmp_path: Path, model: str
) -> None:
    out = tmp_path / "far.tif"
    command.done(
        "simulate", image_file, "--zoom", 1.5, "--psf", psf_file, "--model", model, "--out", out
    )
    written = tifffile.imread(out)
    assert written.dtype == np.float32
    assert written.shape == (40, 60)  # floor(60 / 1.5), floor(91 / 1.5)
    psf = GaussianPsf(sigma_x_px=0.9, sigma_y_px=0.8, rho=0.1)
    np.testing.assert_array_equal(written, zoom_out_image(TEXTURE, 1.5, psf, model))  # type: ignore[arg-type]


def test_json_says_what_was_written(
    command: Command, image_file: Path, psf_file: Path, tmp_path: Path
) -> None:
    done = command(
        f"simulate {image_file} --zoom 2 --psf {psf_file} --out {tmp_path / 'f.tif'} --json"
    )
    document = json.loads(done.out)
    assert document["size"] == [45, 30]
    assert document["model"] == "lmmse"


def test_bicubic_needs_no_psf_and_zoom_1_changes_nothing(
    command: Command, image_file: Path, tmp_path: Path
) -> None:
    out = tmp_path / "same.tif"
    command.done("simulate", image_file, "--zoom", 1, "--model", "bicubic", "--out", out)
    np.testing.assert_allclose(tifffile.imread(out), TEXTURE, rtol=1e-6)


def test_colour_and_opacity(command: Command, psf_file: Path, tmp_path: Path) -> None:
    colour = np.random.default_rng(3).integers(0, 255, (30, 40, 4)).astype(np.uint8)
    tifffile.imwrite(tmp_path / "colour.tif", colour, photometric="rgb", extrasamples="unassalpha")
    out = tmp_path / "far.tif"
    command.done("simulate", tmp_path / "colour.tif", "--zoom", 2, "--psf", psf_file, "--out", out)
    assert tifffile.imread(out).shape == (15, 20, 3)


def test_a_capture_of_a_session_is_simulated_from_its_mean(
    command: Command, session_dir: Path, psf_file: Path, tmp_path: Path
) -> None:
    capture = sorted((session_dir / "captures").glob("*.tif"))[0]
    out = tmp_path / "far.tif"
    command.done("simulate", capture, "--zoom", 2, "--psf", psf_file, "--out", out)
    assert tifffile.imread(out).shape == (64, 80)


def test_capture_options_act_in_the_order_light_noise_sharpening(
    command: Command, image_file: Path, psf_file: Path, tmp_path: Path
) -> None:
    def simulated(*options: object) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
        out = tmp_path / "far.tif"
        command.done(
            f"simulate {image_file} --zoom 2 --psf {psf_file} --out {out} --force", *options
        )
        return np.asarray(tifffile.imread(out))

    plain = simulated()
    np.testing.assert_allclose(simulated("--exposure", 1.5), 1.5 * plain, rtol=1e-6)
    np.testing.assert_allclose(simulated("--vignetting", 0.3)[0, 0], 0.7 * plain[0, 0], rtol=1e-5)
    assert np.std(simulated("--sharpen", "1.0,1.5")) > 1.1 * np.std(plain)


def test_noise_is_that_of_a_capture_and_follows_the_seed(
    command: Command, psf_file: Path, noise_file: Path, tmp_path: Path
) -> None:
    flat = tmp_path / "flat.tif"
    rng = np.random.default_rng(1)
    pixels = rng.normal(FLAT_DN, np.sqrt(FLAT_VARIANCE_DN2), (200, 240))
    tifffile.imwrite(flat, pixels.astype(np.float32))

    def simulated(seed: int) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
        out = tmp_path / "far.tif"
        command.done(
            f"simulate {flat} --zoom 2 --psf {psf_file} --noise {noise_file} --seed {seed} "
            f"--out {out} --force"
        )
        return np.asarray(tifffile.imread(out))

    first = simulated(1)
    assert np.var(first[4:-4, 4:-4]) == pytest.approx(FLAT_VARIANCE_DN2, rel=0.06)  # 10 000 pixels
    np.testing.assert_array_equal(simulated(1), first)
    assert np.any(simulated(2) != first)


@pytest.mark.parametrize(
    ("text", "name"),
    [
        ('{"schema": "standoff.psf/1"}', "schema"),
        ('{"schema": "standoff.noise/1", "gain_e_per_dn": null}', "gain_e_per_dn"),
        (
            '{"schema": "standoff.noise/1", "gain_e_per_dn": 4.0, "read_noise_e": 8.0,'
            ' "black_level_dn": 0.0, "frames_averaged": 1.9}',
            "frames_averaged",
        ),
        (
            '{"schema": "standoff.noise/1", "gain_e_per_dn": -4.0, "read_noise_e": 8.0,'
            ' "black_level_dn": 0.0, "frames_averaged": 1}',
            "gain_e_per_dn",
        ),
    ],
)
def test_a_noise_file_at_fault_is_named(
    command: Command, image_file: Path, psf_file: Path, tmp_path: Path, text: str, name: str
) -> None:
    noise = tmp_path / "noise.json"
    noise.write_text(text)
    err = command.refused(
        1,
        f"simulate {image_file} --zoom 2 --psf {psf_file} --noise {noise} "
        f"--out {tmp_path / 'far.tif'}",
    )
    assert name in err
    assert not (tmp_path / "far.tif").exists()


def written_maps(tmp_path: Path, shape: tuple[int, int], seed: int = 1) -> tuple[Path, FloatArray]:
    """A noise.json with maps of its own, and the pattern they take off an even grey of 1000 DN."""
    rng = np.random.default_rng(1)
    dark = (64 + rng.normal(0, 5, shape)).astype(np.float32)
    response = (1 + rng.normal(0, 0.05, shape)).astype(np.float32)
    defects = np.zeros(shape, np.uint8)
    defects[7, 9] = 1
    maps = CorrectionMaps(dark_dn=dark, response=response, defects=defects, black_level_dn=64.0)
    path = tmp_path / "noise.json"
    noise = NoiseCalibration(
        gain_e_per_dn=4.0,
        read_noise_e=8.0,
        black_level_dn=64.0,
        saturation_dn=4095.0,
        frames_averaged=1,
        maps=write_map_files(path, maps),
    )
    write_document(path, noise, NoiseFileError)
    image = dark.astype(np.float64) + response * (1000.0 - 64.0)
    image[7, 9] = 4095.0
    return path, image


def test_a_fixed_pattern_is_taken_off_before_the_reference_is_zoomed_out(
    command: Command, psf_file: Path, tmp_path: Path
) -> None:
    noise, image = written_maps(tmp_path, (60, 91))
    photograph, out = tmp_path / "p.tif", tmp_path / "f.tif"
    tifffile.imwrite(photograph, image.astype(np.float32))
    words = ("simulate", photograph, "--zoom", 2, "--psf", psf_file, "--out", out)
    command.done(*words, "--correct", noise)
    # By hand: dark + response * 936 is an even 1000 DN once both maps are off.
    np.testing.assert_allclose(tifffile.imread(out), 1000.0, atol=0.01)
    command.done(*words, "--force")
    assert tifffile.imread(out).std() > 5


def test_maps_of_another_sensor_and_colour_are_refused(
    command: Command, psf_file: Path, image_file: Path, tmp_path: Path
) -> None:
    noise, _ = written_maps(tmp_path, (20, 30))
    words = ("--zoom", 2, "--psf", psf_file, "--out", tmp_path / "f.tif", "--correct", noise)
    done = command("simulate", image_file, *words)
    assert (done.status, done.err.count("\n")) == (1, 1)
    assert "maps of (20, 30)" in done.err
    colour = tmp_path / "c.png"
    Image.fromarray(np.zeros((20, 30, 3), np.uint8)).save(colour)
    assert "grey camera" in command.refused(1, "simulate", colour, *words)
