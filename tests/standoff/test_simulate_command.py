import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import tifffile
from numpy.typing import NDArray
from PIL import Image

from calibration.correction_maps import CorrectionMaps
from calibration.map_files import write_map_files
from simulation import GaussianPsf, PsfField, zoom_out
from standoff.followup import zoomed_out
from standoff.image_files import read_image
from tests.standoff.conftest import Command

TEXTURE = np.random.default_rng(6).integers(0, 4000, (60, 91)).astype(np.uint16)


@pytest.fixture
def psf_file(tmp_path: Path) -> Path:
    path = tmp_path / "psf.json"
    path.write_text(
        json.dumps({"schema": "standoff.psf/1", "sigma_x_px": 0.9, "sigma_y_px": 0.8, "rho": 0.1})
    )
    return path


FLAT_DN = 1000.0
FLAT_VARIANCE_DN2 = FLAT_DN / 4.0 + (8.0 / 4.0) ** 2
"""Of one frame of a flat without black level, at 4 e-/DN and 8 e- of read noise."""


@pytest.fixture
def noise_file(tmp_path: Path) -> Path:
    path = tmp_path / "noise.json"
    path.write_text(
        '{"schema": "standoff.noise/1", "gain_e_per_dn": 4.0, "read_noise_e": 8.0,'
        ' "black_level_dn": 0.0, "saturation_dn": 4095.0, "frames_averaged": 1}'
    )
    return path


@pytest.fixture
def image_file(tmp_path: Path) -> Path:
    path = tmp_path / "texture.tif"
    tifffile.imwrite(path, TEXTURE)
    return path


@pytest.mark.parametrize("model", ["matched", "paper", "bicubic"])
def test_the_file_holds_what_the_model_gives_as_float32(
    command: Command, image_file: Path, psf_file: Path, tmp_path: Path, model: str
) -> None:
    out = tmp_path / "far.tif"
    done = command(
        "simulate", image_file, "--zoom", 1.5, "--psf", psf_file, "--model", model, "--out", out
    )
    assert done.status == 0
    written = tifffile.imread(out)
    assert written.dtype == np.float32
    assert written.shape == (40, 60)  # floor(60 / 1.5), floor(91 / 1.5)
    psf = GaussianPsf(sigma_x_px=0.9, sigma_y_px=0.8, rho=0.1)
    np.testing.assert_array_equal(written, zoom_out(TEXTURE, 1.5, psf, model))  # type: ignore[arg-type]


def test_json_says_what_was_written(
    command: Command, image_file: Path, psf_file: Path, tmp_path: Path
) -> None:
    done = command(
        "simulate",
        image_file,
        "--zoom",
        2,
        "--psf",
        psf_file,
        "--out",
        tmp_path / "f.tif",
        "--json",
    )
    document = json.loads(done.out)
    assert document["size"] == [45, 30]
    assert document["model"] == "matched"


def test_bicubic_needs_no_psf_and_zoom_1_changes_nothing(
    command: Command, image_file: Path, tmp_path: Path
) -> None:
    out = tmp_path / "same.tif"
    assert (
        command("simulate", image_file, "--zoom", 1, "--model", "bicubic", "--out", out).status == 0
    )
    np.testing.assert_allclose(tifffile.imread(out), TEXTURE, rtol=1e-6)


def test_colour_and_opacity(command: Command, psf_file: Path, tmp_path: Path) -> None:
    colour = np.random.default_rng(3).integers(0, 255, (30, 40, 4)).astype(np.uint8)
    tifffile.imwrite(tmp_path / "colour.tif", colour, photometric="rgb", extrasamples="unassalpha")
    out = tmp_path / "far.tif"
    assert (
        command(
            "simulate", tmp_path / "colour.tif", "--zoom", 2, "--psf", psf_file, "--out", out
        ).status
        == 0
    )
    assert tifffile.imread(out).shape == (15, 20, 3)


def test_a_psf_without_a_correlation_is_taken_as_axis_aligned_with_a_note(
    command: Command, image_file: Path, tmp_path: Path
) -> None:
    psf = tmp_path / "p.json"
    psf.write_text('{"schema": "standoff.psf/1", "sigma_x_px": 0.9, "sigma_y_px": 0.8}')
    done = command("simulate", image_file, "--zoom", 2, "--psf", psf, "--out", tmp_path / "f.tif")
    assert done.status == 0
    assert "rho is null" in done.err


