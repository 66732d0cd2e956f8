"""Report sections on a PSF: headline figures, edges, profiles, widths, MTF."""

from collections.abc import Callable
from itertools import groupby
from pathlib import PurePath

from analysis.reports.edge_plots import plot_edges, plot_profile
from analysis.reports.page import ReportFigure, ReportSection, ReportTable, Verdict
from analysis.reports.psf_plots import (
    field_section,
    plot_mtf,
    plot_transfer_2d,
    widths_section,
    with_err,
)
from calibration.edges import REJECTING_FLAGS, EdgeMeasurement
from calibration.psf import PsfCalibration
from simulation.arrays import FloatImage

ImageLoader = Callable[[EdgeMeasurement], FloatImage]

_IMAGES_SHOWN = 4
_DIRECTION_STEP_DEG = 15.0
_EDGES_LISTED = 200


def calibration_verdicts(psf: PsfCalibration) -> tuple[Verdict, ...]:
    """Return the headline figures: total widths and correlation, with their 95 % intervals."""
    used = [edge for edge in psf.edges if not REJECTING_FLAGS & set(edge.flags)]
    verdicts = [
        Verdict(
            name=name,
            value=_figure(value, unit),
            remark=_remark(psf, key, value),
        )
        for name, key, value, unit in (
            ("total sigma x", "sigma_x_px", psf.sigma_x_px, " px"),
            ("total sigma y", "sigma_y_px", psf.sigma_y_px, " px"),
            ("correlation rho", "rho", psf.rho, ""),
        )
    ]
    verdicts.append(
        Verdict(name="edges used", value=str(len(used)), remark=f"of {len(psf.edges)} found")
    )
    return tuple(verdicts)


def calibration_sections(
    psf: PsfCalibration, load_image: ImageLoader, images: frozenset[str] | None = None
) -> tuple[ReportSection, ...]:
    """Return the sections on a PSF, except the list of edges.

    Parameters
    ----------
    psf
        What psf.json holds.
    load_image
        Gives the linear image that an edge was measured on, shape ``(rows, cols)``.
    images
        Names of the photographs that are at hand, None for all. Edges of others are in the
        widths and tables, but cannot be drawn; the report says so.
    """
    sections = [_psf_section(psf)]
    if psf.edges:
        drawn = [edge for edge in psf.edges if images is None or edge.image in images]
        missing = len(psf.edges) - len(drawn)
        if drawn:
            sections += [
                _edges_section(drawn, load_image, missing),
                _profiles_section(drawn, load_image),
            ]
        else:
            sections.append(ReportSection(title="Edges", text=_missing_text(missing)))
        sections.append(widths_section(psf))
    if (field := field_section(psf)) is not None:
        sections.append(field)
    return tuple(sections)


def _missing_text(missing: int) -> tuple[str, ...]:
    if missing == 0:
        return ()
    return (
        f"{missing} edges of this psf.json are on photographs that are not available here: they "
        "count in the widths and are listed in the tables, but are not drawn.",
    )


def _psf_section(psf: PsfCalibration) -> ReportSection:
    rows = []
    for name, key, unit in (
        ("sigma x", "sigma_x_px", "px"),
        ("sigma y", "sigma_y_px", "px"),
        ("rho", "rho", ""),
    ):
        cells = []
        for prefix in ("", "optical_"):
            value = getattr(psf, f"{prefix}{key}")
            cells += [_figure(value, ""), _interval(psf, f"{prefix}{key}", value)]
        rows.append((f"{name} / {unit}" if unit else name, *cells))
    mtf = plot_mtf(psf)
    figures = []
    if mtf is not None:
        figures.append(
            ReportFigure.of(
                mtf,
                "Contrast at each frequency, optics and pixel together. The e-SFR is measured "
                "without a model (median over edges); where it departs from the Gaussian curve, "
                "the PSF is not Gaussian.",
            )
        )
    if psf.transfer_2d is not None:
        figures.append(
            ReportFigure.of(
                plot_transfer_2d(psf.transfer_2d),
                "Transfer function of optics and pixel, fitted to the pixels of all edges at once, "
                f"with its pointwise 95 % band: {psf.transfer_2d}. Below 0, light and dark are "
                "exchanged.",
            )
        )
    return ReportSection(
        title="Point spread function",
        text=(
            "Total is what the image shows: optics and square pixel together, the Sigma of the "
            "capture model. Optical is the lens alone.",
            *_origin(psf),
        ),
        tables=(
            ReportTable(
                columns=("", "total", "95 % interval", "optical", "95 % interval"),
                rows=tuple(rows),
            ),
            *_channels_table(psf),
        ),
        figures=tuple(figures),
    )


def _origin(psf: PsfCalibration) -> tuple[str, ...]:
    lines = []
    if psf.method == "paper":
        lines.append(
            "Method paper: medians of Gaussians fitted to binned line spread functions. It is "
            "biased by +5 % at 0.5 px and +1.3 % at 1 px, and gives no optical width and no rho."
        )
    if psf.region is not None:
        lines.append(f"Only the region {psf.region} of the frame was used.")
    if psf.channel is not None:
        lines.append(f"Colour: {psf.channel}.")
    return tuple(lines)


