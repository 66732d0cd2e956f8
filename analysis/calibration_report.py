"""What a report says about a PSF: verdict, edges, profiles, widths, MTF."""

from collections.abc import Callable
from itertools import groupby
from pathlib import PurePath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from analysis.calibration_plots import (
    plot_edges,
    plot_mtf,
    plot_profile,
    plot_widths_by_angle,
    plot_widths_by_height,
)
from analysis.report_page import ReportFigure, ReportSection, ReportTable, Verdict
from calibration.files import StoredEdge, StoredPsf
from calibration.psf_calibration import REJECTING_FLAGS

__all__ = ["calibration_sections", "calibration_verdicts", "edge_table_section"]

Image = NDArray[np.floating[Any]]
ImageLoader = Callable[[StoredEdge], Image]

_IMAGES_SHOWN = 4
_DIRECTION_STEP_DEG = 15.0
_EDGES_LISTED = 200


def calibration_verdicts(psf: StoredPsf) -> tuple[Verdict, ...]:
    """Return the headline figures: total widths and correlation, with their 95 % intervals."""
    used = [edge for edge in psf.edges if not REJECTING_FLAGS & set(edge.flags)]
    verdicts = [
        Verdict(
            name=name,
            value=_figure(value, unit),
            remark=_interval(psf, key, value),
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


def calibration_sections(psf: StoredPsf, load_image: ImageLoader) -> tuple[ReportSection, ...]:
    """Return the sections on a PSF but for the list of edges.

    Parameters
    ----------
    psf
        What psf.json holds.
    load_image
        Gives the linear image that an edge was measured on, shape ``(rows, cols)``.
    """
    sections = [_psf_section(psf)]
    if psf.edges:
        sections += [_edges_section(psf, load_image), _profiles_section(psf, load_image)]
        sections.append(_widths_section(psf))
    return tuple(sections)


def _psf_section(psf: StoredPsf) -> ReportSection:
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
            ReportFigure.of(mtf, "Contrast left at each frequency, optics and pixel together.")
        )
    return ReportSection(
        title="Point spread function",
        text=(
            "Total is what the image shows: optics and square pixel together, the Sigma of the "
            "capture model. Optical is the lens alone.",
        ),
        tables=(
            ReportTable(
                columns=("", "total", "95 % interval", "optical", "95 % interval"),
                rows=tuple(rows),
            ),
        ),
        figures=tuple(figures),
    )


def _edges_section(psf: StoredPsf, load_image: ImageLoader) -> ReportSection:
    by_image = {name: list(edges) for name, edges in groupby(psf.edges, lambda e: e.image)}
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
    return ReportSection(title="Edges", text=tuple(text), figures=tuple(figures))


def _directions(edges: list[StoredEdge]) -> frozenset[int]:
    return frozenset(round(edge.angle_deg / _DIRECTION_STEP_DEG) for edge in edges)


def _profiles_section(psf: StoredPsf, load_image: ImageLoader) -> ReportSection:
    figures = []
    for orientation in ("vertical", "horizontal", "diagonal"):
        edges = [
            edge
            for edge in psf.edges
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
            "Raw pixels by their distance from the edge, the fitted edge, and what is left. A "
            "residual that swings about zero at the edge means a PSF that is not Gaussian.",
        ),
        figures=tuple(figures),
    )


def _widths_section(psf: StoredPsf) -> ReportSection:
    figures = [
        ReportFigure.of(
            plot_widths_by_angle(psf, REJECTING_FLAGS),
            "Width across each edge with its standard error; the curve is the fitted covariance.",
        )
    ]
    by_height = plot_widths_by_height(psf, REJECTING_FLAGS)
    if by_height is not None:
        figures.append(
            ReportFigure.of(by_height, "The same widths against the height of the camera.")
        )
    return ReportSection(title="Width by angle and height", figures=tuple(figures))


def edge_table_section(psf: StoredPsf) -> ReportSection:
    """List every edge in figures, folded."""
    rows = tuple(
        (
            PurePath(edge.image).name,
            f"{edge.angle_deg:.1f}",
            f"{edge.length_px:.0f}",
            "over 9999" if edge.snr is None or edge.snr > 9999 else f"{edge.snr:.0f}",
            f"{edge.sigma_px:.4f} ± {edge.sigma_err_px:.4f}",
            _with_err(edge.optical_sigma_px, edge.optical_sigma_err_px),
            f"{edge.mtf50_cy_per_px:.3f}",
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


def _with_err(value: float | None, err: float | None) -> str:
    return "" if value is None or err is None else f"{value:.4f} ± {err:.4f}"


def _interval(psf: StoredPsf, key: str, value: float | None) -> str:
    if value is None or key not in psf.intervals_95:
        return ""
    low, high = psf.intervals_95[key]
    return f"{low:.4f} to {high:.4f}"
