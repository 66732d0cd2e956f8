"""What a report says about a PSF that changes: with angle, height and place in the frame."""

from analysis.calibration_plots import plot_widths_by_angle
from analysis.psf_plots import plot_field, plot_heights
from analysis.report_page import ReportFigure, ReportSection, ReportTable
from calibration.errors import PsfFileError
from calibration.files import StoredPsf
from calibration.psf_calibration import REJECTING_FLAGS

__all__ = ["field_section", "widths_section", "with_err"]


def widths_section(psf: StoredPsf) -> ReportSection:
    """Show the width across every edge by its angle and the height of the camera."""
    figures = [
        ReportFigure.of(
            plot_widths_by_angle(psf, REJECTING_FLAGS),
            "Width across each edge with its standard error; the curve is the fitted covariance.",
        )
    ]
    by_height = plot_heights(psf, REJECTING_FLAGS)
    if by_height is not None:
        figures.append(
            ReportFigure.of(
                by_height,
                "Width against the height of the camera: every edge, and all of a height "
                "together against the mean of the calibration.",
            )
        )
    return ReportSection(
        title="Width by angle and height",
        text=_trend_text(psf),
        tables=_heights_table(psf),
        figures=tuple(figures),
    )


def _trend_text(psf: StoredPsf) -> tuple[str, ...]:
    trend = psf.height_trend
    if trend is None:
        return ()
    p_value = min(trend.p_value, trend.p_value_between)
    if trend.is_drift:
        return (
            f"The width changes with the height (p = {p_value:.2g}): the focus drifts, or the "
            "target is not sharp enough for the nearest height. Calibrate at one height, or "
            "refocus.",
        )
    return (f"No change of the width with the height beyond chance or 1 % (p = {p_value:.2g}).",)


def _heights_table(psf: StoredPsf) -> tuple[ReportTable, ...]:
    if psf.height_trend is None:
        return ()
    rows = tuple(
        (
            f"{group.height_mm:.3f}",
            str(group.edges),
            with_err(group.sigma_x_px, group.sigma_x_err_px),
            with_err(group.sigma_y_px, group.sigma_y_err_px),
            f"{100 * (group.relative_width - 1):+.2f} ± {100 * group.relative_width_err:.2f}",
        )
        for group in psf.height_trend.heights
    )
    columns = (
        "height / mm",
        "edges",
        "median sigma x / px",
        "median sigma y / px",
        "against the mean / %",
    )
    return (ReportTable(columns=columns, rows=rows, caption="Total widths by height."),)


def field_section(psf: StoredPsf) -> ReportSection | None:
    """Show the PSF from centre to corner; None for a psf.json without edges and field."""
    try:
        field = psf.total_field("psf.json")
    except PsfFileError as error:
        return ReportSection(title="From centre to corner", text=(f"Left out: {error}.",))
    if field is None:
        if not psf.edges:
            return None
        return ReportSection(
            title="From centre to corner",
            text=(
                "No PSF field: there are too few edges over the frame (36 in several directions "
                "at the least) to tell one, or they show no change beyond chance.",
            ),
        )
    width, height = field.width_px, field.height_px
    places = (
        ("centre", (width - 1) / 2, (height - 1) / 2),
        ("top left", 0.0, 0.0),
        ("top right", width - 1.0, 0.0),
        ("bottom left", 0.0, height - 1.0),
        ("bottom right", width - 1.0, height - 1.0),
    )
    rows = []
    for name, x, y in places:
        (xx, xy), (_, yy) = field.covariance_px2(x, y).tolist()
        rows.append((name, f"{xx**0.5:.4f}", f"{yy**0.5:.4f}", f"{xy / (xx * yy) ** 0.5:+.3f}"))
    stored = psf.field
    sure = ""
    if stored is not None and stored.worst_err is not None and stored.p_value is not None:
        sure = (
            f" An F-test prefers it to one PSF for the frame (p = {stored.p_value:.1g}); no width "
            f"in the frame is less sure than {100 * stored.worst_err:.1f} %."
        )
    return ReportSection(
        title="From centre to corner",
        text=("A quadratic polynomial of each element of the covariance over the frame." + sure,),
        tables=(
            ReportTable(
                columns=("place", "total sigma x / px", "total sigma y / px", "rho"),
                rows=tuple(rows),
            ),
        ),
        figures=(
            ReportFigure.of(
                plot_field(psf, field),
                "Total width over the frame. Ellipses: shape of the PSF there, all to one scale, "
                "enlarged. Dots: places of the edges.",
            ),
        ),
    )


def with_err(value: float | None, err: float | None) -> str:
    """Text of a value with its standard error; empty where there is none."""
    return "" if value is None or err is None else f"{value:.4f} ± {err:.4f}"
