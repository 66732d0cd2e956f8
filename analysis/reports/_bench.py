"""Report sections on the bench: captures, noise of the frames, heights of the stage, focus."""

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

from acquisition.focus import FocusPeak
from acquisition.session import CaptureRecord, Session, SessionCapture
from analysis.reports._page import (
    ReportFigure,
    ReportSection,
    ReportTable,
    in_report_style,
    new_plot,
    number_text,
)
from calibration.edges import REJECTING_FLAGS
from calibration.estimate import NORMAL_95
from calibration.noise import LevelNoise, fit_level_noise
from calibration.psf import PsfCalibration
from simulation.arrays import FloatArray
from simulation.figures import figure_of
from simulation.palette import BLUE, INK, VERMILION

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
    bin_index = np.clip(np.searchsorted(edges, mean, side="right") - 1, 0, _BINS - 1)
    count = np.bincount(bin_index, minlength=_BINS)
    used = count >= _FEWEST_IN_BIN
    level = np.bincount(bin_index, mean, minlength=_BINS)[used] / count[used]
    spread = np.bincount(bin_index, variance, minlength=_BINS)[used] / count[used]
    reach = NORMAL_95 * spread * np.sqrt(2 / (max(sample.frames - 1, 1) * count[used]))
    figure, axes = new_plot()
    axes.errorbar(
        level, spread, yerr=reach, fmt="o", markersize=3.5, color=BLUE, label="binned pixels"
    )
    line = np.linspace(0, float(mean.max()), 100)
    axes.plot(line, sample.noise.variance_dn2(line), color=INK, linewidth=1, label="fitted line")
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
    """Plot the heights read back against those requested."""
    asked = np.array([record.height_asked_mm for record in records])
    away_um = 1e3 * np.array([record.height_mm - record.height_asked_mm for record in records])
    figure, axes = new_plot(6.4, 2.6)
    axes.plot(asked, away_um, "o", markersize=4, color=BLUE)
    axes.axhline(0, color=INK, linewidth=0.6)
    reach = max(1.0, 1.2 * float(np.abs(away_um).max()))
    axes.set(
        xlabel="requested height / mm", ylabel="read back − requested / µm", ylim=(-reach, reach)
    )
    return figure


_FEWEST_PIXELS = 100
_FEWEST_FRAMES = 3


def captures_section(session: Session) -> ReportSection:
    """List every capture, with those excluded and why."""
    complete = "complete" if session.is_complete else "incomplete: run the capture again"
    return ReportSection.of(
        "Captures",
        f"{len(session.records)} of {len(session.entries)} planned; {complete}.",
        "Columns: requested, the height in the plan; height, the one read back; lost, "
        "incomplete frames that were replaced; saturated, pixels clipped in any frame.",
        ReportTable.of(
            session.captures,
            {
                "capture": lambda one: str(one.record.index),
                "kind": lambda one: one.record.kind,
                "target": lambda one: one.record.target,
                "orientation / deg": lambda one: f"{one.record.orientation_deg:g}",
                "requested / mm": lambda one: (
                    f"{one.record.height_asked_mm:.3f}" if session.bench else ""
                ),
                "height / mm": lambda one: number_text(session.known_height_mm(one.record), ".3f"),
                "frames": lambda one: str(one.record.frames_used),
                "lost": lambda one: str(one.record.incomplete_frames),
                "saturated": lambda one: str(one.record.saturated_pixels),
                "focus": lambda one: number_text(one.record.focus_value, ".4g"),
                "remarks": _standing,
            },
        ),
    )


def noise_section(session: Session, psf: PsfCalibration | None) -> ReportSection | None:
    """Show the noise of single frames and the gain from averaging; None if it is not known."""
    sample = _noise_sample(session)
    if sample is None:
        return None
    gain, read_noise_dn = sample.gain_e_per_dn, sample.read_noise_dn
    row = (
        number_text(gain, ".3f", "not determined"),
        f"{read_noise_dn:.3f}",
        number_text(None if gain is None else gain * read_noise_dn, ".2f"),
        str(sample.frames),
    )
    return ReportSection.of(
        "Noise",
        f"Temporal variance of {sample.frames} frames against their mean, pixel by pixel. The "
        "slope of the line gives the shot noise, its value at the black level the read noise.",
        _averaging(psf, sample.frames),
        "The variance does not rise with the level: the gain is not determined."
        if gain is None
        else None,
        ReportTable(
            columns=("gain / (e/DN)", "read noise / DN", "read noise / e", "frames averaged"),
            rows=(row,),
        ),
        ReportFigure.of(plot_noise(sample), "Photon transfer of one capture, with 95 % bars."),
    )


