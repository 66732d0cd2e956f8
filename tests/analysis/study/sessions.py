"""Planned edges for the tests."""

import numpy as np

from analysis.study import EdgeLevels, EdgeSession, PlannedEdge
from calibration.noise import LevelNoise
from simulation.arrays import FloatArray

LEVELS = EdgeLevels(
    low_dn=100.0,
    high_dn=2100.0,
    frame_noise=LevelNoise(offset_dn2=400.0, slope_dn=0.0, floor_dn2=400.0),
)


def planned(
    angles_deg: list[float], per_capture: int = 1, focus_scatter_px2: float = 0.0, frames: int = 4
) -> EdgeSession:
    """Edges of 100 px at these angles, so many to a capture."""
    return EdgeSession(
        edges=tuple(
            PlannedEdge(capture=number // per_capture, angle_deg=angle, length_px=100.0)
            for number, angle in enumerate(angles_deg)
        ),
        levels=LEVELS,
        frames=frames,
        focus_scatter_px2=focus_scatter_px2,
    )


def covariance(x_px: float, y_px: float, rho: float = 0.0) -> FloatArray:
    """Covariance of a PSF of these widths."""
    return np.array([[x_px**2, rho * x_px * y_px], [rho * x_px * y_px, y_px**2]])
