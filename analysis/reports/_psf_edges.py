"""Edges of a calibration: on their photograph, across each, by angle, and as rows of a table."""

import csv
from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO
from itertools import groupby

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.ndimage import uniform_filter

from analysis.reports._page import (
    ReportFigure,
    ReportSection,
    ReportTable,
    in_report_style,
    new_figure,
    new_plot,
    number_text,
)
from calibration.edges import SFR_FREQ_CY_PER_PX, EdgeMeasurement, edge_profile
from calibration.estimate import with_reach
from calibration.psf import ORIENTATION_COLOURS, PsfCalibration, draw_widths_by_angle
from calibration.sharpness import MODEL_REMARK, edge_cells, edge_name, edge_row, reported_mtf50
from simulation.arrays import FloatArray, FloatImage
from simulation.palette import INK, POINTS, PURPLE, YELLOW

LABEL_POINTS = 8.0
_LETTER = 0.64  # width of a digit over the size of the text, DejaVu Sans
_LINE = 1.3
_AWAY = 0.75  # from the edge to the label's middle, in sizes of the label along the normal
_LABELS_MOST = 70  # more hide the photograph
_POINTS_PER_IN = 72.0


@dataclass(frozen=True, slots=True, kw_only=True)
class _EdgeLabel:
    """A text and its middle in px of the photograph."""

    text: str
    x_px: float
    y_px: float


def placed_labels(
    edges: Sequence[EdgeMeasurement], width_px: int, height_px: int, px_per_in: float
) -> list[_EdgeLabel]:
    """Label edges with their MTF50 in cy/px: the softest and the sharpest first, then long ones."""
    if not edges:
        return []
    ranked = sorted(edges, key=lambda edge: reported_mtf50(edge).cy_per_px)
    extremes = [ranked[0], ranked[-1]]
    others = sorted(edges, key=lambda edge: -edge.length_px)
    placed: list[_EdgeLabel] = []
    boxes = np.empty((0, 2))
    labelled: set[int] = set()
    for edge in [*extremes, *others]:
        if len(placed) == _LABELS_MOST or id(edge) in labelled:
            continue
        text = f"{reported_mtf50(edge).cy_per_px:.3f}"
        size = np.array([_LETTER * len(text), _LINE]) * LABEL_POINTS / _POINTS_PER_IN * px_per_in
        for middle in _sides(edge, size):
            is_inside = np.all(middle >= 0.5 * size) and np.all(
                middle <= np.array([width_px, height_px]) - 0.5 * size
            )
            if is_inside and not np.any(np.all(np.abs(boxes - middle) < size, axis=1)):
                placed.append(_EdgeLabel(text=text, x_px=float(middle[0]), y_px=float(middle[1])))
                boxes = np.vstack([boxes, middle])
                labelled.add(id(edge))
                break
    return placed


def _sides(edge: EdgeMeasurement, size: FloatArray) -> list[FloatArray]:
    """Middles of a label on either side of an edge's middle, clear of the edge."""
    normal = np.array([np.cos(edge.normal_rad), np.sin(edge.normal_rad)])
    away = _AWAY * float(np.abs(normal) @ size)
    middle = np.array([edge.x_px, edge.y_px])
    return [middle + away * normal, middle - away * normal]


_REJECTED_COLOUR = PURPLE
_SCENE_COLOUR = YELLOW
_AXES_IN = 0.75  # of a figure's width: ticks and labels
_LEGEND_IN = 0.85  # of its height: the legend, too
_HIGHEST_IN = 5.4  # room for the title and the legend on a page
_FEW = 12  # edges, told apart on a small picture, which stands below the facts on the first page
_HIGHEST_OF_FEW_IN = 2.7
_MANY = 200
_LEGEND_COLUMNS = 3

_PROFILE_BAND_SIGMAS = 6.0
_PROFILE_BAND_EXTRA_PX = 3.0
_PROFILE_BIN_PX = 0.25


