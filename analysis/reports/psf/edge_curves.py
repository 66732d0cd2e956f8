"""ESF, LSF and SFR of single edges: a row of three panels for each, several rows a figure."""

from collections.abc import Sequence

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from analysis.reports.page import ReportFigure, ReportSection, in_report_style, new_figure
from calibration.edges import EdgeMeasurement, edge_profile
from calibration.psf import ORIENTATION_COLOURS, PsfCalibration
from calibration.sharpness import edge_name, reported_mtf50, with_reach
from simulation.arrays import FloatArray

_SHOWN_MOST = 24
_ROWS_A_FIGURE = 5  # that fill a page of A4
_ROW_IN = 1.68
_SINGLE_ROW_IN = 2.6
_WIDTH_IN = 7.2
_REACH_SIGMAS = 4.0
_REACH_EXTRA_PX = 1.5
_INK = "#1b1f24"
_POINTS = "#8b95a1"


def curves_section(psf: PsfCalibration) -> ReportSection | None:
    """Show ESF, LSF and SFR of every edge, or of a choice of many; None where no edge has curves.

    Of more than 24 edges the softest, the sharpest and others spread over the frame are shown.
    """
    known = [edge for edge in psf.edges_used if edge.esfr is not None]
    if not known:
        return None
    shown = _spread(known, _SHOWN_MOST)
    has_image = len({edge.image for edge in psf.edges}) > 1
    count = -(-len(shown) // _ROWS_A_FIGURE)
    per_figure = -(-len(shown) // count)
    pages = [shown[k : k + per_figure] for k in range(0, len(shown), per_figure)]
    figures = tuple(
        ReportFigure.of(plot_curves_of_edges(page, has_image=has_image), _CAPTION) for page in pages
    )
    text = [
        "Distances run from the dark to the bright side, across the edge; the dashed curve is "
        "the fitted Gaussian with its pixel, the solid one the e-SFR's, which assumes no shape."
    ]
    if len(shown) < len(known):
        text.append(
            f"{len(shown)} of {len(known)} edges are shown: the softest, the sharpest and others "
            "spread over the frame. The table that --csv writes has the SFR of all of them."
        )
    return ReportSection(title="Curves of the edges", text=tuple(text), figures=figures)


_CAPTION = (
    "Edge spread (ESF), line spread (LSF) and spatial frequency response (SFR) of each edge. Dots "
    "are means of its pixels by distance; the dot on the SFR is MTF50 with its 95 % interval, the "
    "dotted line Nyquist."
)


def _spread(edges: Sequence[EdgeMeasurement], most: int) -> list[EdgeMeasurement]:
    """Choose the softest and the sharpest edge and, one by one, the farthest from all chosen.

    They come row by row of the frame, as one reads.
    """
    if len(edges) <= most:
        return _in_reading_order(edges)
    ranked = sorted(edges, key=lambda edge: reported_mtf50(edge).cy_per_px)
    places = np.array([(edge.x_px, edge.y_px) for edge in ranked])
    chosen = [0, len(ranked) - 1]
    away = np.min([np.hypot(*(places - places[k]).T) for k in chosen], axis=0)
    while len(chosen) < most:
        chosen.append(int(np.argmax(away)))
        away = np.minimum(away, np.hypot(*(places - places[chosen[-1]]).T))
    return _in_reading_order([ranked[k] for k in chosen])


def _in_reading_order(edges: Sequence[EdgeMeasurement]) -> list[EdgeMeasurement]:
    return sorted(edges, key=lambda edge: (edge.image, round(edge.y_px / 100), edge.x_px))


@in_report_style
def plot_curves_of_edges(edges: Sequence[EdgeMeasurement], *, has_image: bool) -> Figure:
    """Draw a row of ESF, LSF and SFR for each edge.

    Raises
    ------
    ValueError
        If an edge has no e-SFR.
    """
    rows = len(edges)
    figure = new_figure(_WIDTH_IN, _SINGLE_ROW_IN if rows == 1 else _ROW_IN * rows)
    rooms = figure.subfigures(rows, 1, squeeze=False)[:, 0]
    for room, edge in zip(rooms, edges, strict=True):
        room.suptitle(_title(edge, has_image=has_image), fontsize=9, x=0.01, ha="left")
        _draw_edge(room.subplots(1, 3), edge)
    return figure


def _title(edge: EdgeMeasurement, *, has_image: bool) -> str:
    mtf50 = reported_mtf50(edge)
    return (
        f"{edge_name(edge, has_image=has_image)}: MTF50 "
        f"{with_reach(mtf50.cy_per_px, mtf50.reach_95_cy_per_px, 3)} cy/px"
    )


def _draw_edge(panels: Sequence[Axes], edge: EdgeMeasurement) -> None:
    if edge.esfr is None:
        raise ValueError(f"{edge!r} has no e-SFR")
    colour = ORIENTATION_COLOURS[edge.orientation]
    esf, lsf, sfr = panels
    reach = _REACH_SIGMAS * edge.sigma_px + _REACH_EXTRA_PX
    distance = np.linspace(-reach, reach, 241)
    if edge.binned is not None:
        near = np.abs(edge.binned.distance_px) <= reach
        esf.plot(
            edge.binned.distance_px[near],
            edge.binned.levels[near],
            ".",
            color=_POINTS,
            markersize=3,
        )
    model = _gaussian_esf(edge, distance)
    esf.plot(distance, edge.esfr.esf(distance), color=colour, linewidth=1.4)
    esf.plot(distance, model, color=_INK, linewidth=0.9, linestyle="--")
    esf.set(xlabel="distance / px", ylabel="ESF", xlim=(-reach, reach))
    lsf.plot(distance, edge.esfr.lsf(distance), color=colour, linewidth=1.4)
    slope = np.gradient(model, distance)
    lsf.plot(distance, slope, color=_INK, linewidth=0.9, linestyle="--")
    lsf.set(xlabel="distance / px", ylabel="LSF / (1/px)", xlim=(-reach, reach))
    _draw_sfr(sfr, edge, colour)


def _draw_sfr(axes: Axes, edge: EdgeMeasurement, colour: str) -> None:
    assert edge.esfr is not None
    freq = np.linspace(0, 1, 101)
    axes.plot(freq, edge.esfr.at(freq), color=colour, linewidth=1.4)
    axes.plot(freq, _gaussian_sfr(edge, freq), color=_INK, linewidth=0.9, linestyle="--")
    mtf50 = reported_mtf50(edge)
    axes.errorbar(
        [mtf50.cy_per_px],
        [0.5],
        xerr=[mtf50.reach_95_cy_per_px or 0.0],
        fmt="o",
        markersize=4,
        color=colour,
    )
    axes.axvline(0.5, color=_INK, linewidth=0.8, linestyle=":")
    axes.set(xlabel="frequency / (cy/px)", ylabel="SFR", xlim=(0, 1), ylim=(0, 1.05))


def _gaussian_esf(edge: EdgeMeasurement, distance_px: FloatArray) -> FloatArray:
    if edge.optical_sigma_px is None:
        return edge_profile(distance_px, edge.sigma_px)
    return edge_profile(distance_px, edge.optical_sigma_px, edge.normal_rad)


def _gaussian_sfr(edge: EdgeMeasurement, freq_cy_per_px: FloatArray) -> FloatArray:
    optical = edge.optical_sigma_px
    if optical is None:
        return np.asarray(np.exp(-2 * (np.pi * edge.sigma_px * freq_cy_per_px) ** 2))
    square = np.ones_like(freq_cy_per_px)
    for share in (np.cos(edge.normal_rad), np.sin(edge.normal_rad)):
        square = square * np.sinc(freq_cy_per_px * share)
    return np.asarray(np.exp(-2 * (np.pi * optical * freq_cy_per_px) ** 2) * np.abs(square))
