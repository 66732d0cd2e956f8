import numpy as np
import pytest
from matplotlib.figure import Figure

from analysis.reports.psf.edge_plots import plot_edges, plot_profile, plot_widths_by_angle
from calibration.psf import PsfCalibration
from tests.calibration.closed_form import edge_image
from tests.calibration.sharpness.edges import edge_of

NONE: frozenset[str] = frozenset()


def legend_of(figure: Figure) -> list[str]:
    legends = [*figure.legends, *(axes.get_legend() for axes in figure.axes)]
    return [text.get_text() for legend in legends if legend for text in legend.get_texts()]


def test_an_edge_is_drawn_along_its_direction_over_its_length() -> None:
    figure = plot_edges(np.eye(90, 110), [edge_of(30.0)], NONE)
    [line] = figure.axes[0].get_lines()
    x, y = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
    # By hand: 30 px to either side of (55, 45), at 30 degrees with y down.
    np.testing.assert_allclose(x, [55 - 30 * np.cos(np.pi / 6), 55 + 30 * np.cos(np.pi / 6)])
    np.testing.assert_allclose(y, [45 - 15, 45 + 15])
    assert figure.axes[0].get_ylim() == (89.5, -0.5)


def test_rejected_edges_are_dashed_and_named_once() -> None:
    edges = [edge_of(), edge_of(flags=["saturated"]), edge_of(flags=["saturated"])]
    figure = plot_edges(np.eye(90, 110), edges, frozenset({"saturated"}))
    assert [line.get_linestyle() for line in figure.axes[0].get_lines()] == ["-", "--", "--"]
    assert sorted(legend_of(figure)) == ["not used", "vertical"]


def test_a_flat_photograph_without_edges_can_still_be_drawn() -> None:
    figure = plot_edges(np.full((20, 30), 5.0), [], NONE)
    assert legend_of(figure) == []


@pytest.mark.parametrize("angle_deg", [95.0, 275.0])
def test_the_profile_rises_whichever_side_is_bright(angle_deg: float) -> None:
    image = edge_image(0.64, angle_deg - 90.0, offset_px=0.0, has_pixel=True)
    figure = plot_profile(image, edge_of(95.0, x_px=54.5, y_px=44.5))
    upper, lower = figure.axes
    pixels, fit = upper.get_lines()
    places = np.asarray(pixels.get_xdata(), dtype=np.float64)
    levels = np.asarray(pixels.get_ydata(), dtype=np.float64)
    assert np.corrcoef(places, levels)[0, 1] > 0.7
    # The pixels lie on the fit: the residual stays below 0.1 % of the contrast.
    residuals = np.asarray(lower.get_lines()[0].get_ydata(), dtype=np.float64)
    assert np.abs(residuals).max() < 0.1
    assert fit.get_label() == "fit, optical sigma 0.640 px"


def test_an_edge_without_optical_width_is_drawn_with_its_total_one() -> None:
    image = edge_image(0.3, 5.0, offset_px=0.0)
    edge = edge_of(
        95.0, x_px=54.5, y_px=44.5, sigma_px=0.3, optical_sigma_px=None, optical_sigma_err_px=None
    )
    assert "fit, total sigma 0.300 px" in legend_of(plot_profile(image, edge))


@pytest.mark.slow
def test_every_width_stands_at_its_angle_with_its_error(psf: PsfCalibration) -> None:
    figure = plot_widths_by_angle(psf, NONE)
    # Each edge has a total and an optical width; two curves for the two covariances.
    assert len(figure.axes[0].containers) == 2 * len(psf.edges)
    curves = [line for line in figure.axes[0].get_lines() if len(np.asarray(line.get_xdata())) > 9]
    assert len(curves) == 2
    assert {"total covariance", "optical covariance", "open: optical"} <= set(legend_of(figure))
    # Column by column: the directions stand in the first row.
    assert legend_of(figure)[::2] == ["vertical", "horizontal", "diagonal"]
    # At 90 degrees the normal is the x axis: the curve is there at sigma_x.
    assert np.asarray(curves[0].get_ydata())[180] == pytest.approx(psf.sigma_x_px)


def test_rejected_edges_have_no_width_to_show(psf: PsfCalibration) -> None:
    flagged = [psf.edges[0].model_copy(update={"flags": ["saturated"]}), *psf.edges[1:]]
    figure = plot_widths_by_angle(
        psf.model_copy(update={"edges": flagged}), frozenset({"saturated"})
    )
    assert len(figure.axes[0].containers) == 2 * (len(psf.edges) - 1)


def test_a_mosaic_is_drawn_and_its_profile_taken_from_its_own_colour_alone() -> None:
    image = edge_image(0.7, 5.0)
    red = np.full(image.shape, np.nan)
    red[::2, 1::2] = image[::2, 1::2]
    edge = edge_of(95.0, x_px=54.5 + 0.37, y_px=44.5, optical_sigma_px=None)
    drawn = plot_edges(red, [edge], NONE).axes[0].get_images()[0].get_array()
    assert drawn is not None
    assert np.isfinite(np.asarray(drawn)).all()
    upper, _ = plot_profile(red, edge).axes
    levels = np.asarray(upper.get_lines()[0].get_ydata())
    assert np.isfinite(levels).all()
    # A pixel in four of a band of about 14.4 by 60 px.
    assert levels.size == pytest.approx(60 * 2 * (6 * 0.7 + 3) / 4, rel=0.05)


def test_an_edge_that_is_hardly_known_does_not_set_the_scale() -> None:
    psf = PsfCalibration(edges=(edge_of(), edge_of(93.0, sigma_px=0.8, sigma_err_px=500.0)))
    low, high = plot_widths_by_angle(psf, NONE).axes[0].get_ylim()
    assert 0.5 < low < 0.64
    assert 0.8 < high < 0.9
