"""Plots of a PSF: edge widths against angle, and contrast (MTF) against frequency.

The functions draw on the caller's axes, in the caller's style.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from calibration.edges import REJECTING_FLAGS
from calibration.estimate import NORMAL_95
from simulation.arrays import FloatArray
from simulation.figures import InlineFigure, figure_of
from simulation.palette import BLUE, GREEN, INK, PURPLE, VERMILION

if TYPE_CHECKING:
    from calibration.psf._document import PsfCalibration
    from calibration.psf._transfer_2d import Transfer2d


ORIENTATION_COLOURS = {"vertical": BLUE, "horizontal": VERMILION, "diagonal": GREEN}
_DIRECTIONS = ((0.0, "along x"), (45.0, "at 45 deg"), (90.0, "along y"), (135.0, "at 135 deg"))
_DIRECTION_COLOURS = (BLUE, GREEN, VERMILION, PURPLE)
_DIRECTION_DASHES = ("-", (0, (6, 6)), (4, (3, 9)), ":")  # where curves coincide, all show
_AXES = (("x", "vertical"), ("y", "horizontal"))


def psf_figure(psf: "PsfCalibration", ax: Axes | None = None) -> Figure:
    """Plot a PSF's edge widths against angle, its contrast and its transfer against frequency.

    With ``ax`` there is the contrast against frequency alone. Without edges, or a transfer over
    both axes, there is no panel for them.
    """
    if ax is not None:
        draw_mtf(ax, psf)
        return figure_of(ax)
    count = 1 + bool(psf.edges) + (psf.transfer_2d is not None)
    figure = InlineFigure(figsize=(0.4 + 4.8 * count, 3.6), layout="constrained")
    panels = list(figure.subplots(1, count, squeeze=False)[0])
    if psf.transfer_2d is not None:
        draw_transfer_2d(panels[-1], psf.transfer_2d)
    if psf.edges:
        draw_widths_by_angle(panels[0], psf)
        panels[0].legend(fontsize=8)
    draw_mtf(panels[1 if psf.edges else 0], psf)
    for axes in panels:
        axes.grid(alpha=0.25)
        axes.spines[["top", "right"]].set_visible(False)
    return figure


def draw_widths_by_angle(
    axes: Axes, psf: "PsfCalibration", rejected: frozenset[str] = REJECTING_FLAGS
) -> None:
    """Draw the width across every edge against its angle, with the fitted covariance.

    Edges with one of the flags ``rejected`` are left out.
    """
    _draw_widths(axes, psf, rejected, [edge.angle_deg for edge in psf.edges])
    angles = np.linspace(0, 180, 361)
    normal = np.deg2rad(angles + 90)
    nx, ny = np.cos(normal), np.sin(normal)
    for matrix, name, style in (
        (psf.covariance_px2, "total", "-"),
        (psf.optical_covariance_px2, "optical", "--"),
    ):
        if matrix is not None:
            (xx, xy), (_, yy) = matrix
            width = np.sqrt(np.maximum(xx * nx**2 + 2 * xy * nx * ny + yy * ny**2, 0))
            axes.plot(angles, width, style, color=INK, linewidth=1, label=f"{name} covariance")
    axes.set(
        xlim=(0, 180),
        xticks=range(0, 181, 30),
        xlabel="angle of the edge from +x / deg",
        ylabel="sigma across the edge / px",
    )


def draw_transfer_2d(axes: Axes, transfer: "Transfer2d") -> None:
    """Draw the transfer function along x, y and both diagonals, with its pointwise 95 % band."""
    freq = np.linspace(0, 1, 201)
    for (angle_deg, label), colour, dashes in zip(
        _DIRECTIONS, _DIRECTION_COLOURS, _DIRECTION_DASHES, strict=True
    ):
        angle = np.deg2rad(angle_deg)
        fx, fy = freq * np.cos(angle), freq * np.sin(angle)
        values, reach = transfer.otf(fx, fy), NORMAL_95 * transfer.otf_err(fx, fy)
        axes.plot(freq, values, color=colour, linestyle=dashes, linewidth=1.6, label=label)
        axes.fill_between(freq, values - reach, values + reach, color=colour, alpha=0.25, lw=0)
    axes.axhline(0.0, color=INK, linewidth=0.6)
    axes.axvline(0.5, color=INK, linewidth=0.8, linestyle=":")
    axes.set(
        xlim=(0, 1),
        xlabel="frequency / (cy/px)",
        ylabel="transfer (OTF)",
        title=f"{transfer.measured_on} together: {transfer.form}, with its 95 % band",
    )
    axes.legend(fontsize=8)


def draw_mtf(axes: Axes, psf: "PsfCalibration") -> bool:
    """Draw contrast along x and y, measured and of the Gaussian; False if neither is known."""
    freq = np.linspace(0, 1, 501)
    for axis, orientation in _AXES:
        colour = ORIENTATION_COLOURS[orientation]
        total: float | None = getattr(psf, f"sigma_{axis}_px")
        optical: float | None = getattr(psf, f"optical_sigma_{axis}_px")
        measured = getattr(psf.transfer, axis, None)
        if measured is not None:
            sampled, values = np.array(measured.freq_cy_per_px), np.array(measured.mtf)
            label = f"along {axis}, e-SFR: {_half(sampled, values)}"
            axes.plot(sampled, values, color=colour, label=label)
            _mark_half(axes, sampled, values, colour)
        if total is not None:
            curve = (
                np.exp(-2 * (np.pi * total * freq) ** 2)
                if optical is None
                else np.exp(-2 * (np.pi * optical * freq) ** 2) * np.sinc(freq)
            )
            axes.plot(
                freq,
                curve,
                color=colour,
                linewidth=1.0,
                linestyle="--",
                label=f"along {axis}, Gaussian: {_half(freq, curve)}",
            )
            _mark_half(axes, freq, curve, colour)
    if not axes.lines:
        return False
    axes.axvline(0.5, color=INK, linewidth=0.8, linestyle=":")
    axes.annotate("Nyquist", (0.51, 0.55), fontsize=8, va="bottom")
    axes.set(xlim=(0, 1), ylim=(0, 1.02), xlabel="frequency / (cy/px)", ylabel="contrast (MTF)")
    axes.legend(loc="upper right", fontsize=8)
    return True


def _draw_widths(
    axes: Axes, psf: "PsfCalibration", rejected: frozenset[str], positions: Sequence[float]
) -> None:
    """Draw the total and optical width across every edge, each at its position on the x axis."""
    labels = set()
    shown: list[float] = []
    for edge, position in zip(psf.edges, positions, strict=True):
        if rejected & set(edge.flags):
            continue
        for width, err, name, filled in (
            (edge.sigma_px, edge.sigma_err_px, edge.orientation, True),
            (edge.optical_sigma_px, edge.optical_sigma_err_px, "open: optical", False),
        ):
            if width is None or err is None:
                continue
            shown.append(width)
            colour = ORIENTATION_COLOURS[edge.orientation]
            axes.errorbar(
                position,
                width,
                yerr=NORMAL_95 * err,
                fmt="o",
                markersize=3.5,
                linewidth=0.8,
                color=colour,
                markerfacecolor=colour if filled else "white",
                label=None if name in labels else name,
            )
            labels.add(name)
    if shown:  # the large error bar of a poorly known width must not set the scale
        room = 0.1 * (max(shown) - min(shown)) + 0.01 * max(shown)
        axes.set_ylim(min(shown) - room, max(shown) + room)


def _half(freq: FloatArray, values: FloatArray) -> str:
    half = _half_frequency(freq, values)
    return "MTF50 beyond 1 cy/px" if half is None else f"MTF50 {half:.3f} cy/px"


def _half_frequency(freq: FloatArray, values: FloatArray) -> float | None:
    below = np.flatnonzero(values < 0.5)
    if below.size == 0 or below[0] == 0:
        return None
    pair = slice(below[0] - 1, below[0] + 1)
    return float(np.interp(-0.5, -values[pair], freq[pair]))


def _mark_half(axes: Axes, freq: FloatArray, values: FloatArray, colour: str) -> None:
    half = _half_frequency(freq, values)
    if half is not None:
        axes.plot([half], [0.5], "o", color=colour, markersize=4)