def test_a_capture_of_a_session_is_simulated_from_its_mean(
    command: Command, session_dir: Path, psf_file: Path, tmp_path: Path
) -> None:
    capture = sorted((session_dir / "captures").glob("*.tif"))[0]
    out = tmp_path / "far.tif"
    assert command("simulate", capture, "--zoom", 2, "--psf", psf_file, "--out", out).status == 0
    assert tifffile.imread(out).shape == (64, 80)


def test_capture_options_act_in_the_order_light_noise_sharpening(
    command: Command, image_file: Path, psf_file: Path, tmp_path: Path
) -> None:
    def simulated(*options: object) -> np.ndarray[tuple[int, ...], np.dtype[np.float32]]:
        out = tmp_path / "far.tif"
        done = command(
            "simulate", image_file, "--zoom", 2, "--psf", psf_file, "--out", out, *options
        )
        assert done.status == 0, done.err
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
        done = command(
            "simulate", flat, "--zoom", 2, "--psf", psf_file, "--noise", noise_file,
            "--seed", seed, "--out", out,
        )  # fmt: skip
        assert done.status == 0, done.err
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
    done = command(
        "simulate", image_file, "--zoom", 2, "--psf", psf_file, "--noise", noise,
        "--out", tmp_path / "far.tif",
    )  # fmt: skip
    assert done.status == 1
    assert name in done.err
    assert not (tmp_path / "far.tif").exists()


@pytest.mark.parametrize(
    "option",
    [
        ("--sharpen", "much"),
        ("--sharpen", "nan"),
        ("--sharpen", "0.8,0"),
        ("--exposure", "inf"),
        ("--vignetting", "3"),
        ("--seed", "-1"),
        ("--out", "far.png"),
    ],
)
def test_options_that_are_no_numbers_are_wrong_usage(
    command: Command, image_file: Path, psf_file: Path, tmp_path: Path, option: tuple[str, str]
) -> None:
    out = tmp_path / "far.tif"
    done = command("simulate", image_file, "--zoom", 2, "--psf", psf_file, "--out", out, *option)
    assert done.status == 2


def _homography_file(path: Path, matrix: object, size: object) -> Path:
    path.write_text(json.dumps({"schema": "standoff.homography/1", "matrix": matrix, "size": size}))
    return path


def test_a_homography_that_is_a_zoom_gives_what_the_zoom_gives(
    command: Command, psf_file: Path, tmp_path: Path
) -> None:
    y, x = np.mgrid[:120, :150].astype(np.float64)
    blobs = 900.0 * np.exp(-((x - 70.3) ** 2 + (y - 61.1) ** 2) / (2 * 3.0**2)) + 100.0
    image = tmp_path / "blob.tif"
    tifffile.imwrite(image, blobs.astype(np.float32))
    # Pixel i of the follow-up lies at (i - (n - 1) / 2) z + (N - 1) / 2 of the reference.
    matrix = [[1.5, 0, 74.5 - 49.5 * 1.5], [0, 1.5, 59.5 - 39.5 * 1.5], [0, 0, 1]]
    pose = _homography_file(tmp_path / "H.json", matrix, [100, 80])
    by_pose, by_zoom, mask = (tmp_path / name for name in ("pose.tif", "zoom.tif", "nearer.png"))
    done = command(
        "simulate", image, "--homography", pose, "--psf", psf_file, "--out", by_pose,
        "--nearer", mask, "--json",
    )  # fmt: skip
    assert done.status == 0, done.err
    document = json.loads(done.out)
    assert document["size"] == [100, 80]
    assert document["nearer_fraction"] == 0.0
    command("simulate", image, "--zoom", 1.5, "--psf", psf_file, "--out", by_zoom)
    np.testing.assert_allclose(
        tifffile.imread(by_pose),
        tifffile.imread(by_zoom),
        atol=2.0,  # of 900 DN
    )
    assert not read_image(mask).pixels.any()


