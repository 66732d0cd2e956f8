import json
from pathlib import Path
from typing import Any

import numpy as np
import tifffile
from numpy.typing import NDArray
from PIL import Image
from scipy import ndimage

from simulation import PsfField
from simulation.arrays import FloatArray
from simulation.followup import zoomed_out
from tests.calibration.closed_form import edge_image
from tests.standoff.conftest import Command


def test_a_psf_without_a_correlation_is_taken_as_axis_aligned_with_a_note(
    command: Command, image_file: Path, tmp_path: Path
) -> None:
    psf = tmp_path / "p.json"
    psf.write_text('{"schema": "standoff.psf/1", "sigma_x_px": 0.9, "sigma_y_px": 0.8}')
    done = command.done(
        "simulate", image_file, "--zoom", 2, "--psf", psf, "--out", tmp_path / "f.tif"
    )
    assert "rho is null" in done.err


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
        done = command.done(
            f"simulate {source} --zoom 1.5 --psf {psf} --out {out} --force --json", *options
        )
        return json.loads(done.out)["psf_field"], done.err, tifffile.imread(out)

    is_field, _, with_field = simulate(image, field_file)
    assert is_field
    field = PsfField(
        width_px=120,
        height_px=90,
        coefficients_px2=np.array(document["field"]["coefficients_px2"], dtype=np.float64),
    )
    np.testing.assert_array_equal(with_field, zoomed_out(pixels, 1.5, field, "lmmse").image)
    for source, options, message in (
        (other, (), "belongs to frames of 120 x 90 px"),
        (image, ("--model", "paper"), "model paper uses one PSF for the whole frame"),
    ):
        is_field, notes, plain = simulate(source, field_file, *options)
        assert not is_field
        assert message in notes
        np.testing.assert_array_equal(plain, simulate(source, psf_file, *options)[2])


def test_the_measured_transfer_takes_the_place_of_the_gaussian(
    command: Command, tmp_path: Path
) -> None:
    freq = np.linspace(0, 1, 51)
    curve = np.exp(-2 * np.pi**2 * 0.49 * freq**2)
    one_axis = {"freq_cy_per_px": freq.tolist(), "mtf": curve.tolist()}
    psf = tmp_path / "psf.json"
    content = {"schema": "standoff.psf/1", "sigma_x_px": 0.7, "sigma_y_px": 0.7, "rho": 0.0}
    psf.write_text(json.dumps({**content, "transfer": {"x": one_axis, "y": one_axis}}))
    image = tmp_path / "scene.tif"
    rng = np.random.default_rng(1)
    tifffile.imwrite(image, rng.integers(500, 3000, (60, 80)).astype(np.uint16))
    outputs = {}
    for model in ("matched", "lmmse"):
        for transfer, form in (("gaussian", "gaussian"), ("measured", "separable")):
            out = tmp_path / f"{transfer}.tif"
            arguments = ("--zoom", "1.5", "--psf", psf, "--model", model, "--transfer", transfer)
            done = command("simulate", image, *arguments, "--out", out, "--force", "--json")
            assert json.loads(done.out)["transfer"] == transfer
            assert json.loads(done.out)["psf_form"] == form
            outputs[transfer] = tifffile.imread(out)
        # The samples are joined by cubics, and end at 1 cy/px where 6e-5 is left. White noise is
        # as much at Nyquist, where a cut kernel shows, as anywhere.
        spread = float(outputs["gaussian"].std())
        assert np.std(outputs["measured"] - outputs["gaussian"]) < 0.015 * spread


def test_a_measured_transfer_that_is_not_there_or_not_for_the_model_is_refused(
    command: Command, tmp_path: Path
) -> None:
    psf, image, out = tmp_path / "psf.json", tmp_path / "scene.tif", tmp_path / "o.tif"
    psf.write_text('{"schema": "standoff.psf/1", "sigma_x_px": 0.7, "sigma_y_px": 0.7}')
    tifffile.imwrite(image, np.full((60, 80), 7, dtype=np.uint16))
    arguments = ("--zoom", "1.5", "--psf", psf, "--transfer", "measured", "--out", out)
    err = command.refused(1, "simulate", image, *arguments)
    assert "there is no transfer function along y; calibrate with horizontal edges" in err
    err = command.refused(2, "simulate", image, *arguments, "--model", "paper")
    assert "only matched and lmmse take a measured PSF" in err


