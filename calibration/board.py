"""The corners of a ChArUco board: squares of known size, found and numbered by their markers."""

import re
from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.corner_fit import fit_corners
from calibration.errors import RegistrationError

__all__ = ["DEFAULT_BOARD", "BoardCorners", "CharucoBoard", "find_board"]

FloatArray = NDArray[np.float64]

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
        Side of a square, which every scale rests on, and of a marker.
    dictionary
        Name of OpenCV's marker dictionary, without ``DICT_``.
    """

    columns: int
    rows: int
    square_mm: float
    marker_mm: float
    dictionary: str = "4X4_50"

    def __post_init__(self) -> None:
        if self.columns < 3 or self.rows < 3:
            raise ValueError(f"a board has 3 x 3 squares or more, got {self.columns}x{self.rows}")
        if not 0 < self.marker_mm < self.square_mm:
            raise ValueError(
                f"a marker is smaller than its square, got {self.marker_mm:g} in "
                f"{self.square_mm:g} mm"
            )
        if not hasattr(cv2.aruco, f"DICT_{self.dictionary}"):
            raise ValueError(f"OpenCV has no marker dictionary {self.dictionary}")

    @classmethod
    def from_text(cls, text: str) -> Self:
        """Read ``COLUMNSxROWS:SQUARE_MM:MARKER_MM[:DICTIONARY]``, such as ``11x8:12:9:4X4_50``.

        Raises
        ------
        ValueError
            If it is not of that form, or no such board can be.
        """
        match = _TEXT.fullmatch(text)
        if match is None:
            raise ValueError(
                f"a board is COLUMNSxROWS:SQUARE_MM:MARKER_MM[:DICTIONARY], got {text!r}"
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


DEFAULT_BOARD = CharucoBoard(columns=11, rows=8, square_mm=12.0, marker_mm=9.0)
"""The board that is meant where none is named."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class BoardCorners:
    """Corners of a board in an image.

    ``seen_px`` and ``plane_mm`` have the shape (n, 2), x and y, the board's top left at (0, 0);
    ``err_px`` is the standard error of a corner's coordinate.
    """

    seen_px: FloatArray
    plane_mm: FloatArray
    err_px: FloatArray


def find_board(image: NDArray[np.generic], board: CharucoBoard) -> BoardCorners:
    """Find the corners of a board.

    Parameters
    ----------
    image
        Grey, shape ``(rows, cols)``.
    board
        What was photographed; the board need not be seen whole.

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
            f"only {count} corners of a ChArUco board {board} are found, {_CORNERS_MIN} are needed"
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
    if np.count_nonzero(good) < _CORNERS_MIN:
        raise RegistrationError(
            f"only {np.count_nonzero(good)} corners of the board are sharp enough"
        )
    return BoardCorners(
        seen_px=fitted.points_px[good], plane_mm=plane_mm[good], err_px=fitted.err_px[good]
    )


def _square_axes_px(seen_px: FloatArray, plane_mm: FloatArray, square_mm: float) -> FloatArray:
    """Sides of a square in px at every corner, as columns, shape (n, 2, 2)."""
    matrix = np.asarray(cv2.findHomography(plane_mm, seen_px, cv2.LMEDS)[0], dtype=np.float64)
    depth = plane_mm @ matrix[2, :2] + matrix[2, 2]
    seen = (plane_mm @ matrix[:2, :2].T + matrix[:2, 2]) / depth[:, None]
    change = matrix[:2, :2] - seen[:, :, None] * matrix[2, :2]
    return np.asarray(square_mm * change / depth[:, None, None])
