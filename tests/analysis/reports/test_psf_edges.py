import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from matplotlib.figure import Figure

from analysis.reports._psf_edges import (
    LABEL_POINTS,
    curves_section,
    placed_labels,
    plot_curves_of_edges,
    plot_edges,
    plot_profile,
    plot_widths_by_angle,
)
from calibration.edges import EdgeImage, EdgeMeasurement, edge_profile, edges_of_image
from calibration.psf import PsfCalibration
from calibration.sharpness import with_sharpness
from tests.calibration.closed_form import edge_image
from tests.calibration.sharpness.edges import edge_of

SIGMA_PX = 0.8


@pytest.fixture(scope="module")
def edge() -> EdgeMeasurement:
    source = EdgeImage(name="edge.tif", image_dn=edge_image(SIGMA_PX, 5.0))
    [found] = with_sharpness(edges_of_image(source), source)
    return found


def test_each_edge_has_a_row_of_esf_lsf_and_sfr(edge: EdgeMeasurement) -> None:
    figure = plot_curves_of_edges([edge, edge], has_image=False)
    assert len(figure.axes) == 6
    assert [axes.get_ylabel() for axes in figure.axes[:3]] == ["ESF", "LSF / (1/px)", "SFR"]
    titles = [room.get_suptitle() for room in figure.subfigs]
    assert titles[0].startswith(f"({edge.x_px:.0f}, {edge.y_px:.0f})")
    assert f"MTF50 {edge.esfr_mtf50_cy_per_px:.3f}" in titles[0]
    assert titles[0].endswith(" cy/px")


def test_the_curves_are_those_of_the_gaussian_that_was_photographed(edge: EdgeMeasurement) -> None:
    esf, lsf, sfr = plot_curves_of_edges([edge], has_image=False).axes
    distance, levels = np.asarray(esf.get_lines()[1].get_data(), dtype=np.float64)
    # 16-bit rounding and a spline of knots every quarter px.
    np.testing.assert_allclose(levels, edge_profile(distance, SIGMA_PX), atol=2e-3)
    distance, slope = np.asarray(lsf.get_lines()[0].get_data(), dtype=np.float64)
    truth = np.exp(-0.5 * (distance / SIGMA_PX) ** 2) / (np.sqrt(2 * np.pi) * SIGMA_PX)
    np.testing.assert_allclose(slope, truth, atol=5e-3)
    freq, contrast = np.asarray(sfr.get_lines()[0].get_data(), dtype=np.float64)
    np.testing.assert_allclose(contrast, np.exp(-2 * (np.pi * SIGMA_PX * freq) ** 2), atol=3e-3)


