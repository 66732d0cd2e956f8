import numpy as np
import pytest

from calibration.edges import EdgeImage, EdgeLine, edges_of_image, pixel_mtf50
from calibration.edges._shading import _Shading, is_even, slope_left, slopes_across
from simulation.arrays import FloatArray
from tests.calibration.closed_form import edge_image
from tests.calibration.squares import square_cover

DARK_DN, BRIGHT_DN = 8_000.0, 52_000.0
ROWS, COLS = 120, 160


def shading(image: FloatArray, x_px: float, normal_deg: float) -> _Shading:
    """Of an edge of 80 px, from 11 px beside it on."""
    line = EdgeLine(x_px, 0.5 * ROWS, float(np.deg2rad(normal_deg)), 40.0)
    return slopes_across(image.astype(np.float32), line, 11.0, np.inf, BRIGHT_DN - DARK_DN)


def step(x_px: float, normal_deg: float) -> FloatArray:
    """Two even levels that meet at a line through (x_px, half of the rows)."""
    y, x = np.mgrid[:ROWS, :COLS] - np.array([0.5 * ROWS, x_px])[:, None, None]
    normal = np.deg2rad(normal_deg)
    is_bright = np.cos(normal) * x + np.sin(normal) * y > 0
    return np.asarray(np.where(is_bright, BRIGHT_DN, DARK_DN))


@pytest.mark.parametrize("normal_deg", [0.0, 0.5, 1.0, -0.5])
def test_even_levels_have_no_shading_wherever_the_frame_cuts_what_lies_beside(
    normal_deg: float,
) -> None:
    # To a single column of the far zone, and to one of the near one.
    for to_frame_px in np.arange(11.0, 46.0, 0.37).tolist():
        x_px = COLS - 1 - to_frame_px
        assert is_even(shading(step(x_px, normal_deg), x_px, normal_deg)), to_frame_px


def test_a_slope_is_found_where_most_of_the_far_zone_is_within_the_frame() -> None:
    slope_dn_per_px = 20.0
    x_px = COLS - 1 - 38.0  # the far zone begins 27 px from the edge
    image = step(x_px, 0.0)
    image[:, int(x_px) + 1 :] += slope_dn_per_px * (np.arange(int(x_px) + 1, COLS) - x_px)
    noise = np.random.default_rng(1).normal(0, 1.0, image.shape)
    # 1 DN over 11 columns of 20 pixels and more, and a clean dark side.
    found = shading(image + noise, x_px, 0.0)
    assert found.bright == pytest.approx(slope_dn_per_px, abs=0.1)
    assert found.dark == 0.0


@pytest.mark.parametrize("to_frame_px", [60.0, 34.0, 24.0, 18.0, 14.0])
def test_light_is_taken_off_a_side_that_the_frame_cuts(to_frame_px: float) -> None:
    x_px = COLS - 1 - to_frame_px
    relative_per_px = 1e-3
    lit = step(x_px, 0.0) * (1 + relative_per_px * (np.arange(COLS) - x_px))
    noise = np.random.default_rng(2).normal(0, 1.0, lit.shape)
    found = shading(lit + noise, x_px, 0.0)
    assert found.dark == pytest.approx(relative_per_px * DARK_DN, rel=0.05)
    assert found.bright == pytest.approx(relative_per_px * BRIGHT_DN, rel=0.05)


def test_a_tail_that_is_alike_on_both_sides_of_a_cut_frame_is_no_light() -> None:
    # The profile of a Lorentzian beside the step: 1 / (pi d) of the contrast, 6 % at 5 px.
    x_px = COLS - 1 - 24.0
    image = step(x_px, 0.0)
    away = np.arange(COLS) - x_px
    tail = 0.02 * (BRIGHT_DN - DARK_DN) / np.maximum(np.abs(away), 1.0)
    found = shading(image - np.sign(away) * tail, x_px, 0.0)
    assert found.dark == found.bright == 0.0