@pytest.mark.parametrize(
    ("matrix", "size", "name"),
    [
        ([[1, 0], [0, 1]], [10, 10], "matrix"),
        ([[1, 0, 0], [0, 1, 0], [0, 0, "one"]], [10, 10], "matrix"),
        ([[1, 0, 0], [0, 1, 0], [0, 0, 1]], [10], "size"),
        ([[1, 0, 0], [0, 1, 0], [0, 0, 1]], [10, -1], "size"),
        ([[1, 0, 900], [0, 1, 0], [0, 0, 1]], [10, 10], "H.json"),
        ([[0, 0, 0], [0, 0, 0], [0, 0, 0]], [10, 10], "H.json"),
    ],
)
def test_a_homography_at_fault_is_named(
    command: Command,
    image_file: Path,
    psf_file: Path,
    tmp_path: Path,
    matrix: object,
    size: object,
    name: str,
) -> None:
    pose = _homography_file(tmp_path / "H.json", matrix, size)
    out = tmp_path / "far.tif"
    done = command("simulate", image_file, "--homography", pose, "--psf", psf_file, "--out", out)
    assert done.status == 1
    assert name in done.err
    assert not out.exists()


@pytest.mark.parametrize(
    "options",
    [
        (),
        ("--zoom", 2, "--homography", "H.json"),
        ("--homography", "H.json", "--model", "paper"),
        ("--zoom", 2, "--nearer", "mask.png"),
    ],
)
def test_zoom_and_homography_exclude_each_other(
    command: Command, image_file: Path, psf_file: Path, tmp_path: Path, options: tuple[object, ...]
) -> None:
    out = tmp_path / "far.tif"
    done = command("simulate", image_file, "--psf", psf_file, "--out", out, *options)
    assert done.status == 2


def test_a_follow_up_from_another_pose_gets_the_noise_of_a_capture(
    command: Command, psf_file: Path, noise_file: Path, tmp_path: Path
) -> None:
    image, out = tmp_path / "flat.tif", tmp_path / "far.tif"
    rng = np.random.default_rng(4)
    pixels = rng.normal(FLAT_DN, np.sqrt(FLAT_VARIANCE_DN2), (200, 220))
    tifffile.imwrite(image, pixels.astype(np.float32))
    pose = _homography_file(
        tmp_path / "H.json", [[1.4, 0.2, 5], [-0.1, 1.5, 20], [0, 1e-4, 1]], [120, 100]
    )
    done = command(
        "simulate", image, "--homography", pose, "--psf", psf_file, "--noise", noise_file,
        "--out", out,
    )  # fmt: skip
    assert done.status == 0, done.err
    inner = tifffile.imread(out)[5:-5, 5:-5]
    # 9 900 pixels, correlated: the variance scatters by about 2 %.
    assert np.var(inner) == pytest.approx(FLAT_VARIANCE_DN2, rel=0.06)


def test_the_field_of_a_psf_file_is_used_where_it_fits(
    command: Command, psf_file: Path, tmp_path: Path
) -> None:
    document = json.loads(psf_file.read_text(encoding="utf-8"))
    document["field"] = {
        "width_px": 120,
        "height_px": 90,
        "coefficients_px2": [[0.5, 0, 0, 2, 0, 2], [0, 0, 0, 0, 0, 0], [0.5, 0, 0, 2, 0, 2]],
    }
    field_file = tmp_path / "field.json"
    field_file.write_text(json.dumps(document))
    image, other = tmp_path / "image.tif", tmp_path / "other.tif"
    pixels = np.random.default_rng(0).uniform(0, 255, (90, 120)).astype(np.float32)
    tifffile.imwrite(image, pixels)
    tifffile.imwrite(other, pixels[1:])

    def simulate(source: Path, psf: Path, *options: object) -> tuple[bool, str, NDArray[Any]]:
        out = tmp_path / "far.tif"
        done = command(
            "simulate", source, "--zoom", 1.5, "--psf", psf, "--out", out, "--json", *options
        )
        assert done.status == 0, done.err
        return json.loads(done.out)["psf_field"], done.err, tifffile.imread(out)

    is_field, _, with_field = simulate(image, field_file)
    assert is_field
    field = PsfField(
        width_px=120,
        height_px=90,
        coefficients_px2=np.array(document["field"]["coefficients_px2"], dtype=np.float64),
    )
    np.testing.assert_array_equal(with_field, zoomed_out(pixels, 1.5, field, "matched").image)
    for source, options, message in (
        (other, (), "belongs to frames of 120 x 90 px"),
        (image, ("--model", "paper"), "model paper takes the PSF of the whole frame"),
    ):
        is_field, notes, plain = simulate(source, field_file, *options)
        assert not is_field
        assert message in notes
        np.testing.assert_array_equal(plain, simulate(source, psf_file, *options)[2])