def test_the_line_spread_is_the_slope_of_the_edge_spread(edge: EdgeMeasurement) -> None:
    assert edge.esfr is not None
    distance = np.linspace(-30, 30, 6001)
    slope = np.gradient(edge.esfr.esf(distance), distance)
    # Second differences over 0.01 px; at the ends of the band the tail joins with a kink.
    np.testing.assert_allclose(slope[1:-1], edge.esfr.lsf(distance)[1:-1], atol=2e-3)
    assert edge.esfr.esf(np.array([-1e6, 1e6])) == pytest.approx([0.0, 1.0], abs=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize(("count", "figures"), [(1, 1), (5, 1), (12, 3), (300, 5)])
def test_one_twelve_and_three_hundred_edges_fill_few_pages(
    edge: EdgeMeasurement, count: int, figures: int
) -> None:
    edges = [
        edge.model_copy(update={"x_px": 10.0 * (k % 20), "y_px": 10.0 * (k // 20)})
        for k in range(count)
    ]
    section = curves_section(PsfCalibration(edges=tuple(edges)))
    assert section is not None
    assert len(section.figures) == figures
    assert all(figure.width_in <= 7.3 for figure in section.figures)
    is_cut = any("24 of 300 edges are shown" in line for line in section.text)
    assert is_cut is (count == 300)


@pytest.mark.slow
def test_the_softest_and_the_sharpest_edge_are_always_among_those_shown(
    edge: EdgeMeasurement, monkeypatch: pytest.MonkeyPatch
) -> None:
    shown: list[EdgeMeasurement] = []

    def keep(edges: list[EdgeMeasurement], *, has_image: bool) -> object:
        shown.extend(edges)
        return plot_curves_of_edges(edges[:1], has_image=has_image)

    monkeypatch.setattr("analysis.reports._psf_edges.plot_curves_of_edges", keep)
    rng = np.random.default_rng(3)
    edges = [
        edge.model_copy(update={"x_px": x, "y_px": y, "esfr_mtf50_cy_per_px": mtf50})
        for x, y, mtf50 in rng.uniform([0, 0, 0.1], [700, 500, 0.4], (200, 3)).tolist()
    ]
    assert curves_section(PsfCalibration(edges=tuple(edges))) is not None
    values = [one.esfr_mtf50_cy_per_px or 0.0 for one in edges]
    kept = [one.esfr_mtf50_cy_per_px for one in shown]
    assert len(kept) == 24
    assert {min(values), max(values)} <= set(kept)


def test_edges_read_from_a_file_have_no_curves() -> None:
    assert curves_section(PsfCalibration(edges=(edge_of(),))) is None
    with pytest.raises(ValueError, match="no e-SFR"):
        plot_curves_of_edges([edge_of()], has_image=False)


WIDTH_PX, HEIGHT_PX, PX_PER_IN = 640, 480, 100.0
PLACES = st.lists(
    st.tuples(st.floats(0, WIDTH_PX), st.floats(0, HEIGHT_PX), st.floats(0.1, 0.4)),
    min_size=2,
    max_size=80,
)


@settings(max_examples=60)
@given(places=PLACES)
def test_no_two_labels_overlap_and_none_leaves_the_photograph(
    places: list[tuple[float, float, float]],
) -> None:
    edges = [edge_of(x_px=x, y_px=y, mtf50_cy_per_px=mtf50) for x, y, mtf50 in places]
    labels = placed_labels(edges, WIDTH_PX, HEIGHT_PX, PX_PER_IN)
    # Five letters of half their size at least, one line high.
    width, height = 5 * 0.5 * LABEL_POINTS / 72 * PX_PER_IN, LABEL_POINTS / 72 * PX_PER_IN
    for k, one in enumerate(labels):
        assert width / 2 <= one.x_px <= WIDTH_PX - width / 2
        assert height / 2 <= one.y_px <= HEIGHT_PX - height / 2
        for other in labels[:k]:
            assert abs(one.x_px - other.x_px) >= width or abs(one.y_px - other.y_px) >= height


def test_where_labels_are_thinned_those_of_the_extremes_stay() -> None:
    grid = [(20.0 + 6 * i, 20.0 + 6 * k) for i in range(90) for k in range(70)]
    edges = [edge_of(x_px=x, y_px=y, mtf50_cy_per_px=0.25) for x, y in grid[::7]]
    edges[40] = edge_of(x_px=300.0, y_px=200.0, mtf50_cy_per_px=0.111)
    edges[50] = edge_of(x_px=100.0, y_px=300.0, mtf50_cy_per_px=0.444)
    texts = [label.text for label in placed_labels(edges, WIDTH_PX, HEIGHT_PX, PX_PER_IN)]
    assert texts[:2] == ["0.111", "0.444"]
    assert 20 < len(texts) <= 70


def test_labels_on_the_photograph_are_of_8_points_and_not_of_rejected_edges() -> None:
    edges = [
        edge_of(x_px=50.0, y_px=40.0, mtf50_cy_per_px=0.222),
        edge_of(x_px=150.0, y_px=140.0, mtf50_cy_per_px=0.333, flags=["saturated"]),
    ]
    figure = plot_edges(np.eye(200, 240), edges, frozenset({"saturated"}), 7.2)
    texts = figure.axes[0].texts
    assert [text.get_text() for text in texts] == ["0.222"]
    assert texts[0].get_fontsize() == 8.0


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