@pytest.mark.parametrize("margin_px", [20.0, 30.0])
@pytest.mark.parametrize("sigma_px", [0.9, 1.5])
def test_squares_near_the_frame_in_uneven_light_give_the_contrast_of_even_light(
    sigma_px: float, margin_px: float
) -> None:
    side = 60 + 2 * int(margin_px)
    cover = square_cover((side / 2 - 0.2, side / 2 - 0.7), 60.0, 7.0, sigma_px, (side, side))
    y, x = np.mgrid[:side, :side] / (side - 1.0) - 0.5
    for light in (1 + 0.15 * x, 1 + 0.35 * x, 1 + 0.25 * (x + y)):
        for levels in ((BRIGHT_DN, DARK_DN), (DARK_DN, BRIGHT_DN)):
            image = (levels[0] + (levels[1] - levels[0]) * cover) * light
            edges = edges_of_image(EdgeImage(name="", image_dn=image))
            assert len(edges) == 4
            for edge in edges:
                truth = pixel_mtf50(sigma_px, edge.normal_rad)
                # 5 and 10 % without; a square whose outer side has no pixels beyond the band keeps
                # what its inside tells.
                assert edge.esfr_mtf50_cy_per_px == pytest.approx(truth, rel=0.006)
                assert edge.optical_sigma_px == pytest.approx(sigma_px, rel=0.006)


def left(image: FloatArray, x_px: float) -> float:
    """Slope that is left beside an upright edge of 80 px, in DN/px."""
    line = EdgeLine(x_px, 0.5 * ROWS, 0.0, 40.0)
    return slope_left(image.astype(np.float32), line, 11.0, np.inf, (DARK_DN, BRIGHT_DN))


def test_a_faint_slope_in_proportion_to_the_light_is_left_and_one_alike_on_both_sides_is_not() -> (
    None
):
    rng = np.random.default_rng(3)
    x_px = 0.5 * COLS
    across = np.arange(COLS) - x_px
    even = step(x_px, 0.0) + 500.0 * rng.standard_normal((ROWS, COLS))
    relative_per_px = 2e-4  # 10 DN/px of the bright side: four of its standard errors
    lit = even * (1 + relative_per_px * across)
    assert shading(lit, x_px, 0.0) == shading(even, x_px, 0.0)  # too little to take it off
    assert left(lit, x_px) == pytest.approx(relative_per_px * BRIGHT_DN, rel=0.4)
    alike = even + relative_per_px * BRIGHT_DN * across  # as the tail of a PSF is
    assert left(even, x_px) == left(alike, x_px) == 0.0


@pytest.mark.slow
def test_errors_of_small_edges_contain_the_light_that_falls_off() -> None:
    # Closed-form edges: light falls off by a third over 512 px, in any direction. Errors over
    # stated ones are 0.96 of MTF50 and 0.87 of sigma in 1,000 edges, with standard errors of 0.09
    # in 60; without the slope that is left they are 2.4 and 1.3.
    rng = np.random.default_rng(11)
    rows, cols = shape = (70, 90)
    y, x = np.mgrid[:rows, :cols] - 0.5 * np.array(shape)[:, None, None]
    errors = []
    for _ in range(60):
        normal_deg, bearing = rng.uniform(3, 40), rng.uniform(0, 2 * np.pi)
        image = edge_image(
            0.95, normal_deg, has_pixel=True, shape=shape, low_dn=150.0, high_dn=2300.0
        )
        image *= 1 + 0.35 * (np.cos(bearing) * x + np.sin(bearing) * y) / 512
        image += np.sqrt(9 + image / 4) * rng.standard_normal(shape)
        edge = max(edges_of_image(EdgeImage(name="", image_dn=image)), key=lambda e: e.length_px)
        assert edge.esfr_mtf50_cy_per_px
        assert edge.esfr_mtf50_err_cy_per_px
        assert edge.optical_sigma_px
        assert edge.optical_sigma_err_px
        truth = pixel_mtf50(0.95, np.deg2rad(normal_deg))
        errors.append(
            (
                (edge.esfr_mtf50_cy_per_px - truth) / edge.esfr_mtf50_err_cy_per_px,
                (edge.optical_sigma_px - 0.95) / edge.optical_sigma_err_px,
            )
        )
    of_mtf50, of_sigma = np.sqrt(np.mean(np.square(errors), axis=0))
    assert 0.6 < of_mtf50 < 1.3
    assert 0.5 < of_sigma < 1.2
