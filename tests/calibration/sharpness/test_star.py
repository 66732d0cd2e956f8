"""Siemens stars: found in the frame, and measured as their closed form says."""

from collections.abc import Callable
from importlib.resources import files
from math import cos, pi, sin

import numpy as np
import pytest
from PIL import Image
from scipy.optimize import brentq

from benchmarks.truth.focus_scenes import FocusedLens, chart
from benchmarks.truth.siemens_stars import Star
from calibration.edges import EdgeImage, EdgeSelection
from calibration.lens import star_figures
from calibration.sharpness import StarPlace, find_star, mean_of_sectors, measure_star
from simulation.arrays import FloatArray
from tests.calibration.known import known

STAR = Star(x_px=210.37, y_px=195.71, cycles=48, radius_px=180.0)
SHAPE = (390, 430)
SIGMA_PX = 0.7


def transfer(freq: FloatArray, direction_deg: float, stretch: float = 1.0) -> FloatArray:
    """Mean contrast of the waves of a sector behind the Gaussian and the pixel."""
    turns = np.deg2rad(direction_deg) + np.linspace(-pi / 8, pi / 8, 65)
    waves = []
    for turn in turns.tolist():
        x, y = freq * sin(turn), freq * cos(turn)
        lens = np.exp(-2 * (pi * SIGMA_PX) ** 2 * ((stretch * x) ** 2 + y**2))
        waves.append(lens * np.sinc(x) * np.sinc(y))
    return np.asarray(np.mean(waves, axis=0))


def frequency_of(level: float) -> float:
    return float(np.mean([
        brentq(lambda f, t=turn: float(transfer(np.array([f]), t)[0]) - level, 0.01, 0.9)
        for turn in (22.5, 67.5)
    ]))  # fmt: skip


def noisy(image: FloatArray, noise_dn: float = 15.0, seed: int = 1) -> FloatArray:
    return image + np.random.default_rng(seed).normal(0, noise_dn, image.shape)


def test_the_locally_plane_wave_is_the_exact_star() -> None:
    # A Gaussian that is elliptic by nothing: both renderers must agree inside the rim.
    exact = STAR.photograph(SHAPE, SIGMA_PX)
    plane = STAR.photograph(SHAPE, SIGMA_PX, stretch=1.0 + 1e-12)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    radius = np.hypot(x - STAR.x_px, y - STAR.y_px)
    inside = (radius > 40) & (radius < 175)
    assert np.abs(exact - plane)[inside].max() < 0.001 * STAR.mean_dn


@pytest.mark.parametrize("is_square", [False, True])
def test_a_star_is_found_with_its_centre_and_cycles(*, is_square: bool) -> None:
    star = Star(x_px=210.37, y_px=195.71, cycles=48, radius_px=180.0, is_square=is_square)
    place = known(find_star(noisy(star.photograph(SHAPE, SIGMA_PX))))
    assert place.cycles == 48
    assert (place.x_px, place.y_px) == pytest.approx((210.37, 195.71), abs=0.01)
    assert place.outer_px == pytest.approx(180.0, abs=4)


@pytest.mark.parametrize(("is_square", "stretch"), [(False, 1.0), (True, 1.0), (False, 1.3)])
def test_every_sector_has_the_contrast_of_the_closed_form(
    *, is_square: bool, stretch: float
) -> None:
    star = Star(x_px=210.37, y_px=195.71, cycles=48, radius_px=180.0, is_square=is_square)
    image = noisy(star.photograph(SHAPE, SIGMA_PX, stretch))
    found = known(measure_star(image, known(find_star(image)), None))
    assert found.scaled_by == "extrapolation"
    for turn, mtf, err in zip(found.sector_deg, found.mtf, found.mtf_err, strict=True):
        left = mtf - transfer(found.freq_cy_per_px, turn, stretch)
        seen = np.isfinite(left)
        assert seen.mean() > 0.9
        assert abs(left[seen].mean()) < 0.005
        assert np.sqrt(np.mean((left[seen] / err[seen]) ** 2)) < 1.5  # of errors as stated: 1


def test_the_figures_are_within_one_per_cent() -> None:
    figures = known(star_figures("star", noisy(STAR.photograph(SHAPE, SIGMA_PX)), [])).figures
    for value, level in ((figures.mtf50_cy_per_px, 0.5), (figures.mtf20_cy_per_px, 0.2)):
        assert known(value).value == pytest.approx(frequency_of(level), rel=0.01)


