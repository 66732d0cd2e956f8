"""The corners of a ChArUco board, and the tilt of a camera relative to its target.

The tilt, and the side of the camera to raise, follow either from the heights at which regions of
the picture are in focus, or from one photograph of a board. Both give the slope of the distance
across the picture: positive if the right side, or the bottom, is further away.
"""

import re
from dataclasses import dataclass
from math import atan, degrees
from typing import Self

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.special import ndtr

from calibration.choices import DEFAULT_BOARD_TEXT
from calibration.errors import RegistrationError
from simulation.arguments import ArgumentError, check_fields
from simulation.arrays import AnyArray, BoolArray, FloatArray
from simulation.pose import projection_slopes

_HALF_MAX_PX = 9.0
"""Beyond this, the curvature of the edges by lens distortion would matter."""
_BLUR_MARGIN_PX = 1.5
_ITERATIONS = 20
_CONVERGED_PX = 1e-4
_MOVE_MAX_PX = 1.5
_ERROR_FLOOR_PX = 0.001
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(2)
_PIXEL_NODES = tuple(
    (np.array([x, y]) / 2, wx * wy / 4)
    for x, wx in zip(_NODES, _WEIGHTS, strict=True)
    for y, wy in zip(_NODES, _WEIGHTS, strict=True)
)
"""Positions in a pixel, and weights with sum 1: the mean over the area of the pixel."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _FittedCorners:
    """Positions (x, y) of corners, shape (n, 2), their errors, and which fits converged near by."""

    points_px: FloatArray
    err_px: FloatArray
    is_good: BoolArray


def _fit_corners(
    image: FloatArray, points_px: FloatArray, axes_px: FloatArray, clear: float
) -> _FittedCorners:
    """Fit every corner from positions, shape ``(n, 2)``, that are right to a pixel.

    Axes are the sides of a square in px, as columns, shape ``(n, 2, 2)``. Within ``clear`` sides of
    a square from an edge only its two squares are seen.
    """
    fitted, errors = points_px.copy(), np.full(len(points_px), np.inf)
    for number, (point, axes) in enumerate(zip(points_px, axes_px, strict=True)):
        found = _fit_corner(image, point, axes, clear)
        if found is not None:
            fitted[number], errors[number] = found
    return _FittedCorners(points_px=fitted, err_px=errors, is_good=np.isfinite(errors))


def _fit_corner(
    image: FloatArray, point: FloatArray, axes: FloatArray, clear: float
) -> tuple[FloatArray, float] | None:
    side_px = float(np.hypot(*axes).min())
    half = int(min(_HALF_MAX_PX, 0.42 * side_px))
    col, row = (round(float(value)) for value in point)
    rows, cols = image.shape
    if half < 3 or not (half <= col < cols - half and half <= row < rows - half):
        return None
    y, x = np.mgrid[row - half : row + half + 1, col - half : col + half + 1].astype(np.float64)
    inside = np.column_stack([(x - point[0]).ravel(), (y - point[1]).ravel()])
    along = np.abs(inside @ np.linalg.inv(axes).T) * side_px
    chosen = along.min(axis=1) < max(clear * side_px - _BLUR_MARGIN_PX, 1.0)
    offsets = inside[chosen]
    values = image[row - half : row + half + 1, col - half : col + half + 1].ravel()[chosen]
    normals = np.arctan2(axes[0], -axes[1])
    # x, y, the angles of the normals of both edges, width; the levels are linear.
    state = np.array([0.0, 0.0, normals[0], normals[1], 0.6])
    for _ in range(_ITERATIONS):
        design, residual, contrast = _corner_equations(offsets, values, state)
        if abs(contrast) < 1e-9 or not np.all(np.isfinite(design)):
            return None
        step, _, rank, _ = np.linalg.lstsq(design, residual, rcond=None)
        if rank < design.shape[1]:
            return None
        state = state + np.clip(step[:5], -0.5, 0.5)
        state[4] = min(max(state[4], 0.2), 4.0)
        if np.abs(step[:2]).max() < _CONVERGED_PX:
            break
    else:
        return None
    if np.hypot(*state[:2]) > _MOVE_MAX_PX:
        return None
    variance = float(residual @ residual) / max(len(residual) - design.shape[1], 1)
    spread = np.linalg.inv(design.T @ design)[:2, :2] * variance
    return point + state[:2], float(np.sqrt(np.trace(spread) / 2 + _ERROR_FLOOR_PX**2))


def _corner_equations(
    offsets: FloatArray, values: FloatArray, state: FloatArray
) -> tuple[FloatArray, FloatArray, float]:
    """Derivatives by the state and the levels, the residual, and the contrast."""
    x0, y0, first, second, width = state
    product = np.zeros(len(offsets))
    shape = np.zeros((len(offsets), len(state)))
    for inside_px, weight in _PIXEL_NODES:
        points = offsets - (x0, y0) + inside_px
        (a, da, sa, ga, ta), (b, db, sb, gb, tb) = (
            _blurred_step(points, angle, width) for angle in (first, second)
        )
        product += weight * sa * sb
        shape += weight * np.column_stack(
            [
                -(np.cos(a) * ga * sb + np.cos(b) * sa * gb),
                -(np.sin(a) * ga * sb + np.sin(b) * sa * gb),
                ga * ta * sb,
                sa * gb * tb,
                -(ga * da * sb + sa * gb * db) / width,
            ]
        )
    levels = np.column_stack([np.ones_like(product), offsets, product])
    amounts = np.linalg.lstsq(levels, values, rcond=None)[0]
    contrast = float(amounts[3])
    return np.column_stack([contrast * shape, levels]), values - levels @ amounts, contrast


def _blurred_step(
    points: FloatArray, angle: float, width: float
) -> tuple[float, FloatArray, FloatArray, FloatArray, FloatArray]:
    """A step from -1 to 1: angle, distance, level, steepness, and distance along it."""
    distance = points @ (np.cos(angle), np.sin(angle))
    level = 2 * ndtr(distance / width) - 1
    steepness = np.sqrt(2 / np.pi) * np.exp(-0.5 * (distance / width) ** 2) / width
    return angle, distance, level, steepness, points @ (-np.sin(angle), np.cos(angle))


_CORNERS_MIN = 12
_TEXT = re.compile(r"(\d+)x(\d+):([\d.]+):([\d.]+)(?::(\w+))?")


@dataclass(frozen=True, slots=True, kw_only=True)
class CharucoBoard:
    """A ChArUco board as OpenCV prints it since version 4.6: its top left square is black.

    Parameters
    ----------
    columns, rows
        Number of squares along the width and the height.
    square_mm, marker_mm
        Side of a square, which determines every scale, and side of a marker.
    dictionary
        Name of OpenCV's marker dictionary, without ``DICT_``.
    """

    columns: int
    rows: int
    square_mm: float
    marker_mm: float
    dictionary: str = "4X4_50"

    def __post_init__(self) -> None:
        check_fields(self)
        if self.columns < 3 or self.rows < 3:
            raise ArgumentError(
                f"a board needs at least 3 x 3 squares, got {self.columns}x{self.rows}"
            )
        if not 0 < self.marker_mm < self.square_mm:
            raise ArgumentError(
                f"a marker must be smaller than its square, got {self.marker_mm:g} in "
                f"{self.square_mm:g} mm"
            )
        if not hasattr(cv2.aruco, f"DICT_{self.dictionary}"):
            raise ArgumentError(f"OpenCV has no marker dictionary {self.dictionary}")

    @classmethod
    def from_text(cls, text: str) -> Self:
        """Read ``COLUMNSxROWS:SQUARE_MM:MARKER_MM[:DICTIONARY]``, such as ``11x8:12:9:4X4_50``.

        Raises
        ------
        ValueError
            If the text does not have that form, or no such board can exist.
        """
        match = _TEXT.fullmatch(text)
        if match is None:
            raise ValueError(
                f"a board must be COLUMNSxROWS:SQUARE_MM:MARKER_MM[:DICTIONARY], got {text!r}"
            )
        columns, rows, square_mm, marker_mm, dictionary = match.groups()
        return cls(
            columns=int(columns),
            rows=int(rows),
            square_mm=float(square_mm),
            marker_mm=float(marker_mm),
            dictionary=dictionary or "4X4_50",
        )

    def __str__(self) -> str:
        """``11x8:12:9:4X4_50``."""
        return f"{self.columns}x{self.rows}:{self.square_mm:g}:{self.marker_mm:g}:{self.dictionary}"


DEFAULT_BOARD = CharucoBoard.from_text(DEFAULT_BOARD_TEXT)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BoardCorners:
    """Corners of a board in an image and on it, x and y, shape (n, 2), with their error."""

    seen_px: FloatArray
    plane_mm: FloatArray
    err_px: FloatArray


def find_board(image: AnyArray, board: CharucoBoard) -> BoardCorners:
    """Find at least 12 corners of a board, which need not be completely in view."""
    values = np.asarray(image, dtype=np.float64)
    low, high = np.percentile(values, [0.5, 99.5])
    bytes_ = np.clip((values - low) * (255.0 / max(high - low, 1e-9)), 0, 255).astype(np.uint8)
    layout = cv2.aruco.CharucoBoard(
        (board.columns, board.rows),
        board.square_mm,
        board.marker_mm,
        cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, f"DICT_{board.dictionary}")),
    )
    found_px, found_ids, _, _ = cv2.aruco.CharucoDetector(layout).detectBoard(bytes_)
    count = 0 if found_ids is None else len(found_ids)
    if count < _CORNERS_MIN:
        raise RegistrationError(
            f"only {count} corners of a ChArUco board {board} found, but {_CORNERS_MIN} are needed",
            reason="no_board",
            count=count,
        )
    seen_px = np.asarray(found_px, dtype=np.float64).reshape(-1, 2)
    corners_mm = np.asarray(layout.getChessboardCorners(), dtype=np.float64)[:, :2]
    plane_mm = corners_mm[np.asarray(found_ids).ravel()]
    fitted = _fit_corners(
        values,
        seen_px,
        _square_axes_px(seen_px, plane_mm, board.square_mm),
        (1 - board.marker_mm / board.square_mm) / 2,
    )
    good = fitted.is_good
    count = int(np.count_nonzero(good))
    if count < _CORNERS_MIN:
        raise RegistrationError(
            f"only {count} corners of the board are sharp enough", reason="no_board", count=count
        )
    return BoardCorners(
        seen_px=fitted.points_px[good], plane_mm=plane_mm[good], err_px=fitted.err_px[good]
    )


def _square_axes_px(seen_px: FloatArray, plane_mm: FloatArray, square_mm: float) -> FloatArray:
    """Sides of a square in px at every corner, as columns, shape (n, 2, 2)."""
    found = cv2.findHomography(plane_mm, seen_px, cv2.LMEDS)[0]
    if found is None:
        raise RegistrationError(
            f"the {len(seen_px)} corners found do not lie on a plane; take a sharper photograph of "
            "the board",
            reason="no_board",
            count=len(seen_px),
        )
    matrix = np.asarray(found, dtype=np.float64)
    slopes = np.stack(projection_slopes(matrix, *plane_mm.T), axis=-1)
    return square_mm * slopes.reshape(-1, 2, 2)


_COEFFICIENTS = 3
_LEVELLING_CORNERS_MIN = 5  # of 8 parameters
_LEVEL_SIGMAS = 2.0
_LEVEL_DEG = 0.05
"""Less than this is level: a millimetre in a metre."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Levelling:
    """Angles between the sensor and the plane of the scene, in degrees, with standard errors.

    They are positive where the right or the bottom of the picture is further away; errors are NaN
    where nothing tells them.
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
    best, so that a curved field does not count. Centres of regions are x and y, shape ``(n, 2)``;
    at least three, not on one line.
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
    """Slopes of a board from its perspective in one photograph, from five corners on.

    The last row of the homography is the slope of the distance. The lens is taken to have no
    distortion and its axis to meet the middle; the angles are wrong as the focal length is.
    """
    if len(corners.plane_mm) < _LEVELLING_CORNERS_MIN:
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