def test_the_measured_transfer_takes_the_place_of_the_gaussian(
    command: Command, tmp_path: Path
) -> None:
    freq = np.linspace(0, 1, 51)
    # What model lmmse takes a total width of 0.7 px for: a Gaussian of 0.49 - 1/12, and a pixel.
    curve = np.exp(-2 * np.pi**2 * (0.49 - 1 / 12) * freq**2) * np.sinc(freq)
    one_axis = {"freq_cy_per_px": freq.tolist(), "mtf": curve.tolist()}
    psf = tmp_path / "psf.json"
    content = {"schema": "standoff.psf/1", "sigma_x_px": 0.7, "sigma_y_px": 0.7, "rho": 0.0}
    psf.write_text(json.dumps({**content, "transfer": {"x": one_axis, "y": one_axis}}))
    image = tmp_path / "scene.tif"
    rng = np.random.default_rng(1)
    tifffile.imwrite(image, rng.integers(500, 3000, (60, 80)).astype(np.uint16))
    outputs = {}
    for transfer in ("gaussian", "measured"):
        out = tmp_path / f"{transfer}.tif"
        arguments = ("--zoom", "1.5", "--psf", psf, "--model", "lmmse", "--transfer", transfer)
        done = command("simulate", image, *arguments, "--out", out, "--json")
        assert json.loads(done.out)["transfer"] == transfer
        outputs[transfer] = tifffile.imread(out)
    # The samples are joined by cubics, and end at 1 cy/px where 1e-4 is left.
    spread = float(outputs["gaussian"].std())
    assert np.abs(outputs["measured"] - outputs["gaussian"]).max() < 0.01 * spread


def test_a_measured_transfer_that_is_not_there_or_not_for_the_model_is_refused(
    command: Command, tmp_path: Path
) -> None:
    psf, image, out = tmp_path / "psf.json", tmp_path / "scene.tif", tmp_path / "o.tif"
    psf.write_text('{"schema": "standoff.psf/1", "sigma_x_px": 0.7, "sigma_y_px": 0.7}')
    tifffile.imwrite(image, np.full((60, 80), 7, dtype=np.uint16))
    arguments = ("--zoom", "1.5", "--psf", psf, "--transfer", "measured", "--out", out)
    done = command("simulate", image, *arguments, "--model", "lmmse")
    assert done.status == 1
    assert "it holds no transfer function along y; calibrate with horizontal edges" in done.err
    assert command("simulate", image, *arguments).status == 2


def written_maps(
    tmp_path: Path, shape: tuple[int, int], seed: int = 1
) -> tuple[Path, NDArray[np.float64]]:
    """A noise.json with maps of its own, and the pattern they take off an even grey of 1000 DN."""
    rng = np.random.default_rng(1)
    dark = (64 + rng.normal(0, 5, shape)).astype(np.float32)
    response = (1 + rng.normal(0, 0.05, shape)).astype(np.float32)
    defects = np.zeros(shape, np.uint8)
    defects[7, 9] = 1
    maps = CorrectionMaps(dark_dn=dark, response=response, defects=defects, black_level_dn=64.0)
    path = tmp_path / "noise.json"
    document = {
        "schema": "standoff.noise/1",
        "gain_e_per_dn": 4.0,
        "read_noise_e": 8.0,
        "black_level_dn": 64.0,
        "saturation_dn": 4095.0,
        "frames_averaged": 1,
        "maps": write_map_files(path, maps),
    }
    path.write_text(json.dumps(document), encoding="utf-8")
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
    done = command(*words, "--correct", noise)
    assert done.status == 0, done.err
    # By hand: dark + response * 936 is an even 1000 DN once both maps are off.
    np.testing.assert_allclose(tifffile.imread(out), 1000.0, atol=0.01)
    assert command(*words).status == 0
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
    done = command("simulate", colour, *words)
    assert done.status == 1
    assert "grey camera" in done.err