def test_edges_of_the_photograph_say_what_1_is() -> None:
    lens = FocusedLens(
        width_px=640, height_px=390, best_mm=0.0, sigma_px=SIGMA_PX, blur_px_per_mm=0.0,
        tangential_mm=0.0, sagittal_mm=0.0, tilt_x_mm=0.0, tilt_y_mm=0.0,
    )  # fmt: skip
    image = chart(lens, [(520.0, 90.0), (520.0, 200.0), (520.0, 310.0)], 32.0, 6.0, 0.0)
    image[:, :420] = STAR.photograph((390, 420), SIGMA_PX)
    source = EdgeImage(name="both", image_dn=noisy(image))
    edges = EdgeSelection().measured_in(source, "all-angles")
    used = [edge for edge in edges if edge.is_used]
    assert len(used) == 12  # no spoke
    assert any("star_spoke" in edge.flags for edge in edges)
    found = known(star_figures("both", source.image_dn, used))
    assert found.scaled_by == "edges"
    ratio = known(found.mtf50_over_edges)
    assert ratio.value == pytest.approx(1.0, abs=4 * ratio.err)
    assert ratio.err < 0.01


def test_a_chart_of_edges_is_no_star() -> None:
    lens = FocusedLens(
        width_px=420, height_px=320, best_mm=0.0, sigma_px=SIGMA_PX, blur_px_per_mm=0.0,
        tangential_mm=0.0, sagittal_mm=0.0, tilt_x_mm=0.0, tilt_y_mm=0.0,
    )  # fmt: skip
    image = chart(lens, [(100.0, 90.0), (300.0, 90.0), (100.0, 230.0)], 32.0, 6.0, 0.0)
    assert find_star(noisy(image)) is None
    edges = EdgeSelection().measured_in(EdgeImage(name="chart", image_dn=image), "all-angles")
    assert not any("star_spoke" in edge.flags for edge in edges)


@pytest.mark.parametrize("name", ["coins.png", "camera.png", "text.png"])
def test_a_picture_without_a_star_has_none(name: str) -> None:
    with (files("skimage") / "data" / name).open("rb") as stream, Image.open(stream) as opened:
        assert find_star(np.asarray(opened.convert("L"), dtype=np.float64)) is None


def test_noise_alone_is_no_star() -> None:
    assert find_star(noisy(np.full((300, 300), 500.0), 30.0)) is None
    assert find_star(np.full((300, 300), 500.0)) is None


def test_a_star_without_contrast_has_no_figures() -> None:
    place = StarPlace(x_px=150.0, y_px=150.0, cycles=48, inner_px=20.0, outer_px=140.0)
    assert measure_star(noisy(np.full((300, 300), 500.0)), place, None) is None


def star_behind(mtf_of: Callable[[FloatArray], FloatArray], cycles: int) -> FloatArray:
    """A sinusoidal star behind any round transfer: a plane wave about each point."""
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]]
    right, down = x - STAR.x_px, y - STAR.y_px
    radius = np.maximum(np.hypot(right, down), 1.0)
    wave = mtf_of(cycles / (2 * pi * radius)) * np.cos(cycles * np.arctan2(down, right))
    return np.asarray(1500.0 * (1 + 0.8 * wave * (radius <= STAR.radius_px)))


def of_diffraction(freq: FloatArray) -> FloatArray:
    share = np.clip(freq / 0.8, 0, 1)
    return np.asarray(2 / pi * (np.arccos(share) - share * np.sqrt(1 - share**2)))


@pytest.mark.parametrize("cycles", [36, 72, 144])
def test_a_lens_limited_by_diffraction_is_within_the_stated_errors(cycles: int) -> None:
    # Its transfer falls from 0 on like a line: even powers alone miss contrast 1 by 3 to 9 %.
    image = noisy(star_behind(of_diffraction, cycles), noise_dn=6.0)
    half = known(known(star_figures("star", image, [])).figures.mtf50_cy_per_px)
    truth = float(brentq(lambda f: float(of_diffraction(np.array([f]))[0]) - 0.5, 0.01, 0.79))
    assert abs(half.value - truth) <= 3 * half.err
    assert half.value == pytest.approx(truth, rel=0.02)


def test_low_contrasts_are_within_the_stated_errors() -> None:
    def gaussian(freq: FloatArray) -> FloatArray:
        return np.asarray(np.exp(-2 * (pi * 1.1 * freq) ** 2))

    for seed in range(4):
        image = noisy(star_behind(gaussian, 72), noise_dn=4.0, seed=seed)
        figures = known(star_figures("star", image, [])).figures
        for found, level in (
            (figures.mtf20_cy_per_px, 0.2),
            (figures.mtf10_cy_per_px, 0.1),
        ):
            truth = float(np.sqrt(-np.log(level) / 2) / (pi * 1.1))
            assert known(found).value == pytest.approx(truth, rel=0.003)
            assert abs(known(found).value - truth) <= 3.5 * known(found).err


def test_sectors_weigh_the_same_where_lens_and_direction_differ() -> None:
    mtf, err = np.array([[0.9], [0.5]]), np.array([[0.01], [0.1]])
    mean, spread = mean_of_sectors(mtf, err)
    assert mean == pytest.approx([0.7])
    assert spread == pytest.approx([0.5 * np.hypot(0.01, 0.1)])
