"""The error of the entrance pupil's offset that planned captures of a board will leave.

The corners of a board give each capture's distance, in a joint fit with the lens and the tilt;
distances against heights give the offset. Both fits are linear about their solution, so that their
errors need no frame.

Where two dark and two bright squares meet, the image is the product of two blurred steps. The
position is fitted, without weights, together with the directions of both edges, their blur, and the
levels with a slope: ``calibration.geometry`` does so in a window about each corner. Its error
follows from the derivatives of that image and the noise of its pixels.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import cos, radians, sin, sqrt

import numpy as np
from scipy.special import ndtr

from analysis.study._edges import EdgeLevels
from calibration.geometry import LENS_SIZE, SHARED_SIZE, CharucoBoard, LensPrior, PlaneLens
from simulation.arrays import FloatArray, IntArray

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
class _CornerWindow:
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


def _corner_err_px(
    window: _CornerWindow, sigma_px: float, levels: EdgeLevels, frames: int
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


HEIGHT_FLOOR_MM = 0.0005
"""Half of the last digit to which heights are recorded."""

_POSE_SIZE = 4
_FEWEST_CORNERS = 12
_MARGIN_PX = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardCapture:
    """One planned capture of a board that lies centred under the camera.

    Captures of one ``placement`` show the same board, not touched in between.
    """

    placement: int
    orientation_deg: float
    height_mm: float


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardSession:
    """The planned captures of a board, and the camera that takes them.

    ``captures``: at two heights or more. ``width_px, height_px, focal_length_px``: frame and focal
    length of the camera. ``pupil_offset_mm``: entrance pupil above height zero, as far as it is
    known beforehand. ``sigma_px``: total width of the PSF. ``levels, frames``: levels of the
    board's squares and noise of one frame; frames of a capture. ``height_scatter_mm``: standard
    deviation of the heights read back about the true ones.
    """

    captures: tuple[BoardCapture, ...]
    board: CharucoBoard
    width_px: int
    height_px: int
    focal_length_px: float
    pupil_offset_mm: float
    sigma_px: float
    levels: EdgeLevels
    frames: int
    height_scatter_mm: float = 0.0

    def distance_mm(self, capture: BoardCapture) -> float:
        """Distance of the entrance pupil from the board."""
        return capture.height_mm + self.pupil_offset_mm

    def corners_mm(self, capture: BoardCapture) -> FloatArray:
        """Corners that are in view, on the plane about the foot of the optical axis, (n, 2).

        A corner is numbered by the markers in both white squares that meet there.
        """
        board, scale = self.board, self.focal_length_px / self.distance_mm(capture)
        col, row = (
            place.ravel().astype(np.float64)
            for place in np.meshgrid(np.arange(1, board.columns), np.arange(1, board.rows))
        )
        centre = np.array([board.columns, board.rows]) / 2
        corners = board.square_mm * (np.column_stack([col, row]) - centre)
        # Black squares lie to the upper left where row and column add up to an even number.
        rises = np.where((col + row) % 2 == 0, -1.0, 1.0)
        beside = [np.column_stack([side * np.ones_like(col), side * rises]) for side in (-1, 1)]
        half_marker_mm = board.marker_mm / 2
        is_seen = np.ones(len(corners), dtype=np.bool_)
        c, s = cos(radians(capture.orientation_deg)), sin(radians(capture.orientation_deg))
        turn = np.array([[c, s], [-s, c]])
        half_frame_px = np.array([self.width_px, self.height_px]) / 2 - _MARGIN_PX
        for square in beside:
            middle = corners + 0.5 * board.square_mm * square
            for x, y in ((-1, -1), (-1, 1), (1, -1), (1, 1)):
                at_px = scale * (middle + half_marker_mm * np.array([x, y])) @ turn
                is_seen &= np.all(np.abs(at_px) < half_frame_px, axis=1)
        return np.asarray((corners @ turn)[is_seen])

    def corner_err_px(self, capture: BoardCapture) -> float | None:
        """Standard error of a corner's coordinate; None if the squares are too small."""
        board = self.board
        window = _CornerWindow(
            side_px=board.square_mm * self.focal_length_px / self.distance_mm(capture),
            clear=(1 - board.marker_mm / board.square_mm) / 2,
            angle_deg=capture.orientation_deg,
        )
        return _corner_err_px(window, self.sigma_px, self.levels, self.frames)


