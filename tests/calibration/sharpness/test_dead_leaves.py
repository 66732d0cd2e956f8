"""Dead leaves: found by their picture, and measured as the closed form says."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from benchmarks.studies.siemens_star import edges_beside
from benchmarks.truth.dead_leaves import Print, dead_leaves, photograph
from calibration.edges import EdgeImage, EdgeSelection
from calibration.lens import TextureFigures, texture_figures
from calibration.sharpness import find_dead_leaves, measure_dead_leaves
from simulation.arrays import FloatArray
from tests.calibration.known import known

SIGMA_PX = 0.7
SHAPE = (440, 450)
PRINT = Print(x_px=21.3, y_px=15.8, scale=0.5)
LEVEL_DN = 3000.0


@cache
def target() -> FloatArray:
    return dead_leaves(np.random.default_rng(7), 800, (3.0, 100.0))


def pose(printed: Print) -> FloatArray:
    turn = np.deg2rad(printed.turn_deg)
    right, down = printed.scale * np.cos(turn), printed.scale * np.sin(turn)
    first = 0.5 * np.array([right - down, right + down])
    return np.array([
        [right, -down, printed.x_px + first[0]], [down, right, printed.y_px + first[1]], [0, 0, 1],
    ])  # fmt: skip


def noisy(light: FloatArray, noise_dn: float, seed: int = 1) -> FloatArray:
    return LEVEL_DN * light + np.random.default_rng(seed).normal(0, noise_dn, light.shape)


def transfer(freq: FloatArray, sigma_px: float = SIGMA_PX) -> FloatArray:
    turns = np.linspace(0, np.pi, 90, endpoint=False)
    pixel = np.sinc(np.outer(freq, np.cos(turns))) * np.sinc(np.outer(freq, np.sin(turns)))
    lens = np.exp(-2 * np.pi**2 * sigma_px**2 * freq**2)
    return np.asarray(np.mean(lens[:, None] * pixel, axis=1))


def test_the_exact_renderer_agrees_with_the_one_that_samples() -> None:
    small = target()[:200, :200]
    where = Print(x_px=12.3, y_px=9.8, scale=0.5)
    exact = photograph(small, where, (120, 130), (0.7, 0.9))
    turned = Print(x_px=12.3, y_px=9.8, scale=0.5, turn_deg=1e-9)
    sampled = photograph(small, turned, (120, 130), (0.7, 0.9))
    assert np.sqrt(np.mean((exact - sampled) ** 2)) < 0.005  # 8 samples a pixel


def test_light_is_neither_lost_nor_won() -> None:
    squares = np.random.default_rng(3).uniform(0, 1, (40, 40))
    seen = photograph(squares, Print(x_px=20, y_px=20, scale=0.8), (80, 80), (1.0, 0.6))
    assert float((seen - 0.5).sum()) == pytest.approx(0.8**2 * float((squares - 0.5).sum()))


@pytest.mark.parametrize(
    "printed", [PRINT, Print(x_px=120.0, y_px=12.0, scale=0.42, turn_deg=12.0)]
)
def test_the_curve_is_that_of_the_closed_form(printed: Print) -> None:
    image = noisy(photograph(target(), printed, SHAPE, (SIGMA_PX, SIGMA_PX)), 18.0)
    found = known(measure_dead_leaves(image, target(), pose(printed), 18.0))
    left = found.intrinsic - transfer(found.freq_cy_per_px)
    assert np.abs(left.mean()) < 0.002
    assert np.sqrt(np.mean(left**2)) < 0.004
    assert np.mean(np.abs(left) < 2 * np.hypot(found.intrinsic_err, 0.002)) > 0.9
    direct = known(found.direct)
    below = found.freq_cy_per_px < 0.35  # beyond, aliases and noise count
    assert np.abs(direct - found.intrinsic)[below].max() < 0.02


def test_noise_is_no_texture() -> None:
    light = photograph(target(), PRINT, SHAPE, (SIGMA_PX, SIGMA_PX))
    found = known(measure_dead_leaves(noisy(light, 150.0), target(), pose(PRINT), None))
    high = found.freq_cy_per_px > 0.4
    left = (found.intrinsic - transfer(found.freq_cy_per_px))[high]
    assert abs(left.mean()) < 4 * np.linalg.norm(found.intrinsic_err[high]) / high.sum()
    assert found.direct is None
    # The direct method counts as texture what the noise exceeds the stated one by.
    wrong = known(measure_dead_leaves(noisy(light, 150.0), target(), pose(PRINT), 0.0))
    assert (known(wrong.direct) - transfer(found.freq_cy_per_px))[high].min() > 0.1


def test_a_lens_that_distorts_does_no_harm() -> None:
    light = photograph(target(), PRINT, SHAPE, (0.9, 0.9))
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    right, down = (x - 225) / 225, (y - 220) / 220
    grown = 1 + 0.01 * (right**2 + down**2)  # 4 px in the corners
    bent = map_coordinates(light, [220 + 220 * down * grown, 225 + 225 * right * grown], order=5)
    found = known(measure_dead_leaves(noisy(bent, 10.0), target(), pose(PRINT), 10.0))
    # Where the picture shrinks by 1 to 5 %, the Gaussian does, too.
    low = found.freq_cy_per_px < 0.3
    ratio = found.intrinsic[low] / transfer(found.freq_cy_per_px[low], 0.9 / 1.01)
    assert np.abs(ratio - 1).max() < 0.03


def test_it_is_found_to_hundredths_of_a_pixel() -> None:
    image = noisy(photograph(target(), PRINT, SHAPE, (SIGMA_PX, SIGMA_PX)), 36.0)
    found = known(find_dead_leaves(image, target()))
    corners = np.array([[0, 799, 799, 0], [0, 0, 799, 799], [1, 1, 1, 1]])
    seen, true = found @ corners, pose(PRINT) @ corners
    assert np.abs(seen[:2] / seen[2] - true[:2]).max() < 0.05


@pytest.mark.slow
def test_dead_leaves_of_another_target_are_not_this_one() -> None:
    other = dead_leaves(np.random.default_rng(8), 400, (3.0, 100.0))
    image = noisy(photograph(other, PRINT, (230, 240), (SIGMA_PX, SIGMA_PX)), 20.0)
    assert find_dead_leaves(image, target()[:400, :400]) is None


def measured(image: FloatArray, picture: FloatArray | None = None) -> TextureFigures:
    source = EdgeImage(name="leaves", image_dn=image)
    edges = EdgeSelection().measured_in(source, "all-angles")
    used = [edge for edge in edges if edge.is_used]
    assert len(used) == 16  # no leaf
    return known(texture_figures(source, target() if picture is None else picture, used))


def with_edges(noise_dn: float) -> FloatArray:
    light = photograph(target(), PRINT, SHAPE, (SIGMA_PX, SIGMA_PX))
    both = edges_beside(LEVEL_DN * light, SIGMA_PX)
    return both + np.random.default_rng(5).normal(0, noise_dn, both.shape)


def test_texture_is_as_sharp_as_edges_behind_the_same_lens() -> None:
    found = measured(with_edges(36.0))
    ratio = known(found.over_edges)
    assert ratio.value == pytest.approx(1.0, abs=3 * ratio.err)
    assert ratio.err < 0.01
    assert not found.is_lost
    assert found.sentence.startswith("No sign that texture is lost")


def test_a_filter_that_keeps_edges_is_named() -> None:
    smooth = cv2.bilateralFilter(with_edges(50.0).astype(np.float32), 7, 200.0, 2.0)
    found = measured(smooth.astype(np.float64))
    assert found.is_lost
    assert "Texture loses contrast that edges keep" in found.sentence


def test_a_lens_less_sharp_at_the_target_is_named_as_what_looks_the_same() -> None:
    light = photograph(target(), PRINT, SHAPE, (0.8, 0.8))
    both = edges_beside(LEVEL_DN * light, SIGMA_PX)
    found = measured(both + np.random.default_rng(5).normal(0, 36.0, both.shape))
    assert found.is_lost
    assert "or where the lens is less sharp at the target than at the edges" in found.sentence


def test_a_picture_coarser_than_what_was_printed_is_named() -> None:
    coarse = target().reshape(400, 2, 400, 2).mean(axis=(1, 3))
    found = measured(with_edges(36.0), coarse)
    half = known(found.figures.mtf50_cy_per_px)
    assert half.value > 0.2468 + 10 * half.err
    assert found.is_beyond_edges
    assert "coarser than what was printed" in found.sentence
    assert not measured(with_edges(36.0)).is_beyond_edges


def test_leaves_that_are_clipped_do_not_count() -> None:
    image = noisy(photograph(target(), PRINT, SHAPE, (SIGMA_PX, SIGMA_PX)), 36.0)
    image[:, 225:] = np.minimum(image[:, 225:], 1900.0)  # a third of the right half
    bright = np.zeros(image.shape, np.bool_)
    bright[:, 225:] = image[:, 225:] >= 1900.0
    whole = EdgeImage(name="leaves", image_dn=image)
    wrong = known(texture_figures(whole, target(), []))
    found = known(texture_figures(replace(whole, clipped=bright), target(), []))
    assert known(found.figures.mtf50_cy_per_px).value == pytest.approx(0.2468, rel=0.02)
    assert known(wrong.figures.mtf50_cy_per_px).value > 1.02 * 0.2468
    everywhere = replace(whole, image_dn=np.minimum(image, 1900.0), saturation_dn=1900.0)
    assert texture_figures(everywhere, target(), []) is None
    assert (
        texture_figures(replace(whole, masked=np.ones(image.shape, np.bool_)), target(), []) is None
    )


def test_without_edges_nothing_is_said_of_loss() -> None:
    image = noisy(photograph(target(), PRINT, SHAPE, (SIGMA_PX, SIGMA_PX)), 18.0)
    found = known(texture_figures(EdgeImage(name="leaves", image_dn=image), target(), []))
    assert found.over_edges is None
    assert found.direct is None
    assert not found.is_lost
    assert known(found.figures.mtf50_cy_per_px).value == pytest.approx(0.2468, rel=0.01)


@pytest.mark.parametrize("printed", [Print(x_px=150.0, y_px=150.0, scale=0.1)])
def test_a_target_of_fewer_than_nine_tiles_is_not_measured(printed: Print) -> None:
    image = noisy(photograph(target(), printed, SHAPE, (SIGMA_PX, SIGMA_PX)), 18.0)
    assert measure_dead_leaves(image, target(), pose(printed), 18.0) is None
