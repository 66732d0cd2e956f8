"""Figures of a noise calibration: photon transfer, linearity and the maps of the sensor."""

import numpy as np
from matplotlib.figure import Figure

from analysis.report_page import in_report_style, new_figure
from calibration.correction_maps import CorrectionMaps
from calibration.linearity import Linearity
from calibration.photon_transfer import PhotonTransfer

__all__ = ["plot_linearity", "plot_maps", "plot_photon_transfer"]

# Okabe and Ito's palette, which colour-blind readers can tell apart.
_BLUE, _ORANGE, _GREEN = "#0072B2", "#D55E00", "#009E73"
_INK = "#1b1f24"


@in_report_style
def plot_photon_transfer(transfer: PhotonTransfer) -> Figure:
    """Plot the variance of a frame against the light, the fit, and what is left in percent."""
    black = transfer.dark.black_level_dn
    light = np.array([sample.mean_dn - black for sample in transfer.samples])
    variance = np.array([sample.variance_dn2 for sample in transfer.samples])
    err = np.array(
        [
            sample.variance_dn2 * np.sqrt(2 / ((sample.frames - 1) * sample.pixels))
            for sample in transfer.samples
        ]
    )
    fitted = np.array(transfer.fitted)
    figure = new_figure(6.4, 4.4)
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2.2, 1])
    line = np.linspace(0, light.max(), 200)
    upper.plot(line, transfer.variance_dn2(line), color=_INK, linewidth=1, label="fit")
    upper.plot(light[fitted], variance[fitted], "o", markersize=4, color=_BLUE, label="fitted")
    if not fitted.all():
        upper.plot(
            light[~fitted], variance[~fitted], "o", markersize=4, markerfacecolor="white",
            color=_ORANGE, label="not fitted",
        )  # fmt: skip
    upper.axvline(
        transfer.saturation.level_dn - black, color=_GREEN, linewidth=1, linestyle="--",
        label="saturation",
    )  # fmt: skip
    upper.set(ylabel="variance of one frame / DN²", ylim=(0, None))
    upper.legend(loc="upper left", fontsize=8)
    expected = transfer.variance_dn2(light)
    lower.errorbar(
        light[fitted], 100 * (variance / expected - 1)[fitted], yerr=100 * (err / expected)[fitted],
        fmt="o", markersize=4, linewidth=0.9, color=_BLUE,
    )  # fmt: skip
    lower.axhline(0, color=_INK, linewidth=0.8)
    lower.margins(y=0.25)
    lower.set(xlabel="level above black / DN", ylabel="variance less\nfitted / %")
    return figure


@in_report_style
def plot_linearity(linearity: Linearity) -> Figure:
    """Plot how far each level lies off the line over the exposure, in percent."""
    figure = new_figure(6.4, 2.6)
    axes = figure.subplots()
    axes.plot(
        linearity.light_dn, 100 * np.array(linearity.deviations), "o", markersize=4, color=_BLUE
    )
    axes.axhline(0, color=_INK, linewidth=0.8)
    axes.margins(y=0.25)
    axes.set(xlabel="level above black / DN", ylabel="off the line / %", xlim=(0, None))
    return figure


@in_report_style
def plot_maps(maps: CorrectionMaps) -> Figure:
    """Show the dark and the flat map, with the defect pixels ringed."""
    rows, cols = maps.dark_dn.shape
    figure = new_figure(7.2, 3.3 * rows / cols + 0.6)
    y, x = np.nonzero(maps.defects)
    for axes, image, title in zip(
        figure.subplots(1, 2),
        (maps.dark_dn, maps.response),
        ("dark map / DN", "flat map, mean 1"),
        strict=True,
    ):
        low, high = np.percentile(image, [0.5, 99.5])
        shown = axes.imshow(image, cmap="viridis", vmin=low, vmax=max(high, low + 1e-9))
        axes.plot(x, y, "o", markersize=7, markerfacecolor="none", color=_ORANGE, linewidth=1)
        axes.set(title=title, xlabel="x / px", xlim=(-0.5, cols - 0.5), ylim=(rows - 0.5, -0.5))
        axes.grid(visible=False)
        figure.colorbar(shown, ax=axes, shrink=0.8)
    return figure
