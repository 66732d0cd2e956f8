from collections.abc import Mapping

import numpy as np
import pytest

from analysis.reports._psf_field import (
    field_map_section,
    lateral_colour_section,
    plot_by_radius,
    plot_field,
    plot_field_map,
    plot_heights,
    plot_lateral_colour,
    plot_mtf,
    plot_transfer_2d,
)
from calibration.edges import (
    AxisTransfer,
    EdgeMeasurement,
    MeasuredTransfer,
    gaussian_mtf50,
    pixel_mtf50,
)
from calibration.psf import PsfCalibration, Transfer2d
from tests.analysis.reports.test_psf_edges import legend_of
from tests.calibration.edge_field import FIELD
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


@pytest.mark.slow
def test_few_edges_or_edges_at_the_centre_alone_are_no_map() -> None:
    assert field_map_section(calibration(ring())) is not None
    assert field_map_section(calibration(ring(4))) is None
    central = [edge_of(x_px=200.0, y_px=150.0)] * 12
    assert field_map_section(calibration(central)) is None
    assert field_map_section(PsfCalibration(edges=tuple(ring()))) is None


@pytest.mark.slow
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


def test_the_map_of_lateral_colour_is_on_the_page_where_edges_tell_it() -> None:
    shifts = {
        "red_shift_px": 0.2, "red_shift_err_px": 0.01, "blue_shift_px": 0.0,
        "blue_shift_err_px": 0.02,
    }  # fmt: skip
    outer = ring(changes=shifts)
    inner = [one.model_copy(update={"x_px": 0.5 * (one.x_px + 200)}) for one in outer]
    # Edges at one distance from the centre do not tell size from third order.
    many, few = (lateral_colour_section(calibration(edges)) for edges in ([*outer, *inner], outer))
    assert many is not None
    assert few is not None
    captions = [one.caption for one in many.figures]
    assert any("over the field" in one for one in captions)
    assert any(one.startswith("Blue: none beyond its error") for one in many.text)
    assert not any("over the field" in one.caption for one in few.figures)


NONE: frozenset[str] = frozenset()


def test_the_mtf_names_its_frequency_of_half_contrast() -> None:
    figure = plot_mtf(
        PsfCalibration(
            sigma_x_px=0.8, sigma_y_px=0.7, optical_sigma_x_px=None, optical_sigma_y_px=0.6
        )
    )
    assert figure is not None
    assert legend_of(figure) == [
        f"along x, Gaussian: MTF50 {gaussian_mtf50(0.8):.3f} cy/px",
        f"along y, Gaussian: MTF50 {pixel_mtf50(0.6, 0.0):.3f} cy/px",
    ]


def test_the_measured_curve_stands_beside_the_gaussian() -> None:
    freq = np.linspace(0, 1, 51)
    curve = AxisTransfer(freq_cy_per_px=freq.tolist(), mtf=(1 - 0.8 * freq).tolist())
    figure = plot_mtf(PsfCalibration(sigma_x_px=0.8, transfer=MeasuredTransfer(x=curve)))
    assert figure is not None
    # By hand: 1 - 0.8 f = 0.5 at 0.625.
    assert legend_of(figure)[0] == "along x, e-SFR: MTF50 0.625 cy/px"
    high = AxisTransfer(freq_cy_per_px=freq.tolist(), mtf=(1 - 0.1 * freq).tolist())
    sharp = plot_mtf(PsfCalibration(transfer=MeasuredTransfer(y=high)))
    assert sharp is not None
    assert legend_of(sharp) == ["along y, e-SFR: MTF50 beyond 1 cy/px"]


def test_without_a_width_or_a_curve_there_is_no_mtf() -> None:
    assert plot_mtf(PsfCalibration()) is None


def test_the_transfer_is_drawn_along_both_axes_and_diagonals_with_its_band() -> None:
    transfer = Transfer2d(
        form="total-gaussian",
        reason="",
        parameters={"gaussian_xx_px2": 0.36, "gaussian_yy_px2": 0.25},
        covariance=((1e-4,), (0.0, 1e-4)),
        angles_deg=(0.0, 90.0),
        edges=2,
        chi2_reduced=1.0,
        scatter=1.0,
    )
    figure = plot_transfer_2d(transfer)
    axes = figure.axes[0]
    assert legend_of(figure) == ["along x", "at 45 deg", "along y", "at 135 deg"]
    freq, values = np.asarray(axes.lines[0].get_data())
    np.testing.assert_allclose(values, np.exp(-2 * np.pi**2 * 0.36 * freq**2), atol=1e-12)
    # d/dv exp(-2 pi^2 v f^2) = -2 pi^2 f^2 of it; the variance is known to 0.01.
    reach = 1.96 * 0.01 * 2 * np.pi**2 * freq**2 * values
    upper = np.asarray(axes.collections[0].get_paths()[0].vertices)[:, 1].max()
    assert upper == pytest.approx((values + reach).max(), abs=1e-9)
    assert len(axes.collections) == 4


def test_a_direction_that_no_edge_tells_does_not_set_the_scale_of_the_transfer() -> None:
    unknown = Transfer2d(
        form="total-gaussian",
        reason="",
        parameters={"gaussian_xx_px2": 0.36, "gaussian_yy_px2": 0.25},
        covariance=((1e-4,), (0.0, 100.0)),
        angles_deg=(0.0,),
        edges=1,
        chi2_reduced=1.0,
        scatter=1.0,
    )
    axes = plot_transfer_2d(unknown).axes[0]
    assert axes.get_ylim() == pytest.approx((-0.08, 1.08))


def test_the_field_is_mapped_over_its_frame() -> None:
    figure = plot_field(PsfCalibration(edges=(edge_of(),)), FIELD)
    axes = figure.axes[0]
    assert axes.get_xlim() == (-0.5, 519.5)
    assert axes.get_ylim() == (389.5, -0.5)
    shown = axes.get_images()[0].get_array()
    assert shown is not None
    # The map's middle is the fourth root of the determinant there.
    xx, xy, yy = FIELD.coefficients_px2[:, 0]
    assert np.asarray(shown)[30, 30] == pytest.approx((xx * yy - xy**2) ** 0.25, rel=1e-6)
    assert figure.axes[1].get_ylabel() == "total sigma, geometric mean / px"


def test_widths_by_height_need_two_heights(psf: PsfCalibration) -> None:
    figure = plot_heights(psf, NONE)
    assert figure is not None
    assert psf.height_trend is not None
    assert len(figure.axes) == 2
    assert any("% per 100 mm" in text for text in legend_of(figure))
    one = [edge for edge in psf.edges if edge.height_mm == psf.edges[0].height_mm]
    assert plot_heights(psf.model_copy(update={"edges": one}), NONE) is None
    unknown = [edge.model_copy(update={"height_mm": None}) for edge in psf.edges]
    assert plot_heights(psf.model_copy(update={"edges": unknown}), NONE) is None


def test_without_a_trend_the_edges_are_shown_alone(psf: PsfCalibration) -> None:
    figure = plot_heights(psf.model_copy(update={"height_trend": None}), NONE)
    assert figure is not None
    assert len(figure.axes) == 1