def exact_paper_model(image: FloatArray, zoom: float, sigma_px: tuple[float, float]) -> FloatArray:
    """Pillow's antialiased cubic, then a Gaussian of Sigma (1 - 1/z^2): sigma (y, x)."""
    (rows, cols), (far_rows, far_cols) = image.shape, (int(n / zoom + 1e-9) for n in image.shape)
    left, top = (cols - far_cols * zoom) / 2, (rows - far_rows * zoom) / 2
    small = Image.fromarray(image.astype(np.float32)).resize(
        (far_cols, far_rows),
        Image.Resampling.BICUBIC,
        box=(left, top, cols - left, rows - top),
    )
    mirrored = np.pad(np.asarray(small, dtype=np.float64), 24, mode="symmetric")
    widths = [sigma * np.sqrt(1 - 1 / zoom**2) for sigma in sigma_px]
    blurred = np.fft.ifft2(ndimage.fourier_gaussian(np.fft.fft2(mirrored), widths)).real
    return np.asarray(blurred[24:-24, 24:-24])


def test_the_papers_mode_is_its_equation_whether_a_correlation_is_known_or_not(
    command: Command, image_file: Path, tmp_path: Path
) -> None:
    edges = [tmp_path / "vertical.tif", tmp_path / "horizontal.tif"]
    tifffile.imwrite(edges[0], edge_image(0.8, 5.0).astype(np.float32))
    tifffile.imwrite(edges[1], edge_image(1.1, 5.0).T.copy().astype(np.float32))
    psf = tmp_path / "psf.json"
    done = command.done("calibrate", *edges, "--method", "paper", "--out", psf, "--json")
    known = json.loads(psf.read_text())
    assert known["rho"] is None
    levels = tifffile.imread(image_file).astype(np.float64)
    levels *= 255 / levels.max()
    image = tmp_path / "near.tif"
    tifffile.imwrite(image, levels.astype(np.float32))
    expected = exact_paper_model(
        levels,
        2.0,
        (known["sigma_y_px"], known["sigma_x_px"]),
    )
    for rho in (None, 0.4):
        psf.write_text(json.dumps({**known, "rho": rho}))
        out = tmp_path / "far.tif"
        words = ("--zoom", 2, "--psf", psf, "--model", "paper", "--out", out, "--force", "--json")
        done = command.done("simulate", image, *words)
        assert json.loads(done.out)["psf_form"] == "gaussian"
        # The kernel's faint ends are cut off: 0.05 of 255.
        assert np.abs(tifffile.imread(out) - expected).max() < 0.05


def test_each_channel_of_a_photograph_in_colour_takes_the_psf_of_its_colour(
    command: Command, tmp_path: Path
) -> None:
    widths_px = {"red": 1.1, "green": 0.8, "blue": 0.6}
    each = {
        colour: {"sigma_x_px": width, "sigma_y_px": width, "rho": 0.0}
        for colour, width in widths_px.items()
    }
    document = {"schema": "standoff.psf/1", **each["green"], "channel": "green", "channels": each}
    psf, image = tmp_path / "psf.json", tmp_path / "image.tif"
    psf.write_text(json.dumps(document))
    pixels = np.random.default_rng(0).uniform(0, 255, (60, 80, 3)).astype(np.float32)
    tifffile.imwrite(image, pixels, photometric="rgb")
    (tmp_path / "H.json").write_text(
        json.dumps(
            {
                "schema": "standoff.homography/1",
                "matrix": [[1.3, 0.02, 2.0], [0.01, 1.25, 3.0], [1e-5, 0.0, 1.0]],
                "size": [55, 40],
            }
        )
    )
    for pose in (("--zoom", 1.6), ("--homography", tmp_path / "H.json")):
        out = tmp_path / "far.tif"
        words = "simulate", image, *pose, "--psf", psf, "--out", out, "--force"
        done = command.done(*words)
        assert "red, green and blue have a PSF each" in done.err
        far = tifffile.imread(out)
        assert far.shape[2] == 3
        for number, colour in enumerate(widths_px):
            alone = tmp_path / f"{colour}.json"
            alone.write_text(json.dumps({"schema": "standoff.psf/1", **each[colour]}))
            plane = tmp_path / "plane.tif"
            tifffile.imwrite(plane, pixels[:, :, number])
            command.done("simulate", plane, *pose, "--psf", alone, "--out", out, "--force")
            np.testing.assert_array_equal(tifffile.imread(out), far[:, :, number])
    # One that lacks a colour is one PSF for all.
    del each["blue"]
    psf.write_text(json.dumps(document))
    done = command(*words)
    assert "one PSF is used for all colours" in done.err
