"""Lateral chromatic aberration over the field, against fields in closed form."""

from math import hypot

import numpy as np
import pytest

from benchmarks.truth.focus_scenes import FocusedLens, chart, squares
from calibration.edges import EdgeImage, EdgeMeasurement, EdgeSelection
from calibration.lens import LateralColourField, lateral_fields
from calibration.sharpness import Picture, with_sharpness
from simulation.arrays import FloatArray
from tests.calibration.sharpness.edges import edge_of

WIDTH, HEIGHT = 640, 480
PICTURE = Picture(width_px=WIDTH, height_px=HEIGHT, pixel_pitch_um=None)
HALF = 0.5 * hypot(WIDTH - 1, HEIGHT - 1)
ERR_PX = 0.003


def shifted(
    terms: tuple[float, float, float, float], rng: np.random.Generator, count: int = 40
) -> list[EdgeMeasurement]:
    """Edges anywhere whose red lies beside green as the terms say, and whose blue does not."""
    found = []
    for _ in range(count):
        x, y, angle = rng.uniform(0, WIDTH), rng.uniform(0, HEIGHT), rng.uniform(0, 180)
        normal = np.deg2rad(angle + 90)
        right, down = (x - (WIDTH - 1) / 2) / HALF, (y - (HEIGHT - 1) / 2) / HALF
        grown = terms[2] + terms[3] * (right**2 + down**2)
        across = np.cos(normal) * (terms[0] + grown * right)
        across += np.sin(normal) * (terms[1] + grown * down)
        outward = 1 if right * np.cos(normal) + down * np.sin(normal) >= 0 else -1
        found.append(
            edge_of().model_copy(
                update={
                    **{"x_px": x, "y_px": y, "angle_deg": angle},
                    "red_shift_px": outward * across + rng.normal(0, ERR_PX),
                    "blue_shift_px": rng.normal(0, ERR_PX),
                    **{"red_shift_err_px": ERR_PX, "blue_shift_err_px": ERR_PX},
                }
            )
        )
    return found


def both(edges: list[EdgeMeasurement]) -> tuple[LateralColourField, LateralColourField]:
    red, blue = lateral_fields(edges, PICTURE)
    assert (red.colour, blue.colour) == ("red", "blue")
    return red, blue


def test_the_field_is_that_of_the_closed_form() -> None:
    terms = (0.05, -0.03, 0.4, -0.1)
    red, blue = both(shifted(terms, np.random.default_rng(1)))
    assert red.is_found
    assert not blue.is_found
    assert red.growth.value * HALF == pytest.approx(0.4, abs=4 * red.growth.err * HALF)
    for one in red.vectors:
        right, down = (one.x_px - (WIDTH - 1) / 2) / HALF, (one.y_px - (HEIGHT - 1) / 2) / HALF
        grown = terms[2] + terms[3] * (right**2 + down**2)
        assert one.right_px == pytest.approx(terms[0] + grown * right, abs=4 * one.err_px)
        assert one.down_px == pytest.approx(terms[1] + grown * down, abs=4 * one.err_px)
        assert one.err_px < ERR_PX
    assert red.worst_px.value == max(hypot(one.right_px, one.down_px) for one in red.vectors)
    assert f"({red.worst.x_px:.0f}, {red.worst.y_px:.0f})" in red.sentence
    assert blue.sentence.startswith("Blue: none beyond its error")


def test_a_lens_without_it_shows_none_beyond_its_error() -> None:
    rng = np.random.default_rng(2)
    found = [one for _ in range(200) for one in both(shifted((0, 0, 0, 0), rng))]
    assert sum(one.is_found for one in found) <= 12  # 1 % of 400, and three standard deviations
    inside = [
        (one.right_px / one.err_px) ** 2 + (one.down_px / one.err_px) ** 2
        for field in found
        for one in field.vectors[:1]
    ]
    assert np.mean(np.array(inside) < 5.99) == pytest.approx(0.95, abs=0.05)  # chi-squared of two


def test_edges_of_one_direction_do_not_tell_it() -> None:
    edges = [
        edge.model_copy(update={"angle_deg": 90.0, "y_px": 240.0})
        for edge in shifted((0, 0, 0.3, 0), np.random.default_rng(3))
    ]
    assert lateral_fields(edges, PICTURE) == ()
    assert lateral_fields(edges[:7], PICTURE) == ()


def photographed(growths: tuple[float, float, float]) -> FloatArray:
    """A chart whose colours are of different sizes."""
    lens = FocusedLens(
        width_px=WIDTH, height_px=HEIGHT, best_mm=0.0, sigma_px=0.7, blur_px_per_mm=0.0,
        tangential_mm=0.0, sagittal_mm=0.0, tilt_x_mm=0.0, tilt_y_mm=0.0,
    )  # fmt: skip
    middles = squares(lens, 5, 4)
    planes = [chart(lens, middles, 30.0, 6.0, 0.0, growth) for growth in growths]
    return np.stack(planes, axis=2)


@pytest.mark.slow
@pytest.mark.parametrize("growth", [1.0, 1.002])
def test_a_rendered_chart_tells_the_size_of_its_colours(growth: float) -> None:
    colours = photographed((growth, 1.0, 1.0))
    colours += np.random.default_rng(4).normal(0, 15.0, colours.shape)
    luma = colours @ np.array([0.299, 0.587, 0.114])
    source = EdgeImage(name="chart", image_dn=luma, colours_dn=colours)
    edges = with_sharpness(EdgeSelection().measured_in(source, "all-angles"), source)
    used = [edge for edge in edges if edge.is_used]
    red, blue = both(used)
    assert red.growth.value == pytest.approx(growth - 1, abs=4 * red.growth.err)
    assert red.growth.err < 5e-5
    assert red.is_found is (growth != 1.0)
    assert not blue.is_found
    corner = (growth - 1) * hypot(
        red.worst.x_px - (WIDTH - 1) / 2, red.worst.y_px - (HEIGHT - 1) / 2
    )
    assert red.worst_px.value == pytest.approx(corner, abs=4 * red.worst_px.err)