def stage_section(session: Session) -> ReportSection | None:
    """Compare the requested heights with those read back; None without captures."""
    records = session.records
    if not records:
        return None
    away_um = np.array([1e3 * (r.height_mm - r.height_asked_mm) for r in records])
    return ReportSection.of(
        "Stage",
        f"Read back minus requested: mean {away_um.mean():+.1f} µm, largest "
        f"{np.abs(away_um).max():.1f} µm, over {len(records)} captures.",
        ReportFigure.of(plot_stage(records), "Height read back minus requested, at each height."),
    )


def device_rows(session: Session) -> tuple[tuple[str, str], ...]:
    """Name the devices of a session: maker, model and serial number."""
    return tuple((name, _snapshot(snapshot)) for name, snapshot in session.devices.items())


def _noise_sample(session: Session) -> NoiseSample | None:
    for record in session.records:
        if record.kind not in ("edge", "board", "flat") or record.frames_used < _FEWEST_FRAMES:
            continue
        if record.bracket is not None:  # no one line: dark pixels rest on more exposures
            continue
        images = session.load(record)
        if images.variance_dn2 is None or images.mean_dn.size < _FEWEST_PIXELS:
            continue
        try:
            noise = fit_level_noise(images.mean_dn, images.variance_dn2, record.max_level_dn)
        except ValueError:  # nearly all of it is saturated
            continue
        return NoiseSample(
            mean_dn=images.mean_dn,
            variance_dn2=images.variance_dn2,
            noise=noise,
            frames=record.frames_used,
            black_level_dn=record.black_level_dn,
        )
    return None


def _averaging(psf: PsfCalibration | None, frames: int) -> str | None:
    """What is left of a frame's noise in the mean, by what the edge fits leave over."""
    known = [
        edge.chi2_reduced
        for edge in (psf.edges if psf else ())
        if edge.chi2_reduced is not None and not REJECTING_FLAGS & set(edge.flags)
    ]
    if not known:
        return None
    ideal = 1 / np.sqrt(frames)
    measured = float(np.sqrt(np.median(known))) * ideal
    return (
        f"Averaging {frames} frames leaves {measured:.3f} of a frame's noise around the fitted "
        f"edges (median of {len(known)}); 1/√{frames} = {ideal:.3f} is expected of independent "
        "frames. A larger value means structure that the edge model does not describe, or noise "
        "that the frames share."
    )


def _standing(capture: SessionCapture) -> str:
    if capture.is_superseded:
        return "superseded"
    because = capture.excluded_because
    return "" if because is None else f"excluded: {because}"


def _snapshot(snapshot: Mapping[str, object]) -> str:
    parts = (snapshot.get(f"Device{key}") for key in ("VendorName", "ModelName", "SerialNumber"))
    return " ".join(str(part) for part in parts if part)


def versions() -> tuple[tuple[str, str], ...]:
    """Return the versions of the software that made the report."""
    names = ("standoff", "numpy", "scipy", "opencv-contrib-python-headless", "scikit-image")
    return (("Python", platform.python_version()), *((name, version(name)) for name in names))


@in_report_style
def plot_focus_sweep(
    heights_mm: FloatArray,
    values: FloatArray,
    errs: FloatArray,
    peak: FocusPeak | None,
    measure: str,
    ax: Axes | None = None,
) -> Figure:
    """Plot focus values by height, with the fitted curve and the peak where there is one."""
    axes = new_plot(6.4, 3.4)[1] if ax is None else ax
    axes.errorbar(
        heights_mm, values, yerr=errs, fmt="o", markersize=4, linewidth=0.9, color=BLUE,
        label="measured",
    )  # fmt: skip
    if peak is not None:
        line = np.linspace(heights_mm.min(), heights_mm.max(), 400)
        axes.plot(line, peak.curve(line), color=INK, linewidth=1, label=f"fit, {peak.shape}")
        half = NORMAL_95 * peak.err_mm
        axes.axvspan(
            peak.height_mm - half, peak.height_mm + half, color=VERMILION, alpha=0.25, linewidth=0,
            label="peak, 95 %",
        )  # fmt: skip
        axes.axvline(peak.height_mm, color=VERMILION, linewidth=1)
        axes.set(title=f"sharpest at {peak.height_mm:.3f} ± {half:.3f} mm (95 %)")
    axes.set(xlabel="height / mm", ylabel=f"focus value ({measure})")
    axes.margins(y=0.15)
    axes.legend(loc="best", fontsize=8)
    return figure_of(axes)
