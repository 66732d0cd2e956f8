import numpy as np
import pytest

from analysis.reports.psf.plots import plot_field, plot_heights, plot_mtf, plot_transfer_2d
from calibration.edges import AxisTransfer, MeasuredTransfer, gaussian_mtf50, pixel_mtf50
from calibration.psf import PsfCalibration, Transfer2d
from tests.analysis.reports.psf.test_edge_plots import legend_of
from tests.calibration.edge_field import FIELD
from tests.calibration.sharpness.edges import edge_of

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
