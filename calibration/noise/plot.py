"""Plot of a photon transfer: variance against light."""

import numpy as np
from matplotlib.axes import Axes

from calibration.noise.photon_transfer import PhotonTransfer
from simulation.palette import BLUE, GREEN, INK, VERMILION


def draw_photon_transfer(axes: Axes, transfer: PhotonTransfer) -> None:
    """Draw the variance of a frame against the light, with the fit and the saturation."""
    black = transfer.dark.black_level_dn
    light = np.array([sample.mean_dn - black for sample in transfer.samples])
    variance = np.array([sample.variance_dn2 for sample in transfer.samples])
    fitted = np.array([sample.is_fitted for sample in transfer.samples])
    line = np.linspace(0, light.max(), 200)
    axes.plot(line, transfer.variance_dn2(line), color=INK, linewidth=1, label="fit")
    axes.plot(light[fitted], variance[fitted], "o", markersize=4, color=BLUE, label="fitted")
    if not fitted.all():
        axes.plot(
            light[~fitted], variance[~fitted], "o", markersize=4, markerfacecolor="white",
            color=VERMILION, label="not fitted",
        )  # fmt: skip
    axes.axvline(
        transfer.saturation.level_dn - black, color=GREEN, linewidth=1, linestyle="--",
        label="saturation",
    )  # fmt: skip
    axes.set(ylabel="variance of one frame / DN²", ylim=(0, None))
    axes.legend(loc="upper left", fontsize=8)
