from collections.abc import Mapping

import numpy as np
import pytest

from analysis.reports.psf.field_map import (
    field_map_section,
    lateral_colour_section,
    plot_by_radius,
    plot_field_map,
    plot_lateral_colour,
)
from calibration.edges import EdgeMeasurement
from calibration.psf import PsfCalibration
from tests.analysis.reports.psf.test_edge_plots import legend_of
from tests.calibration.sharpness.edges import edge_of

WIDTH, HEIGHT = 401, 301


def ring(count: int = 12, changes: Mapping[str, object] | None = None) -> list[EdgeMeasurement]:
    """Edges on a circle of 100 px about the centre, in turn across the radius and along it."""
    edges = []
    for k, turn in enumerate(np.linspace(0, 2 * np.pi, count, endpoint=False).tolist()):
        is_across = k % 2 == 0
        edges.append(
            edge_of(
                float(np.rad2deg(turn) + (90 if is_across else 0)) % 180,
                x_px=200 + 100 * np.cos(turn),
                y_px=150 + 100 * np.sin(turn),
                esfr_mtf50_cy_per_px=0.3 if is_across else 0.2,
                esfr_mtf50_err_cy_per_px=0.01,
                **(changes or {}),
            )
        )
    return edges


def calibration(edges: list[EdgeMeasurement]) -> PsfCalibration:
    return PsfCalibration(edges=tuple(edges), picture_width_px=WIDTH, picture_height_px=HEIGHT)


def test_meridional_and_sagittal_edges_have_a_map_each() -> None:
    left, right, _ = plot_field_map(ring(), WIDTH, HEIGHT).axes
    assert (left.get_title(), right.get_title()) == ("meridional, 6 edges", "sagittal, 6 edges")
    shades = [np.asarray(axes.collections[0].get_array()) for axes in (left, right)]
    np.testing.assert_allclose(shades[0], 0.3)
    np.testing.assert_allclose(shades[1], 0.2)
    assert left.get_ylim() == (HEIGHT - 0.5, -0.5)


def test_a_direction_without_edges_has_no_empty_map() -> None:
    meridional = ring()[::2]
    [axes, _] = plot_field_map(meridional, WIDTH, HEIGHT).axes
    assert axes.get_title() == "meridional, 6 edges"


def test_the_median_of_a_ring_is_drawn_for_each_direction() -> None:
    figure = plot_by_radius(ring(), WIDTH, HEIGHT)
    assert legend_of(figure) == ["meridional", "sagittal"]
    medians = [
        np.asarray(line.get_data())[:, 0]
        for line in figure.axes[0].get_lines()
        if line.get_linestyle() == "-"
    ]
    drawn = {round(float(level), 6) for _, level in medians}
    assert {0.3, 0.2} <= drawn
    # 100 px of a half diagonal of 250 px.
    assert medians[-1][0] == pytest.approx(0.4)


def test_an_outlier_does_not_set_the_scale() -> None:
    edges = [*ring(40), edge_of(x_px=10.0, y_px=10.0, mtf50_cy_per_px=0.95)]
    assert plot_by_radius(edges, WIDTH, HEIGHT).axes[0].get_ylim()[1] < 0.65


def test_few_edges_or_edges_at_the_centre_alone_are_no_map() -> None:
    assert field_map_section(calibration(ring())) is not None
    assert field_map_section(calibration(ring(4))) is None
    central = [edge_of(x_px=200.0, y_px=150.0)] * 12
    assert field_map_section(calibration(central)) is None
    assert field_map_section(PsfCalibration(edges=tuple(ring()))) is None


def test_lateral_colour_is_drawn_against_the_radius_along_the_normal() -> None:
    shifts = {
        "red_shift_px": 0.2, "red_shift_err_px": 0.01, "blue_shift_px": -0.1,
        "blue_shift_err_px": 0.02,
    }  # fmt: skip
    figure = plot_lateral_colour(ring(changes=shifts), WIDTH, HEIGHT)
    assert legend_of(figure) == ["red from green", "blue from green"]
    red = np.asarray(figure.axes[0].get_lines()[0].get_data())
    # Edges across the radius have all of its 100 px along their normal, those along it none.
    assert sorted({round(x) for x in red[0].tolist()}) == [0, 100]
    section = lateral_colour_section(calibration(ring(changes=shifts)))
    assert section is not None
    assert section.tables[0].rows[0][1:] == ("0.200 ± 0.020", "-0.100 ± 0.039")
    few = lateral_colour_section(calibration(ring(4, shifts)))
    assert few is not None
    assert (len(few.tables[0].rows), few.figures) == (4, ())
    assert lateral_colour_section(calibration(ring())) is None
