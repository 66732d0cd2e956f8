"""Arrays as photographs: with masks, of other libraries, read as files are, and cut off."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image
from scipy.special import erf

import standoff
from acquisition.photographs import ReadOptions, photograph_of, read_photograph, taken_as
from calibration.errors import CalibrationError
from simulation.arrays import BoolArray, FloatArray
from standoff.errors import ImageFileError

PSF = standoff.GaussianPsf(sigma_px=0.7)
SIZE = 160


def edge(sigma_px: float = 0.7, low: float = 100.0, high: float = 900.0) -> FloatArray:
    """An edge at 5 degrees from the vertical, blurred by a Gaussian: a closed form."""
    y, x = np.mgrid[:SIZE, :SIZE] - (SIZE - 1) / 2
    along = x * np.cos(np.radians(5)) + y * np.sin(np.radians(5))
    return np.asarray(low + (high - low) * 0.5 * (1 + erf(along / (sigma_px * np.sqrt(2)))))


def noisy(levels: FloatArray, sd: float) -> FloatArray:
    return np.asarray(levels + sd * np.random.default_rng(3).standard_normal(levels.shape))


def encoded(light: FloatArray) -> FloatArray:
    """IEC 61966-2-1, from 0 to 1."""
    power = 1.055 * np.maximum(light, 1e-9) ** (1 / 2.4) - 0.055
    return np.asarray(np.where(light <= 0.0031308, 12.92 * light, power))


def scene() -> FloatArray:
    return np.random.default_rng(7).normal(500.0, 80.0, (96, 96))


def hole() -> BoolArray:
    mask = np.zeros((96, 96), dtype=np.bool_)
    mask[40:44, 40:44] = True
    return mask


def with_hole(levels: FloatArray, mask: BoolArray, behind: float) -> "np.ma.MaskedArray[Any, Any]":
    return np.ma.array(np.where(mask, behind, levels), mask=mask)


@pytest.mark.parametrize("behind", [1e6, np.nan])
def test_what_is_behind_a_mask_comes_out_of_no_function_that_needs_whole_pictures(
    behind: float,
) -> None:
    masked = with_hole(scene(), hole(), behind)
    task = standoff.DetectionTask(zooms=(1.0,), models=("matched",), observers=("npw",))
    for call in (
        lambda: standoff.zoom_out(masked, 2.0, PSF),
        lambda: standoff.simulate(masked, zoom=2.0, psf=PSF),
        lambda: standoff.simulate_pose(masked, np.eye(3), PSF),
        lambda: standoff.d_prime_curves([masked], PSF, task),
    ):
        with pytest.raises(ImageFileError, match=r"16 of its 9216 pixels are masked.*fill"):
            call()


def test_an_array_without_a_masked_sample_is_whole() -> None:
    masked = np.ma.array(scene(), mask=np.zeros((96, 96), dtype=np.bool_))
    found = standoff.zoom_out(masked, 2.0, PSF)
    assert np.array_equal(found, standoff.zoom_out(scene(), 2.0, PSF))


def test_masked_pixels_take_the_levels_beside_them() -> None:
    found = photograph_of(with_hole(scene(), hole(), 1e6), "image")
    assert found.masked is not None
    assert np.array_equal(found.masked, hole())
    assert np.array_equal(found.stored[~hole()], scene()[~hole()])
    assert found.stored.max() == scene()[~hole()].max()


@pytest.mark.slow
def test_an_edge_that_a_mask_lies_on_is_flagged_and_others_are_not() -> None:
    levels, mask = noisy(edge(), 2.0), np.zeros((SIZE, SIZE), dtype=np.bool_)
    mask[60:80, :] = True
    [across] = standoff.measure_edges(with_hole(levels, mask, 1e6))
    assert "masked" in across.flags
    with pytest.raises(CalibrationError, match="masked"):
        standoff.calibrate_psf(with_hole(levels, mask, 1e6))
    mask[:], mask[10:14, 10:14] = False, True
    [beside] = standoff.measure_edges(with_hole(levels, mask, 1e6))
    [whole] = standoff.measure_edges(levels)
    assert beside.flags == whole.flags == ()
    assert beside.sigma_px == whole.sigma_px


@pytest.mark.slow
def test_masked_pixels_of_either_photograph_are_not_compared() -> None:
    rng = np.random.default_rng(2)
    y, x = np.mgrid[:128, :128]
    waves = (np.sin(x / a + b) * np.sin(y / c) for a, b, c in rng.uniform(2, 6, (9, 3)))
    levels = 500 + 60 * sum(waves)
    before, after = (levels + rng.normal(0, 2, levels.shape) for _ in range(2))
    mask = np.zeros(levels.shape, dtype=np.bool_)
    mask[30:44, 70:84] = True
    found = standoff.find_changes(before, np.where(mask, after + 300, after))
    assert len(found.summary.changes) == 1
    for pair in (
        (before, with_hole(after, mask, 1e6)),
        (with_hole(before, mask, 1e6), after),
    ):
        found = standoff.find_changes(*pair)
        assert found.summary.changes == ()
        assert not found.valid[mask].any()
        assert found.valid[90:120, 10:60].all()
        assert standoff.register(*pair).zoom == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("as_integers", [True, False])
def test_reading_counts_for_arrays(as_integers: bool) -> None:
    light = noisy(edge(), 2.0) / 1000
    levels: Any = encoded(light)
    if as_integers:
        levels = np.round(255 * levels).astype(np.uint8)
    [found] = standoff.measure_edges(levels, reading=standoff.reading("srgb"))
    # Steps of 8 bits, and noise of 0.25 % of the contrast.
    assert found.sigma_px == pytest.approx(0.7, abs=0.01)
    [linear] = standoff.measure_edges(levels)
    assert linear.sigma_px > 0.73


def test_a_stack_has_its_pages_along_the_first_axis() -> None:
    frames = np.stack([noisy(edge(), sd) for sd in (4.0, 6.0, 8.0)])
    second = photograph_of(frames, "image", standoff.reading(page=2))
    assert np.array_equal(second.stored, frames[1])
    mean = photograph_of(frames, "image", standoff.reading(mean=True))
    assert np.allclose(mean.stored, frames.mean(axis=0))
    assert mean.variance_dn2 is not None
    assert np.allclose(mean.variance_dn2, frames.var(axis=0, ddof=1))
    assert mean.frames == 3
    with pytest.raises(ImageFileError, match="--page 4"):
        photograph_of(frames, "image", standoff.reading(page=4))
    with pytest.raises(ImageFileError, match="first of 3 axes"):
        photograph_of(frames[0], "image", standoff.reading(mean=True))


def test_a_photograph_that_was_read_is_taken_as_the_options_say(tmp_path: Path) -> None:
    levels = np.round(255 * encoded(edge() / 1000)).astype(np.uint8)
    Image.fromarray(levels).save(tmp_path / "a.png")
    linear = read_photograph(tmp_path / "a.png", standoff.reading("linear"))
    again = taken_as(linear, standoff.reading("srgb", white_level=200))
    assert np.array_equal(again.grey_dn, read_photograph(tmp_path / "a.png").grey_dn)
    assert again.saturation_dn is not None
    assert again.saturation_dn < 200
    with pytest.raises(ImageFileError, match="read already"):
        taken_as(linear, standoff.reading(page=1))


@pytest.mark.parametrize("mode", ["L", "RGB", "P", "LA", "I;16", "F"])
def test_a_picture_of_pillow_has_the_levels_of_its_file(tmp_path: Path, mode: str) -> None:
    levels = np.round(255 * encoded(edge() / 1000)).astype(np.uint8)
    if mode in ("I;16", "F"):
        levels = levels.astype(np.uint16 if mode == "I;16" else np.float32)
        picture = Image.fromarray(levels)
    else:
        picture = Image.fromarray(levels).convert(mode)
    path = tmp_path / ("a.tif" if mode == "F" else "a.png")
    picture.save(path)
    given, stored = photograph_of(picture, "image"), read_photograph(path)
    assert np.allclose(given.grey_dn, stored.grey_dn)
    assert given.encoding.name == stored.encoding.name


def test_planes_beside_grey_and_colours_are_not_dropped() -> None:
    grey, other = scene(), scene()[::-1]
    for planes in ([grey, other], [grey, grey, grey, other]):
        with pytest.raises(ImageFileError, match="neither grey nor RGB"):
            photograph_of(np.dstack(planes), "image")
    opaque = photograph_of(np.dstack([grey, np.full_like(grey, 255.0)]), "image")
    assert np.array_equal(opaque.stored, grey)
    with pytest.raises(ImageFileError, match=r"moveaxis\(image, 0, -1\)"):
        photograph_of(np.stack([grey, grey, grey]), "image")


def test_an_opacity_that_varies_is_left_out_with_a_word(tmp_path: Path) -> None:
    picture = Image.fromarray(np.uint8(scene().clip(0, 999) / 4)).convert("RGBA")
    picture.putalpha(Image.fromarray(np.uint8(scene().clip(0, 999) / 4)))
    picture.save(tmp_path / "a.png")
    said = read_photograph(tmp_path / "a.png").remarks.values()
    assert any("its opacity" in one for one in said)


@pytest.mark.parametrize("high", [1.05, 1.2, 2.0])
@pytest.mark.parametrize("sigma_px", [0.4, 0.7, 1.5])
@pytest.mark.parametrize("sd", [0.0, 0.004])
def test_floats_that_were_cut_off_are_known_as_clipped(
    high: float, sigma_px: float, sd: float
) -> None:
    levels = np.minimum(noisy(edge(sigma_px, 0.1, high), sd), 1.0)
    assert photograph_of(levels, "image").saturation_dn == 1.0


def test_a_clipped_edge_of_floats_is_flagged_and_the_level_can_be_stated() -> None:
    levels = np.minimum(noisy(edge(0.7, 0.1, 1.2), 0.004), 1.0)
    [found] = standoff.measure_edges(levels)
    assert {"clipped", "saturated"} & set(found.flags)
    [stated] = standoff.measure_edges(levels, white_level=3.0)
    assert not {"clipped", "saturated"} & set(stated.flags)
    assert stated.sigma_px < 0.6  # what it was without a word


def test_levels_that_were_cut_off_at_0_are_clipped_at_black() -> None:
    levels = np.maximum(noisy(edge(0.7, -0.1, 0.8), 0.004), 0.0)
    found = photograph_of(levels, "image").saturation_dn
    assert found is not None
    assert found > levels.max()
    [measured] = standoff.measure_edges(levels)
    assert {"clipped", "saturated"} & set(measured.flags)


def area_sampled() -> FloatArray:
    y, x = (np.mgrid[: 8 * SIZE, : 8 * SIZE] + 0.5) / 8 - SIZE / 2
    inside = x * np.cos(np.radians(5)) + y * np.sin(np.radians(5)) > 0
    return np.asarray(inside.astype(float).reshape(SIZE, 8, SIZE, 8).mean(axis=(1, 3)))


@pytest.mark.parametrize(
    "levels",
    [
        edge(0.3),
        edge(0.7),
        edge(4.0),
        edge(0.7, 0.0, 1.0),
        edge(0.7).astype(np.float32),
        np.round(edge(0.7, 20, 230)) / 255,
        np.round(edge(2.0, 20, 230)) / 255,
        noisy(edge(0.7), 3.0),
        np.round(noisy(edge(0.7, 20, 230), 1.0)) / 255,
        area_sampled(),
        np.full((80, 80), 700.0),
        scene(),
        np.kron(np.indices((8, 8)).sum(axis=0) % 2, np.ones((20, 20))),
    ],
)
def test_light_that_ends_of_itself_is_not_clipped(levels: FloatArray) -> None:
    assert photograph_of(levels, "image").saturation_dn is None


def test_white_of_a_file_and_of_an_array_is_stated_alike(tmp_path: Path) -> None:
    levels = np.full((20, 30), 90, dtype=np.uint8)
    Image.fromarray(levels).save(tmp_path / "a.png")
    options = ReadOptions(white_level=200.0)
    assert photograph_of(levels, "image", options).saturation_dn == 200.0
    encoded_white = read_photograph(tmp_path / "a.png", options).saturation_dn
    assert encoded_white == pytest.approx(255 * ((200 / 255 + 0.055) / 1.055) ** 2.4)
