"""What the levels of a file mean: taken from it, said, stored, and decided by --encoding."""

import json
import re
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from simulation.arrays import FloatArray
from tests.calibration.closed_form import edge_image
from tests.standoff.conftest import Command
from tests.standoff.provenance import assert_provenance


def srgb_codes(linear: FloatArray) -> FloatArray:
    """Codes of 8 bits, before they are rounded, of levels from 0 to 1."""
    power = 1.055 * np.maximum(linear, 0.0031308) ** (1 / 2.4) - 0.055
    return np.asarray(255 * np.where(linear <= 0.0031308, 12.92 * linear, power))


def light(code: float) -> float:
    """Level of a code of 8 bits in sRGB, above its linear part."""
    return float(((code / 255 + 0.055) / 1.055) ** 2.4)


@pytest.fixture
def srgb_png(tmp_path: Path) -> Path:
    """A vertical edge of total sigma 0.8 px in light, whose sides are codes 60 and 240 of sRGB."""
    linear = edge_image(0.8, 5.0, shape=(400, 420), low_dn=light(60), high_dn=light(240))
    path = tmp_path / "edge.png"
    Image.fromarray(np.rint(srgb_codes(linear)).astype(np.uint8)).save(path)
    return path


@pytest.mark.slow
def test_an_unmarked_png_is_srgb_which_is_said_and_stored(
    command: Command, srgb_png: Path, tmp_path: Path
) -> None:
    out, page = tmp_path / "psf.json", tmp_path / "psf.html"
    done = command.done("calibrate", srgb_png, "--out", out, "--report", page, "--json")
    document = json.loads(done.out)
    assert document["sigma_x_px"] == pytest.approx(0.8, rel=0.005)
    assert_provenance(document, "calibrate", srgb_png, encoding="srgb")
    assert "levels taken as srgb (usual for 8-bit PNG without a mark)" in done.err
    assert "--encoding" in done.err
    text = page.read_text()
    assert "levels read as srgb" in text
    assert document["provenance"]["inputs"][0]["sha256"] in text


@pytest.mark.parametrize(
    ("words", "encoding"),
    [
        (("--encoding", "linear"), "linear"),
        (("--linear",), "linear"),
        (("--srgb",), "srgb"),
        (("--encoding", "gamma:2.2"), "gamma:2.2"),
    ],
)
def test_the_option_decides(
    command: Command, srgb_png: Path, tmp_path: Path, words: tuple[str, ...], encoding: str
) -> None:
    document = command.document("calibrate", srgb_png, *words, "--out", tmp_path / "psf.json")
    assert_provenance(document, "calibrate", srgb_png, encoding=encoding)
    is_near = document["sigma_x_px"] == pytest.approx(0.8, rel=0.03)
    assert is_near == (encoding != "linear")  # gamma 2.2 is close to sRGB


def test_white_stays_white_in_what_is_simulated(
    command: Command, psf_file: Path, tmp_path: Path
) -> None:
    """By hand: code 188 of sRGB is 0.5029 of white, which is 255."""
    for level in (188, 255):
        Image.fromarray(np.full((64, 64), level, np.uint8)).save(tmp_path / f"{level}.png")
    out = tmp_path / "far.tif"
    for level, expected in ((255, 255.0), (188, 128.2)):
        image = tmp_path / f"{level}.png"
        done = command.done(
            "simulate", image, "--zoom", 2, "--psf", psf_file, "--out", out, "--force", "--json"
        )
        assert tifffile.imread(out).mean() == pytest.approx(expected, abs=0.1)
        assert_provenance(json.loads(done.out), "simulate", psf_file, image, encoding="srgb")


def test_training_pairs_have_the_encoding_of_their_photograph(
    command: Command, psf_file: Path, tmp_path: Path
) -> None:
    image = np.random.default_rng(0).integers(0, 256, (64, 64)).astype(np.uint8)
    photographs = tmp_path / "photographs"
    photographs.mkdir()
    Image.fromarray(image).save(photographs / "a.png")
    tifffile.imwrite(photographs / "b.tif", image)
    out = tmp_path / "pairs"
    asked = ("sr-pairs", photographs, "--psf", psf_file, "--zoom", 2, "--crop", 64, "--out", out)
    command.done(*asked, "--test-fraction", 0)
    dataset = json.loads((out / "dataset.json").read_text())
    assert dataset["provenance"]["encoding"] == ["linear", "srgb"]
    lines = [json.loads(line) for line in (out / "manifest.jsonl").read_text().splitlines()]
    assert {line["image"]: line["encoding"] for line in lines} == {
        "a.png": "srgb",
        "b.tif": "linear",
    }
    for line in lines:
        with Image.open(out / line["high"]) as high:
            np.testing.assert_array_equal(np.asarray(high), image)
            # Whoever reads the pair takes the same encoding.
            assert high.info.get("srgb") == (0 if line["encoding"] == "srgb" else None)


def test_a_mean_of_frames_brings_the_noise_of_the_edges(command: Command, tmp_path: Path) -> None:
    rng = np.random.default_rng(3)
    edge = edge_image(0.8, 5.0, low_dn=400, high_dn=3000)
    frames = np.rint(edge + rng.normal(0, 8.0, (12, *edge.shape))).astype(np.uint16)
    stack = tmp_path / "stack.tif"
    tifffile.imwrite(stack, frames, photometric="minisblack")
    asked = ("calibrate", stack, "--out", tmp_path / "psf.json", "--force", "--json")
    refused = command(*asked)
    assert (refused.status, refused.err.count("\n")) == (1, 1)
    assert re.search(r"12 pages.*--page.*--mean", refused.err)
    one = json.loads(command(*asked, "--page", 3).out)
    mean = json.loads(command(*asked, "--mean").out)
    assert one["edges"][0]["chi2_reduced"] is None
    assert mean["edges"][0]["chi2_reduced"] == pytest.approx(1.0, abs=0.3)
    # The mean of 12 frames has errors sqrt(12) times smaller.
    assert mean["sigma_x_err_px"] == pytest.approx(one["sigma_x_err_px"] / 12**0.5, rel=0.3)
    command.refused(2, *asked, "--page", 3, "--mean")
