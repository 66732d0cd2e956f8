"""Levels and noise of the pixels of a planned session, from what is known of the camera."""

from dataclasses import dataclass
from math import sqrt

import numpy as np

from acquisition.bench import BenchConfig
from analysis.study import EdgeLevels
from calibration.noise import LevelNoise, NoiseCalibration, level_noise
from calibration.psf import PsfCalibration
from simulation.capture_noise import CaptureNoise
from standoff.errors import ArgumentError

_BLACK_PAPER = 0.06  # of white: toner on paper reflects a few per cent
_WHITE_OF_RANGE = 0.7
_FULL_DN = {"Mono8": 255.0}
_USUAL_FULL_DN = 4095.0
_MONO8_STEP = 16.0  # of 12 bits; the lower four are cut off
_USUAL_SNR = 100.0


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelLevels:
    """Levels of edges and the noise of a frame.

    ``is_in_dn`` is False where only the
    ratio of contrast to noise is known, and levels are in units of the contrast. ``assumptions``
    say where all this comes from.
    """

    levels: EdgeLevels
    is_in_dn: bool
    assumptions: tuple[str, ...]


def pixel_levels(
    bench: BenchConfig,
    psf: PsfCalibration | None,
    noise: NoiseCalibration | CaptureNoise | None,
    levels_dn: tuple[float, float] | None,
) -> PixelLevels:
    """Return levels and noise: of noise.json, of a simulated bench, or of the edges of psf.json.

    Raises
    ------
    ArgumentError
        If the levels do not rise.
    """
    if levels_dn is not None and not levels_dn[0] < levels_dn[1]:
        raise ArgumentError(
            f"expected a dark and a bright level, got {levels_dn[0]:g} and {levels_dn[1]:g}",
            argument="levels",
        )
    if noise is None and bench.simulated is None:
        return _by_edges(bench, psf, levels_dn)
    if noise is not None:
        single = noise if isinstance(noise, CaptureNoise) else noise.capture_noise
        frame_noise = level_noise(single)
        told = "the noise of a pixel is that of noise.json"
    else:
        frame_noise = _simulated_noise(bench)
        told = "the noise of a pixel is what the bench file states of its simulated sensor"
    low, high, whence = _levels(bench, psf, noise, levels_dn)
    return PixelLevels(
        levels=EdgeLevels(low_dn=low, high_dn=high, frame_noise=frame_noise),
        is_in_dn=True,
        assumptions=(told, f"edges go from {low:.0f} to {high:.0f} DN, {whence}"),
    )


def _simulated_noise(bench: BenchConfig) -> LevelNoise:
    truth = bench.simulated
    if truth is None:
        raise ArgumentError("the bench is not simulated")
    gain = truth.gain_e_per_dn / 10 ** (bench.camera.gain_db / 20)
    single = level_noise(
        CaptureNoise(
            gain_e_per_dn=gain,
            read_noise_e=truth.read_noise_e,
            black_level_dn=truth.black_level_dn,
        )
    )
    if bench.camera.pixel_format != "Mono8":
        return single
    # A level m of 8 bits is 16 m + 7.5 of 12; rounding is that of 8 bits.
    shift = 0.5 * (_MONO8_STEP - 1)
    return LevelNoise(
        offset_dn2=(single.offset_dn2 + single.slope_dn * shift) / _MONO8_STEP**2 + 1 / 12,
        slope_dn=single.slope_dn / _MONO8_STEP,
        floor_dn2=single.floor_dn2 / _MONO8_STEP**2 + 1 / 12,
    )


def _levels(
    bench: BenchConfig,
    psf: PsfCalibration | None,
    noise: NoiseCalibration | CaptureNoise | None,
    levels_dn: tuple[float, float] | None,
) -> tuple[float, float, str]:
    """Dark and bright level, and where they come from."""
    if levels_dn is not None:
        return *levels_dn, "as given"
    truth = bench.simulated
    if truth is not None:
        white_e = min(truth.white_e_per_us * bench.camera.exposure_us, truth.full_well_e)
        gain = truth.gain_e_per_dn / 10 ** (bench.camera.gain_db / 20)
        low, high = (truth.black_level_dn + part * white_e / gain for part in (_BLACK_PAPER, 1.0))
        if bench.camera.pixel_format == "Mono8":
            low, high = ((one - 0.5 * (_MONO8_STEP - 1)) / _MONO8_STEP for one in (low, high))
        return low, high, "black and white paper at the bench's exposure"
    full = _FULL_DN.get(bench.camera.pixel_format, _USUAL_FULL_DN)
    if isinstance(noise, NoiseCalibration):
        full = noise.saturation_dn or full
    high = _WHITE_OF_RANGE * full
    contrasts = [edge.contrast for edge in (psf.edges_used if psf else ()) if edge.contrast]
    if contrasts:
        contrast = min(float(np.median(contrasts)), 0.999)
        return (
            high * (1 - contrast) / (1 + contrast),
            high,
            "the contrast of the edges in psf.json at 0.7 of the range",
        )
    return _BLACK_PAPER * high, high, "black and white paper at 0.7 of the range"


def _by_edges(
    bench: BenchConfig, psf: PsfCalibration | None, levels_dn: tuple[float, float] | None
) -> PixelLevels:
    """Levels in units of the contrast, with the noise that the edges of psf.json had."""
    known = [edge.snr for edge in (psf.edges_used if psf else ()) if edge.snr]
    snr = float(np.median(known)) if known else _USUAL_SNR
    frames = bench.capture.frames_per_capture
    whence = "of the edges in psf.json" if known else "assumed, as psf.json has no edges"
    low, high = levels_dn or (0.0, 1.0)
    variance = ((high - low) / snr) ** 2 * frames
    return PixelLevels(
        levels=EdgeLevels(
            low_dn=low,
            high_dn=high,
            frame_noise=LevelNoise(offset_dn2=variance, slope_dn=0.0, floor_dn2=variance),
        ),
        is_in_dn=levels_dn is not None,
        assumptions=(
            f"contrast over noise is {snr:.0f}, {whence}, for means of {frames} frames, as the "
            "bench takes them; a noise.json tells it for any number",
        ),
    )


def noise_at(levels: EdgeLevels, level_dn: float, frames: int) -> float:
    """Standard deviation of a pixel of a capture at a level."""
    variance = levels.frame_noise.variance_dn2(np.array([level_dn]))
    return sqrt(float(variance[0]) / frames)
