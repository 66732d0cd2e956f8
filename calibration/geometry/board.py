"""The corners of a ChArUco board: squares of known size, found and numbered by the markers."""

import re
from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
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
class FittedCorners:
    """Positions (x, y) of corners, shape (n, 2), errors of a coordinate, and which are good.

    A corner is good if its fit converged near the starting point.
    """

    points_px: FloatArray
    err_px: FloatArray
    is_good: BoolArray


def fit_corners(
    image: FloatArray, points_px: FloatArray, axes_px: FloatArray, clear: float
) -> FittedCorners:
    """Fit every corner.

    Parameters
    ----------
    image
        Grey, shape ``(rows, cols)``.
    points_px
        Approximate positions of the corners, shape (n, 2), accurate to a pixel.
    axes_px
        The sides of a square in px, as columns, at each corner: shape (n, 2, 2).
    clear
        Distance from an edge within which only its two squares are seen, in sides of a square.

    Returns
    -------
    FittedCorners
        In the order of ``points_px``.
    """
    fitted, errors = points_px.copy(), np.full(len(points_px), np.inf)
    for number, (point, axes) in enumerate(zip(points_px, axes_px, strict=True)):
        found = _fit_corner(image, point, axes, clear)
        if found is not None:
            fitted[number], errors[number] = found
    return FittedCorners(points_px=fitted, err_px=errors, is_good=np.isfinite(errors))


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
    """A ChArUco board as OpenCV prints it since 4.6: its top left square is black.

    Parameters
    ----------
    columns, rows
        Number of squares.
    square_mm, marker_mm
        Side of a square, on which every scale depends, and of a marker.
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
    """Corners of a board in an image.

    ``seen_px`` and ``plane_mm`` have the shape (n, 2), x and y; the top left of the board is at
    (0, 0). ``err_px`` is the standard error of a corner's coordinate.
    """

    seen_px: FloatArray
    plane_mm: FloatArray
    err_px: FloatArray


def find_board(image: AnyArray, board: CharucoBoard) -> BoardCorners:
    """Find the corners of a board.

    Parameters
    ----------
    image
        Grey, shape ``(rows, cols)``.
    board
        The board that was photographed; it need not be completely in view.

    Raises
    ------
    RegistrationError
        If fewer than 12 corners are found.
    """
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
            f"only {count} corners of a ChArUco board {board} found, {_CORNERS_MIN} are needed",
            reason="no_board",
            count=count,
        )
    seen_px = np.asarray(found_px, dtype=np.float64).reshape(-1, 2)
    corners_mm = np.asarray(layout.getChessboardCorners(), dtype=np.float64)[:, :2]
    plane_mm = corners_mm[np.asarray(found_ids).ravel()]
    fitted = fit_corners(
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
    """Sides of a square in px at every corner, as columns, shape (n, 2, 2).

    Raises
    ------
    RegistrationError
        If no plane fits the corners.
    """
    found = cv2.findHomography(plane_mm, seen_px, cv2.LMEDS)[0]
    if found is None:
        raise RegistrationError(
            f"the {len(seen_px)} corners found lie on no plane; photograph the board sharper",
            reason="no_board",
            count=len(seen_px),
        )
    matrix = np.asarray(found, dtype=np.float64)
    slopes = np.stack(projection_slopes(matrix, *plane_mm.T), axis=-1)
    return square_mm * slopes.reshape(-1, 2, 2)