@in_report_style
def plot_edges(
    image_dn: FloatImage,
    edges: Sequence[EdgeMeasurement],
    rejected: frozenset[str],
    width_in: float = 3.6,
) -> Figure:
    """Draw the measured edges on their photograph, with their MTF50; rejected ones dashed.

    Labels that would overlap are left out, those of the softest and the sharpest edge last.
    """
    rows, cols = image_dn.shape
    image_dn = _filled(image_dn)
    highest_in = _HIGHEST_OF_FEW_IN if len(edges) <= _FEW else _HIGHEST_IN
    drawn_in = min(width_in - _AXES_IN, highest_in * cols / rows)
    figure, axes = new_plot(drawn_in + _AXES_IN, drawn_in * rows / cols + _LEGEND_IN)
    low, high = np.percentile(image_dn, [0.5, 99.5])
    axes.imshow(image_dn, cmap="gray", vmin=low, vmax=max(high, low + 1e-9))
    labels = set()
    for edge in edges:
        is_rejected = bool(rejected & set(edge.flags))
        label: str = "not used" if is_rejected else edge.orientation
        colour = _REJECTED_COLOUR if is_rejected else ORIENTATION_COLOURS[edge.orientation]
        if "beside_target" in edge.flags:
            label, colour = "beside the target", _SCENE_COLOUR
        turn = np.deg2rad(edge.angle_deg)
        reach = 0.5 * edge.length_px * np.array([np.cos(turn), np.sin(turn)])
        axes.plot(
            [edge.x_px - reach[0], edge.x_px + reach[0]],
            [edge.y_px - reach[1], edge.y_px + reach[1]],
            color=colour,
            linestyle="--" if is_rejected else "-",
            marker="|",
            linewidth=1.8 if len(edges) < _MANY else 1.0,
            label=None if label in labels else label,
        )
        labels.add(label)
    used = [edge for edge in edges if not rejected & set(edge.flags)]
    for one in placed_labels(used, cols, rows, cols / drawn_in):
        axes.text(
            one.x_px,
            one.y_px,
            one.text,
            fontsize=LABEL_POINTS,
            ha="center",
            va="center",
            color=INK,
            bbox={"facecolor": "white", "alpha": 0.85, "edgecolor": "none", "pad": 0.6},
        )
    axes.set(xlim=(-0.5, cols - 0.5), ylim=(rows - 0.5, -0.5), xlabel="x / px", ylabel="y / px")
    axes.grid(visible=False)
    if labels:
        figure.legend(loc="outside upper right", ncols=min(len(labels), 2 if width_in < 5 else 4))
    return figure


@in_report_style
def plot_profile(image_dn: FloatImage, edge: EdgeMeasurement) -> Figure:
    """Plot one edge: its pixels by distance, the fitted edge, and the residuals."""
    distances, values, low, high = _edge_pixels(image_dn, edge)
    levels = (values - low) / (high - low)
    normal = float(np.deg2rad(edge.angle_deg + 90.0))
    has_optical = edge.optical_sigma_px is not None
    sigma = edge.optical_sigma_px if edge.optical_sigma_px is not None else edge.sigma_px
    model = edge_profile(distances, sigma, normal if has_optical else None)
    figure = new_figure(6.4, 3.8)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2.2, 1])
    upper.plot(
        distances, levels, ".", markersize=2, color="#9aa3ad", rasterized=True, label="pixels"
    )
    fine = np.linspace(distances.min(), distances.max(), 400)
    upper.plot(
        fine,
        edge_profile(fine, sigma, normal if has_optical else None),
        color=ORIENTATION_COLOURS[edge.orientation],
        label=f"fit, {'optical' if has_optical else 'total'} sigma {sigma:.3f} px",
    )
    upper.set(ylabel="level, dark 0 to bright 1")
    upper.legend(loc="upper left")
    residuals = 100 * (levels - model)
    lower.plot(distances, residuals, ".", markersize=2, color="#9aa3ad", rasterized=True)
    bin_index = np.round(distances / _PROFILE_BIN_PX).astype(int)
    bin_index -= bin_index.min()
    count = np.bincount(bin_index)
    used = count >= 5
    lower.plot(
        (np.bincount(bin_index, distances)[used] / count[used]),
        (np.bincount(bin_index, residuals)[used] / count[used]),
        color=INK,
        linewidth=1.2,
        label=f"mean over {_PROFILE_BIN_PX:g} px",
    )
    lower.set(xlabel="distance from the edge / px", ylabel="residual / %")
    lower.legend(loc="upper left", fontsize=8)
    return figure


@in_report_style
def plot_widths_by_angle(psf: PsfCalibration, rejected: frozenset[str]) -> Figure:
    """Plot the width across every edge against its angle, with the fitted covariance."""
    figure, axes = new_plot(6.4, 3.4)
    draw_widths_by_angle(axes, psf, rejected)
    entries = dict(zip(*reversed(axes.get_legend_handles_labels()), strict=True))
    order = [name for name in ORIENTATION_COLOURS if name in entries]
    order += [name for name in entries if name not in order]
    rows = [name for column in range(_LEGEND_COLUMNS) for name in order[column::_LEGEND_COLUMNS]]
    figure.legend(
        [entries[name] for name in rows],
        rows,
        loc="outside upper center",
        ncols=_LEGEND_COLUMNS,
        fontsize=8,
    )
    return figure


