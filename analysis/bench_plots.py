"""Figures of what a bench did: noise by level, and the stage's heights."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

from acquisition.record import CaptureRecord
from analysis.report_page import in_report_style, new_figure
from calibration.noise_model import LevelNoise

__all__ = ["NoiseSample", "plot_noise", "plot_stage"]

_INK = "#1b1f24"
_BLUE = "#0072B2"
_BINS = 40
_FEWEST_IN_BIN = 30


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NoiseSample:
    """Mean and temporal variance of the pixels of one capture, and the line through them."""

    mean_dn: NDArray[np.floating]
    variance_dn2: NDArray[np.floating]
    noise: LevelNoise
    frames: int
    black_level_dn: float

    @property
    def gain_e_per_dn(self) -> float | None:
        """Electrons per DN, from the slope; None where the variance does not rise."""
        return 1.0 / self.noise.slope_dn if self.noise.slope_dn > 0 else None

    @property
    def read_noise_dn(self) -> float:
        """Noise of one frame at the black level."""
        at_black = self.noise.offset_dn2 + self.noise.slope_dn * self.black_level_dn
        return float(np.sqrt(max(at_black, 0.0)))


@in_report_style
def plot_noise(sample: NoiseSample) -> Figure:
    """Plot variance against mean level: bins of pixels, and the photon transfer line."""
    mean = np.asarray(sample.mean_dn, dtype=np.float64).ravel()
    variance = np.asarray(sample.variance_dn2, dtype=np.float64).ravel()
    edges = np.linspace(mean.min(), mean.max() * (1 + 1e-9) + 1e-9, _BINS + 1)
    place = np.clip(np.searchsorted(edges, mean, side="right") - 1, 0, _BINS - 1)
    count = np.bincount(place, minlength=_BINS)
    used = count >= _FEWEST_IN_BIN
    level = np.bincount(place, mean, minlength=_BINS)[used] / count[used]
    spread = np.bincount(place, variance, minlength=_BINS)[used] / count[used]
    err = spread * np.sqrt(2 / (max(sample.frames - 1, 1) * count[used]))
    figure = new_figure(6.4, 3.2)
    axes = figure.subplots()
    axes.errorbar(
        level, spread, yerr=err, fmt="o", markersize=3.5, color=_BLUE, label="pixels, in bins"
    )
    line = np.linspace(0, float(mean.max()), 100)
    axes.plot(line, sample.noise.variance_dn2(line), color=_INK, linewidth=1, label="fitted line")
    axes.set(
        xlabel="mean level / DN",
        ylabel="variance of one frame / DN²",
        xlim=(0, None),
        ylim=(0, None),
    )
    axes.legend(loc="upper left")
    return figure


@in_report_style
def plot_stage(records: Sequence[CaptureRecord]) -> Figure:
    """Plot what the stage read back against what it was asked for."""
    asked = np.array([record.height_asked_mm for record in records])
    away_um = 1e3 * np.array([record.height_mm - record.height_asked_mm for record in records])
    figure = new_figure(6.4, 2.6)
    axes = figure.subplots()
    axes.plot(asked, away_um, "o", markersize=4, color=_BLUE)
    axes.axhline(0, color=_INK, linewidth=0.6)
    reach = max(1.0, 1.2 * float(np.abs(away_um).max()))
    axes.set(xlabel="height asked / mm", ylabel="read back − asked / µm", ylim=(-reach, reach))
    return figure
