"""Frames of a scene of many lights, by the camera model of EMVA 1288, and their true light."""

import numpy as np
from numpy.typing import NDArray

from acquisition.averaging import AveragedFrames

BLACK_DN, TOP_DN = 64.0, 4095
GAIN_E_PER_DN, READ_NOISE_E = 5.0, 12.0
FRAMES = 10


def exposed(
    light_dn: NDArray[np.float64],
    ratio: float,
    rng: np.random.Generator,
    *,
    full_well_e: float = 30_000.0,
    black_dn: float = BLACK_DN,
) -> AveragedFrames:
    """Average FRAMES frames; ``light_dn`` is at the exposure of ratio 1, without black."""
    electrons = light_dn * ratio * GAIN_E_PER_DN
    frames = []
    for _ in range(FRAMES):
        collected = np.minimum(rng.poisson(electrons), full_well_e)
        collected = collected + READ_NOISE_E * rng.standard_normal(electrons.shape)
        frames.append(np.clip(np.rint(black_dn + collected / GAIN_E_PER_DN), 0, TOP_DN))
    return averaged_of(np.stack(frames))


def averaged_of(frames: NDArray[np.float64]) -> AveragedFrames:
    """The average of a stack of frames, shape ``(frames, rows, cols)``."""
    is_saturated = np.asarray((frames >= TOP_DN).any(axis=0))
    return AveragedFrames(
        mean_dn=frames.mean(axis=0).astype(np.float32),
        variance_dn2=frames.var(axis=0, ddof=1).astype(np.float32),
        frames_used=len(frames),
        incomplete_frames=0,
        resent_packets=0,
        saturated_pixels=int(is_saturated.sum()),
        min_dn=int(frames.min()),
        max_dn=int(frames.max()),
        first_timestamp_ns=1,
        last_timestamp_ns=2,
        is_saturated=is_saturated,
    )