@dataclass(frozen=True, slots=True, kw_only=True)
class PupilErrors:
    """Variances of the offset in mm^2 by source, and the degrees of freedom of the heights."""

    pixels: float
    heights: float
    degrees_of_freedom: int
    captures: int
    corners: int


def pupil_errors(session: BoardSession) -> PupilErrors | None:
    """Predict the error of the pupil offset; None where the captures do not determine it."""
    usable = [one for one in session.captures if _is_usable(session, one)]
    if len({one.height_mm for one in usable}) < 2:
        return None
    _, series = np.unique([one.placement for one in usable], return_inverse=True)
    by_corners = _log_distance_covariance(session, usable, series)
    distance_mm = np.array([session.distance_mm(one) for one in usable])
    by_heights = np.diag((session.height_scatter_mm / distance_mm) ** 2)
    floor = np.diag((HEIGHT_FLOOR_MM / distance_mm) ** 2)
    design = np.column_stack([1 / distance_mm, np.eye(int(series.max()) + 1)[series]])
    if np.linalg.matrix_rank(design) < design.shape[1]:
        return None
    weights = np.linalg.inv(by_corners + by_heights + floor)
    gain = np.linalg.solve(design.T @ weights @ design, design.T @ weights)[0]
    return PupilErrors(
        pixels=float(gain @ by_corners @ gain),
        heights=float(gain @ by_heights @ gain),
        degrees_of_freedom=len(usable) - design.shape[1],
        captures=len(usable),
        corners=sum(len(session.corners_mm(one)) for one in usable),
    )


def _is_usable(session: BoardSession, capture: BoardCapture) -> bool:
    return (
        len(session.corners_mm(capture)) >= _FEWEST_CORNERS
        and session.corner_err_px(capture) is not None
    )


def _log_distance_covariance(
    session: BoardSession, captures: Sequence[BoardCapture], series: IntArray
) -> FloatArray:
    """Covariance of the logarithms of the distances in a joint fit of lens, tilts and poses."""
    lens = PlaneLens(
        width_px=session.width_px,
        height_px=session.height_px,
        focal_length_px=session.focal_length_px,
    )
    poses = LENS_SIZE + (SHARED_SIZE - LENS_SIZE) * (int(series.max()) + 1)
    size = poses + _POSE_SIZE * len(captures)
    information = np.zeros((size, size))
    for number, (capture, placement) in enumerate(zip(captures, series.tolist(), strict=True)):
        corners = session.corners_mm(capture)
        to_px = session.focal_length_px / session.distance_mm(capture)
        shared = session.focal_length_px * lens.slope_changes(
            lens.pixels(corners / session.distance_mm(capture))
        )
        pose = np.zeros((len(corners), 2, _POSE_SIZE))
        pose[:, :, 0] = corners
        pose[:, 0, 1], pose[:, 1, 1] = -corners[:, 1], corners[:, 0]
        pose[:, 0, 2] = pose[:, 1, 3] = 1.0
        tilt = LENS_SIZE + (SHARED_SIZE - LENS_SIZE) * placement
        columns = [*range(LENS_SIZE), tilt, tilt + 1]
        columns += range(poses + _POSE_SIZE * number, poses + _POSE_SIZE * (number + 1))
        err_px = session.corner_err_px(capture) or np.inf
        design = np.concatenate([shared, to_px * pose], axis=2).reshape(-1, len(columns)) / err_px
        information[np.ix_(columns, columns)] += design.T @ design
    prior = np.zeros(size)
    prior[:LENS_SIZE] = LensPrior().precisions
    # The lens is known beforehand to some degree; what is known does not scatter.
    gain = np.linalg.inv(information + np.diag(prior))
    log_distance = poses + _POSE_SIZE * np.arange(len(captures))
    return np.asarray((gain @ information @ gain)[np.ix_(log_distance, log_distance)])
