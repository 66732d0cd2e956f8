"""How far a camera is from square to what it looks at, and which side to raise.

Either from the heights at which regions of the picture are in focus, or from one photograph of a
board. Both tell the slope of the distance across the picture: positive where what is shown further
right, or further down, is further away.
"""

from dataclasses import dataclass
from math import atan, degrees

import numpy as np
from scipy.optimize import least_squares

from calibration.geometry.board import BoardCorners
from simulation.arrays import FloatArray

_COEFFICIENTS = 3
_CORNERS_MIN = 5  # of 8 parameters
_LEVEL_SIGMAS = 2.0
_LEVEL_DEG = 0.05
"""Less than this is level: a millimetre in a metre."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Levelling:
    """Angles between the sensor and the plane of the scene, in degrees, with standard errors.

    ``right_deg`` is positive where the right of the picture is further away, ``down_deg`` where
    its bottom is. The errors are NaN where nothing tells them.
    """

    right_deg: float
    right_err_deg: float
    down_deg: float
    down_err_deg: float

    @property
    def advice(self) -> str:
        """Which side of the camera to raise, in words; sides are those of the picture."""
        sides = []
        for angle, err, near, far in (
            (self.right_deg, self.right_err_deg, "left", "right"),
            (self.down_deg, self.down_err_deg, "top", "bottom"),
        ):
            told = _LEVEL_SIGMAS * err if np.isfinite(err) else 0.0
            if abs(angle) > max(_LEVEL_DEG, told):
                nearer = near if angle > 0 else far
                sides.append(f"raise the {nearer} side by {abs(angle):.2f}°")
        return "; ".join(sides) or "level"


def level_by_focus(
    peaks_mm: FloatArray, peak_errs_mm: FloatArray, positions_px: FloatArray, mm_per_px: float
) -> Levelling:
    """Slopes of the scene from the camera's heights at which regions are sharpest.

    A region that is nearer is sharp from further up. The slopes are those of the plane that fits
    best, so that a curved field, which is the same on all sides, does not count.

    Parameters
    ----------
    peaks_mm
        Height of best focus of each region, shape ``(n,)``, at least 3.
    peak_errs_mm
        Their standard errors.
    positions_px
        Centre of each region, columns x and y, shape ``(n, 2)``.
    mm_per_px
        Size of a pixel in the scene.

    Raises
    ------
    ValueError
        If there are fewer than three regions, or they lie on one line.
    """
    if len(peaks_mm) < _COEFFICIENTS:
        raise ValueError(f"levelling needs at least 3 regions, got {len(peaks_mm)}")
    centred_mm = (positions_px - positions_px.mean(axis=0)) * mm_per_px
    weights = 1 / np.maximum(peak_errs_mm, 1e-9)
    design = np.column_stack([np.ones(len(peaks_mm)), centred_mm])
    weighted = design * weights[:, None]
    if np.linalg.matrix_rank(weighted) < _COEFFICIENTS:
        raise ValueError("levelling needs regions that are not on one line")
    fitted, *_ = np.linalg.lstsq(weighted, peaks_mm * weights, rcond=None)
    errs = np.sqrt(np.diag(np.linalg.inv(weighted.T @ weighted)))
    right, down = -fitted[1], -fitted[2]
    return Levelling(
        right_deg=degrees(atan(right)),
        right_err_deg=degrees(errs[1] / (1 + right**2)),
        down_deg=degrees(atan(down)),
        down_err_deg=degrees(errs[2] / (1 + down**2)),
    )


def level_by_board(
    corners: BoardCorners, shape: tuple[int, int], focal_length_px: float
) -> Levelling:
    """Slopes of a board from its perspective in one photograph.

    A homography maps the board to the picture; its last row is the slope of the distance. The
    lens is taken to have no distortion and its axis to meet the middle of the picture.

    Parameters
    ----------
    corners
        At least five of the board's corners, no three of four on one line.
    shape
        ``(rows, cols)`` of the picture.
    focal_length_px
        Focal length over pixel pitch; if it is wrong, the angles are wrong by the same factor.

    Raises
    ------
    ValueError
        If there are too few corners.
    """
    if len(corners.plane_mm) < _CORNERS_MIN:
        raise ValueError(
            f"levelling needs at least {_CORNERS_MIN} corners, got {len(corners.plane_mm)}"
        )
    rows, cols = shape
    middle_px = np.array([(cols - 1) / 2, (rows - 1) / 2])
    seen = (corners.seen_px - middle_px) / focal_length_px
    board_mm = corners.plane_mm - corners.plane_mm.mean(axis=0)

    def residuals(p: FloatArray) -> FloatArray:
        below = 1 + board_mm @ p[6:]
        right = (board_mm @ p[0:2] + p[4]) / below - seen[:, 0]
        down = (board_mm @ p[2:4] + p[5]) / below - seen[:, 1]
        return np.concatenate([right, down])

    affine, *_ = np.linalg.lstsq(np.column_stack([board_mm, np.ones(len(seen))]), seen, rcond=None)
    start = np.concatenate([affine[:2, 0], affine[:2, 1], affine[2], [0.0, 0.0]])
    size = float(np.abs(start[:4]).max())
    scale = np.array([size] * 4 + [1.0] * 2 + [size] * 2)
    solved = least_squares(residuals, start, method="lm", x_scale=scale)
    jacobian = np.asarray(solved.jac) * scale
    noise = 2 * solved.cost / (2 * len(seen) - start.size)
    covariance = np.linalg.inv(jacobian.T @ jacobian) * noise * np.outer(scale, scale)
    found = _board_slopes(solved.x)
    steps = np.sqrt(np.diag(covariance)) + 1e-9 * scale
    gradient = np.column_stack(
        [
            (_board_slopes(solved.x + step * axis) - found) / step
            for step, axis in zip(steps, np.eye(start.size), strict=True)
        ]
    )
    errs = np.sqrt(np.diag(gradient @ covariance @ gradient.T))
    return Levelling(
        right_deg=degrees(atan(found[0])),
        right_err_deg=degrees(errs[0] / (1 + found[0] ** 2)),
        down_deg=degrees(atan(found[1])),
        down_err_deg=degrees(errs[1] / (1 + found[1] ** 2)),
    )


def _board_slopes(p: FloatArray) -> FloatArray:
    """Distance over the camera's axes, from that over the board's."""
    return np.asarray(np.linalg.solve(p[:4].reshape(2, 2).T, p[6:]), dtype=np.float64)