def _channels_table(psf: PsfCalibration) -> tuple[ReportTable, ...]:
    if not psf.channels:
        return ()
    rows = tuple(
        (
            name,
            with_err(one.sigma_x_px, one.sigma_x_err_px),
            with_err(one.sigma_y_px, one.sigma_y_err_px),
            with_err(one.optical_sigma_x_px, one.optical_sigma_x_err_px),
            with_err(one.optical_sigma_y_px, one.optical_sigma_y_err_px),
        )
        for name, one in psf.channels.items()
    )
    columns = (
        "colour",
        "total sigma x / px",
        "total sigma y / px",
        "optical sigma x / px",
        "optical sigma y / px",
    )
    return (ReportTable(columns=columns, rows=rows, caption="Widths by colour of the mosaic."),)


def _edges_section(
    found: list[EdgeMeasurement], load_image: ImageLoader, missing: int
) -> ReportSection:
    by_image = {
        name: list(edges)
        for name, edges in groupby(sorted(found, key=lambda e: e.image), lambda e: e.image)
    }
    # Photographs whose edges point in other directions than those already shown.
    by_direction = {_directions(edges): name for name, edges in reversed(by_image.items())}
    shown = sorted(by_direction.values())[:_IMAGES_SHOWN]
    figures = []
    for name in shown:
        edges = by_image[name]
        figure = plot_edges(load_image(edges[0]), edges, REJECTING_FLAGS)
        figures.append(ReportFigure.of(figure, name, form="png"))
    text = ["Every straight edge that was found and fitted; long ones are cut into pieces."]
    if len(by_image) > len(shown):
        text.append(f"{len(shown)} of {len(by_image)} photographs are shown.")
    text += _missing_text(missing)
    return ReportSection(title="Edges", text=tuple(text), figures=tuple(figures))


def _directions(edges: list[EdgeMeasurement]) -> frozenset[int]:
    return frozenset(round(edge.angle_deg / _DIRECTION_STEP_DEG) for edge in edges)


def _profiles_section(found: list[EdgeMeasurement], load_image: ImageLoader) -> ReportSection:
    figures = []
    for orientation in ("vertical", "horizontal", "diagonal"):
        edges = [
            edge
            for edge in found
            if edge.orientation == orientation and not REJECTING_FLAGS & set(edge.flags)
        ]
        if not edges:
            continue
        # The edge in the middle of the ranking: neither the best nor the worst.
        typical = sorted(edges, key=lambda edge: edge.sigma_px)[len(edges) // 2]
        figure = plot_profile(load_image(typical), typical)
        caption = (
            f"A typical {orientation} edge: {typical.angle_deg:.1f} degrees, "
            f"{typical.length_px:.0f} px long, at ({typical.x_px:.0f}, {typical.y_px:.0f})."
        )
        figures.append(ReportFigure.of(figure, caption))
    return ReportSection(
        title="Edge profiles",
        text=(
            "Raw pixels by distance from the edge, the fitted edge, and the residuals. Residuals "
            "that oscillate about zero at the edge mean that the PSF is not Gaussian.",
        ),
        figures=tuple(figures),
    )


def edge_table_section(psf: PsfCalibration) -> ReportSection:
    """Tabulate every edge, in a folded section."""
    rows = tuple(
        (
            PurePath(edge.image).name,
            f"{edge.angle_deg:.1f}",
            f"{edge.length_px:.0f}",
            "over 9999" if edge.snr is None or edge.snr > 9999 else f"{edge.snr:.0f}",
            f"{edge.sigma_px:.4f} ± {edge.sigma_err_px:.4f}",
            with_err(edge.optical_sigma_px, edge.optical_sigma_err_px),
            f"{edge.mtf50_cy_per_px:.3f}",
            _optional(edge.esfr_mtf50_cy_per_px, ".3f"),
            _optional(edge.contrast, ".2f"),
            _optional(edge.roughness_px, ".3f"),
            _percent(edge.clipped_fraction),
            "" if edge.chi2_reduced is None else f"{edge.chi2_reduced:.2f}",
            ", ".join(flag.replace("_", " ") for flag in edge.flags),
        )
        for edge in psf.edges[:_EDGES_LISTED]
    )
    columns = (
        "image",
        "angle / deg",
        "length / px",
        "SNR",
        "total sigma / px",
        "optical sigma / px",
        "MTF50 / (cy/px)",
        "e-SFR MTF50 / (cy/px)",
        "contrast",
        "roughness / px",
        "clipped / %",
        "reduced chi²",
        "remarks",
    )
    more = len(psf.edges) - len(rows)
    text = (f"{more} more edges are in psf.json.",) if more > 0 else ()
    return ReportSection(
        title="All edges",
        text=text,
        is_folded=True,
        tables=(ReportTable(columns=columns, rows=rows),),
    )


def _figure(value: float | None, unit: str) -> str:
    return "not determined" if value is None else f"{value:.4f}{unit}"


def _optional(value: float | None, form: str) -> str:
    return "" if value is None else format(value, form)


def _percent(fraction: float | None) -> str:
    return "" if fraction is None else f"{100 * fraction:.2f}"


def _remark(psf: PsfCalibration, key: str, value: float | None) -> str:
    interval = _interval(psf, key, value)
    return f"95 %: {interval}" if interval else ""


def _interval(psf: PsfCalibration, key: str, value: float | None) -> str:
    if value is None or key not in psf.intervals_95:
        return ""
    low, high = psf.intervals_95[key]
    return f"{low:.4f} to {high:.4f}"
