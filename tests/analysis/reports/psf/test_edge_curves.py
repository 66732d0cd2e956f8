import numpy as np
import pytest

from analysis.reports.psf.edge_curves import curves_section, plot_curves_of_edges
from calibration.edges import EdgeImage, EdgeMeasurement, edge_profile, measure_edges
from calibration.psf import PsfCalibration
from calibration.sharpness import with_sharpness
from tests.calibration.closed_form import edge_image
from tests.calibration.sharpness.edges import edge_of

SIGMA_PX = 0.8


@pytest.fixture(scope="module")
def edge() -> EdgeMeasurement:
    source = EdgeImage(name="edge.tif", image_dn=edge_image(SIGMA_PX, 5.0))
    [found] = with_sharpness(measure_edges(source), source)
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

    monkeypatch.setattr("analysis.reports.psf.edge_curves.plot_curves_of_edges", keep)
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