def _filled(image_dn: FloatImage) -> FloatImage:
    """The image with NaN pixels (other colours of a mosaic) filled from their neighbours."""
    known = np.isfinite(image_dn)
    if known.all():
        return image_dn
    sums = uniform_filter(np.where(known, image_dn, 0.0).astype(np.float64), 3, mode="nearest")
    share = uniform_filter(known.astype(np.float64), 3, mode="nearest")
    return np.where(known, image_dn, sums / np.maximum(share, 1e-9))


def _edge_pixels(
    image_dn: FloatImage, edge: EdgeMeasurement
) -> tuple[FloatArray, FloatArray, float, float]:
    """Distance and level of the pixels around an edge, and the levels of its two sides."""
    rows, cols = image_dn.shape
    turn = np.deg2rad(edge.angle_deg)
    along = np.array([np.cos(turn), np.sin(turn)])
    across = np.array([-along[1], along[0]])
    band = _PROFILE_BAND_SIGMAS * edge.sigma_px + _PROFILE_BAND_EXTRA_PX
    y, x = np.mgrid[:rows, :cols]
    u = (x - edge.x_px) * across[0] + (y - edge.y_px) * across[1]
    v = (x - edge.x_px) * along[0] + (y - edge.y_px) * along[1]
    inside = (np.abs(u) <= band) & (np.abs(v) <= 0.5 * edge.length_px) & np.isfinite(image_dn)
    distances = u[inside].astype(np.float64)
    values = np.asarray(image_dn[inside], dtype=np.float64)
    far = 3 * edge.sigma_px + 1
    low, high = (float(np.median(values[side * distances > far])) for side in (-1, 1))
    if low > high:
        distances, low, high = -distances, high, low
    return distances, values, low, high


_SHOWN_MOST = 24
_ROWS_A_FIGURE = 5  # that fill a page of A4
_ROW_IN = 1.68
_SINGLE_ROW_IN = 2.6
_WIDTH_IN = 7.2
_REACH_SIGMAS = 4.0
_REACH_EXTRA_PX = 1.5


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
    return ReportSection.of(
        "Curves of the edges",
        "Distances run across the edge, from the dark to the bright side. The dashed curve is "
        "the fitted Gaussian, pixel included; the solid one is the e-SFR, which assumes no shape.",
        f"{len(shown)} of {len(known)} edges are shown: the softest, the sharpest and others "
        "spread over the frame. The table that --csv writes has the SFR of all of them."
        if len(shown) < len(known)
        else None,
        *(
            ReportFigure.of(plot_curves_of_edges(page, has_image=has_image), _CAPTION)
            for page in pages
        ),
    )


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
    """Draw a row of ESF, LSF and SFR for each edge."""
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
            color=POINTS,
            markersize=3,
        )
    model = _gaussian_esf(edge, distance)
    esf.plot(distance, edge.esfr.esf(distance), color=colour, linewidth=1.4)
    esf.plot(distance, model, color=INK, linewidth=0.9, linestyle="--")
    esf.set(xlabel="distance / px", ylabel="ESF", xlim=(-reach, reach))
    lsf.plot(distance, edge.esfr.lsf(distance), color=colour, linewidth=1.4)
    slope = np.gradient(model, distance)
    lsf.plot(distance, slope, color=INK, linewidth=0.9, linestyle="--")
    lsf.set(xlabel="distance / px", ylabel="LSF / (1/px)", xlim=(-reach, reach))
    _draw_sfr(sfr, edge, colour)


def _draw_sfr(axes: Axes, edge: EdgeMeasurement, colour: str) -> None:
    assert edge.esfr is not None
    freq = np.linspace(0, 1, 101)
    axes.plot(freq, edge.esfr.at(freq), color=colour, linewidth=1.4)
    axes.plot(freq, _gaussian_sfr(edge, freq), color=INK, linewidth=0.9, linestyle="--")
    mtf50 = reported_mtf50(edge)
    axes.errorbar(
        [mtf50.cy_per_px],
        [0.5],
        xerr=[mtf50.reach_95_cy_per_px or 0.0],
        fmt="o",
        markersize=4,
        color=colour,
    )
    axes.axvline(0.5, color=INK, linewidth=0.8, linestyle=":")
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


_EDGES_LISTED = 200
_EDGES_IN_FULL = 12


