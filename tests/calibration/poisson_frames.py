"""Dark and flat captures of a sensor whose truth is known, made of Poisson frames."""

import numpy as np

from calibration.noise import LevelSample, Saturation
from simulation.arrays import FloatArray

GAIN_E_PER_DN, READ_NOISE_E, BLACK_DN, TOP_DN = 5.0, 12.0, 64.0, 4095.0
FRAMES, SHAPE = 8, (60, 80)
SATURATION = Saturation(level_dn=TOP_DN, err_dn=0.3)


def frames_dn(
    rng: np.random.Generator,
    electrons: float | FloatArray,
    *,
    shape: tuple[int, int] = SHAPE,
    flicker: float = 0.0,
    frames: int = FRAMES,
) -> FloatArray:
    """Rounded and clipped frames, shape (frames, rows, cols)."""
    light = 1.0 + flicker * rng.standard_normal((frames, 1, 1))
    collected = rng.poisson(np.maximum(light, 0) * np.broadcast_to(electrons, shape))
    noisy = collected + READ_NOISE_E * rng.standard_normal(collected.shape)
    return np.asarray(np.clip(np.rint(BLACK_DN + noisy / GAIN_E_PER_DN), 0, TOP_DN))


def sample(
    frames: FloatArray, exposure_us: float, *, kind: str = "flat", time_s: float = 0.0
) -> LevelSample:
    """What a capture of these frames is to the fit."""
    return LevelSample(
        kind="dark" if kind == "dark" else "flat",
        capture=f"{kind} {exposure_us:g}",
        mean_dn=float(frames.mean()),
        variance_dn2=float(frames.var(axis=0, ddof=1).mean()) if len(frames) > 1 else 0.0,
        pixels=frames[0].size,
        frames=len(frames),
        exposure_us=exposure_us,
        time_s=time_s,
        clipped_fraction=float(np.mean(frames.max(axis=0) >= TOP_DN)),
    )


def ladder(
    rng: np.random.Generator,
    *,
    exposures: tuple[float, ...] = (1000.0, 2000.0, 4000.0, 6000.0, 8000.0),
    flicker: float = 0.0,
) -> list[LevelSample]:
    """Two darks and a ladder of flats, 1.5 electrons a microsecond."""
    darks = [sample(frames_dn(rng, 0.0), 21.0, kind="dark") for _ in range(2)]
    return darks + [
        sample(frames_dn(rng, 1.5 * exposure, flicker=flicker), exposure) for exposure in exposures
    ]
