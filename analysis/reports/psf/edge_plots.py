"""Figures of measured edges: on their photograph, across each, and their widths by angle."""

from collections.abc import Sequence

import numpy as np
from matplotlib.figure import Figure
from scipy.ndimage import uniform_filter

from analysis.reports.page import in_report_style, new_figure
from analysis.reports.psf.edge_labels import LABEL_POINTS, placed_labels
from calibration.edges import EdgeMeasurement, edge_profile
from calibration.psf import ORIENTATION_COLOURS, PsfCalibration, draw_widths_by_angle
from simulation.arrays import FloatArray, FloatImage

REJECTED_COLOUR = "#CC79A7"
SCENE_COLOUR = "#F0E442"
_INK = "#1b1f24"
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
    figure = new_figure(drawn_in + _AXES_IN, drawn_in * rows / cols + _LEGEND_IN)
    axes = figure.subplots()
    low, high = np.percentile(image_dn, [0.5, 99.5])
    axes.imshow(image_dn, cmap="gray", vmin=low, vmax=max(high, low + 1e-9))
    labels = set()
    for edge in edges:
        is_rejected = bool(rejected & set(edge.flags))
        label: str = "not used" if is_rejected else edge.orientation
        colour = REJECTED_COLOUR if is_rejected else ORIENTATION_COLOURS[edge.orientation]
        if "beside_target" in edge.flags:
            label, colour = "beside the target", SCENE_COLOUR
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
            color=_INK,
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
        color=_INK,
        linewidth=1.2,
        label=f"mean over {_PROFILE_BIN_PX:g} px",
    )
    lower.set(xlabel="distance from the edge / px", ylabel="residual / %")
    lower.legend(loc="upper left", fontsize=8)
    return figure


@in_report_style
def plot_widths_by_angle(psf: PsfCalibration, rejected: frozenset[str]) -> Figure:
    """Plot the width across every edge against its angle, with the fitted covariance."""
    figure = new_figure(6.4, 3.4)
    axes = figure.subplots()
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
