"""How precisely a corner of a board is placed in a planned capture.

Where two dark and two bright squares meet, the image is the product of two blurred steps. The
position is fitted, without weights, together with the directions of both edges, their blur, and the
levels with a slope: ``calibration.geometry`` does so in a window about each corner. Its error
follows from the derivatives of that image and the noise of its pixels.
"""

from dataclasses import dataclass
from math import cos, radians, sin, sqrt

import numpy as np
from scipy.special import ndtr

from analysis.study.edge_information import EdgeLevels
from simulation.arrays import FloatArray

_HALF_MAX_PX = 9.0
_OF_SIDE = 0.42
_BLUR_MARGIN_PX = 1.5
_ERROR_FLOOR_PX = 0.001
"""The window and the least error of ``calibration.geometry``."""

_SMALLEST_SIDE_PX = 20.0
_SMALLEST_SIDE_SIGMAS = 30.0
"""Of smaller or softer squares some markers are missed: at 18 px and sigma 0.6 px, 57 of 70 corners
were found; at 29 px and sigma 1.03 px, 25 of 30; at 31 px, all 18."""

_PHASES_PX = (-0.25, 0.25)
_STEP = 1e-4


@dataclass(frozen=True, slots=True, kw_only=True)
class CornerWindow:
    """The pixels that are fitted about a corner.

    ``side_px``: side of a square of the board. ``clear``: distance from an edge within which only
    its two squares are seen, in sides. ``angle_deg``: direction of the board's rows against +x.
    """

    side_px: float
    clear: float
    angle_deg: float

    @property
    def half_px(self) -> int:
        """Half the side of the window."""
        return int(min(_HALF_MAX_PX, _OF_SIDE * self.side_px))

    def offsets_px(self, phase_px: float) -> FloatArray:
        """Pixels (x, y) about a corner that lies ``phase_px`` from a pixel's centre, both ways."""
        half = self.half_px
        y, x = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float64) - phase_px
        offsets = np.column_stack([x.ravel(), y.ravel()])
        c, s = cos(radians(self.angle_deg)), sin(radians(self.angle_deg))
        from_edges = np.abs(offsets @ np.array([[c, -s], [s, c]]))
        near = max(self.clear * self.side_px - _BLUR_MARGIN_PX, 1.0)
        return np.asarray(offsets[from_edges.min(axis=1) < near])


def corner_err_px(
    window: CornerWindow, sigma_px: float, levels: EdgeLevels, frames: int
) -> float | None:
    """Return the standard error of a corner's coordinate; None if squares are too small or soft.

    ``levels``: levels of dark and bright squares, and the noise of one frame.
    """
    if window.side_px < max(_SMALLEST_SIDE_PX, _SMALLEST_SIDE_SIGMAS * sigma_px):
        return None
    variances = []
    for phase_px in _PHASES_PX:
        offsets = window.offsets_px(phase_px)
        angle = radians(window.angle_deg)
        state = np.array([0.0, 0.0, angle, angle + np.pi / 2, sigma_px])
        product = _saddle(offsets, state)
        design = np.column_stack(
            [
                *(_slope(offsets, state, number) for number in range(state.size)),
                *(np.ones(len(offsets)), *offsets.T, product),
            ]
        )
        half_contrast = 0.5 * levels.contrast_dn
        design[:, : state.size] *= half_contrast
        level = levels.low_dn + half_contrast * (1 + product)
        variance = levels.frame_noise.variance_dn2(level) / frames
        gain = np.linalg.pinv(design)[:2]
        variances.append(float(np.sum(gain**2 * variance)) / 2)
    return sqrt(sum(variances) / len(variances) + _ERROR_FLOOR_PX**2)


def _saddle(offsets: FloatArray, state: FloatArray) -> FloatArray:
    x, y, first, second, sigma_px = state.tolist()
    product = np.ones(len(offsets))
    for angle in (first, second):
        distance = (offsets - (x, y)) @ (np.cos(angle), np.sin(angle))
        product = product * (2 * ndtr(distance / sigma_px) - 1)
    return product


def _slope(offsets: FloatArray, state: FloatArray, number: int) -> FloatArray:
    above, below = state.copy(), state.copy()
    above[number] += _STEP
    below[number] -= _STEP
    return np.asarray((_saddle(offsets, above) - _saddle(offsets, below)) / (2 * _STEP))