def edge_table_section(psf: PsfCalibration) -> ReportSection:
    """Tabulate the edges: their sharpness, and what there is to say of their quality.

    Those of several photographs stand in groups, each under the name of its photograph. A remark
    on all of them is said once.
    """
    edges = psf.edges[:_EDGES_LISTED]
    columns, cells = edge_cells(edges, psf.pixel_pitch_um, has_image=False)
    # A row of figures is one line high: no line breaks within a position.
    sharpness = tuple((name.replace(" ", "\u00a0"), *others) for name, *others in cells)
    shared: frozenset[str] = frozenset()
    if len(edges) > 1:
        shared = frozenset.intersection(*(frozenset(edge.flags) for edge in edges))
    quality = [_quality_cells(edge, shared) for edge in edges]
    more = len(psf.edges) - len(edges)
    is_long = len(edges) > _EDGES_IN_FULL
    has_model = any(" *" in cell for row in sharpness for cell in row)
    text = (
        "An edge is named by its middle in px and the direction of its line.",
        f"Remarks on all edges: {_remarks(sorted(shared))}." if shared else None,
        MODEL_REMARK if has_model else None,
        f"{more} more edges are in psf.json." if more > 0 else None,
        "psf.json and the table of --csv also have contrast, roughness and clipping."
        if is_long
        else None,
    )
    joined = list(zip(sharpness, quality, strict=True))
    if is_long:  # a row each on one line: five pages at most
        shown = (0, 1, len(_QUALITY_COLUMNS) - 1)
        rows = [(*one[:-1], *(other[k] for k in shown)) for one, other in joined]
        together = (*columns[:-1], *(_QUALITY_COLUMNS[k] for k in shown))
        tables = [_edges_table(edges, together, rows, "", ends_in_words=True)]
    else:
        rows = [(one[0], *other) for one, other in joined]
        tables = [
            _edges_table(edges, columns, sharpness, "Sharpness."),
            _edges_table(edges, ("edge", *_QUALITY_COLUMNS), rows, "Quality.", ends_in_words=True),
        ]
    return ReportSection.of("All edges", *text, *tables, is_folded=True)


def _edges_table(
    edges: Sequence[EdgeMeasurement],
    columns: tuple[str, ...],
    rows: Sequence[tuple[str, ...]],
    caption: str,
    *,
    ends_in_words: bool = False,
) -> ReportTable:
    """Tabulate edges; those of several photographs stand each under its name."""
    grouped = list(rows)
    if len({edge.image for edge in edges}) > 1:
        grouped = []
        pairs = zip(edges, rows, strict=True)
        for image, group in groupby(pairs, lambda pair: pair[0].image):
            grouped += [(image,), *(row for _, row in group)]
    return ReportTable(
        columns=columns, rows=tuple(grouped), caption=caption, ends_in_words=ends_in_words
    )


def _quality_cells(edge: EdgeMeasurement, shared: frozenset[str]) -> tuple[str, ...]:
    clipped = edge.clipped_fraction
    return (
        f"{edge.length_px:.0f}",
        "over 9999" if edge.snr is None or edge.snr > 9999 else f"{edge.snr:.0f}",
        number_text(edge.contrast, ".2f"),
        number_text(edge.roughness_px, ".3f"),
        number_text(None if clipped is None else 100 * clipped, ".2f"),
        number_text(edge.chi2_reduced, ".2f"),
        _remarks([flag for flag in edge.flags if flag not in shared]),
    )


def _remarks(flags: Sequence[str]) -> str:
    return ", ".join(flag.replace("_", " ") for flag in flags)


_QUALITY_COLUMNS = (
    "length / px",
    "SNR",
    "contrast",
    "roughness / px",
    "clipped / %",
    "reduced chi²",
    "remarks",
)


def edge_csv(calibration: PsfCalibration) -> str:
    """Return the table: the entries of psf.json for each edge, then its contrast by frequency.

    ``mtf50_...`` is the measured one, ``gaussian_mtf50_...`` the fitted Gaussian's.

    Columns ``sfr_0.05`` to ``sfr_0.50`` are the contrast left at that many cy/px, by the e-SFR.
    An empty cell is a value that is not determined; flags share one cell, separated by spaces.
    """
    text = StringIO()
    writer = csv.writer(text, lineterminator="\n")
    freq = np.array(SFR_FREQ_CY_PER_PX)
    for number, edge in enumerate(calibration.edges):
        row = edge_row(edge)
        if number == 0:
            writer.writerow([*row, "is_used", *(f"sfr_{f:.2f}" for f in SFR_FREQ_CY_PER_PX)])
        row["flags"] = " ".join(row["flags"])
        sfr = [""] * freq.size if edge.esfr is None else [f"{v:.6f}" for v in edge.esfr.at(freq)]
        writer.writerow([*row.values(), "yes" if edge.is_used else "no", *sfr])
    return text.getvalue()
