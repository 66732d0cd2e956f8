"""The pose of a moving camera, frame by frame, always measured against the reference itself.

The reference is warped to the last known pose and compared with the frame by Lucas-Kanade flow at
some hundred corners; a robust homography through them is the new pose. As no frame is measured
against another frame, nothing drifts. ``benchmarks/speed/pose_tracking.py`` measures the speed for
which this method was chosen.

References
----------
J.-Y. Bouguet, "Pyramidal implementation of the Lucas Kanade feature tracker", 2001.
"""

from dataclasses import dataclass, field
from math import log, sqrt

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.errors import RegistrationError
from calibration.registration._descent import zoom_at_centre
from calibration.registration._features import ImageFeatures, find_features, homography_pose
from simulation.arrays import AnyArray, Float32Array, FloatArray
from simulation.pose import project, projection_depth

ByteImage = NDArray[np.uint8]

_CORNERS = 400
_CORNER_QUALITY = 0.003
_CORNER_DISTANCE_PX = 12
_WINDOW_PX = 21
_PYRAMID_LEVELS = 3
"""21 px windows on a pyramid of three halvings follow some 40 px of motion between frames."""

_INLIER_PX = 1.5
_INLIERS_MIN = 24
_INLIER_SHARE_MIN = 0.5
_SECOND_PASS_PX = 1.0
"""Median motion above which the reference is warped again, so that its patches look alike."""

_ANCHOR_PASSES = 3
_PSF_PX = 0.7
"""PSF width of a sharp camera, to soften the reference with; good enough for the flow."""

_ZOOM_STEP = 1.25
_ZOOM_MAX = 10.0
_MIN_CONTRAST = 1e-9
_CLIPPED_PERCENT = 0.1
"""Brightest and darkest pixels to ignore in the range of levels: hot and dead ones."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TrackedPose:
    """Pose of a frame in the reference, pixel centres to pixel centres.

    The zoom is in reference px per frame px at the centre; ``rms_px`` of corners that agree, which
    are at ``frame_px`` and ``reference_px``, shape (n, 2).
    """

    matrix: FloatArray = field(repr=False)
    zoom: float
    inlier_count: int
    rms_px: float
    frame_px: FloatArray = field(repr=False)
    reference_px: FloatArray = field(repr=False)


@dataclass(frozen=True, slots=True, eq=False)
class _Softened:
    """The reference softened as from a distance, and its corners ``(x, y)``, shape (n, 2)."""

    levels: ByteImage
    corners_px: FloatArray


class TrackingReference:
    """A grey reference image with enough corners to be found in frame after frame."""

    def __init__(self, reference: AnyArray) -> None:
        self._levels = _bytes_of(reference)
        self._softened: dict[int, _Softened] = {}
        self._features: ImageFeatures | None = None
        self._at(1.0)

    @property
    def shape(self) -> tuple[int, int]:
        """``(rows, cols)`` of the reference."""
        return self._levels.shape[0], self._levels.shape[1]

    def anchored(self, frame: AnyArray) -> TrackedPose:
        """Find the pose of a grey, finite frame by matched features, then by the flow."""
        levels = _bytes_of(frame)
        if self._features is None:
            self._features = find_features(self._levels, "reference")
        matrix, _ = homography_pose(self._features.matched_with(find_features(levels, "followup")))
        return self._flowed(levels, matrix, _ANCHOR_PASSES)

    def followed(self, frame: AnyArray, matrix: FloatArray) -> TrackedPose:
        """Measure the pose of a frame close to a known one; an error if too few corners agree."""
        return self._flowed(_bytes_of(frame), np.asarray(matrix, dtype=np.float64), 2)

    def _flowed(self, levels: ByteImage, matrix: FloatArray, passes: int) -> TrackedPose:
        found, motion_px = self._one_pass(levels, matrix)
        for _ in range(passes - 1):
            if motion_px < _SECOND_PASS_PX:
                break
            found, motion_px = self._one_pass(levels, found.matrix)
        return found

    def _one_pass(self, levels: ByteImage, matrix: FloatArray) -> tuple[TrackedPose, float]:
        """Pose and median motion by one flow from the warped reference to the frame."""
        rows, cols = levels.shape
        near = self._at(zoom_at_centre(matrix, (rows, cols)))
        inverse = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
        expected = np.column_stack(project(inverse, *near.corners_px.T))
        border = _WINDOW_PX // 2 + 1
        seen = (
            (projection_depth(inverse, *near.corners_px.T) > 0)
            & np.all(expected >= border, axis=1)
            & np.all(expected <= [cols - 1 - border, rows - 1 - border], axis=1)
        )
        if np.count_nonzero(seen) < _INLIERS_MIN:
            raise RegistrationError(
                "too little of the reference is in the frame", reason="little_overlap"
            )
        corners, start = near.corners_px[seen], expected[seen].astype(np.float32)
        flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
        warped = np.asarray(
            cv2.warpPerspective(
                near.levels, matrix, (cols, rows), flags=flags, borderMode=cv2.BORDER_REPLICATE
            ),
            dtype=np.uint8,
        )
        ends, followed, _ = cv2.calcOpticalFlowPyrLK(
            _lit_like(warped, levels, start),
            levels,
            start[:, None, :],
            start[:, None, :].copy(),
            winSize=(_WINDOW_PX, _WINDOW_PX),
            maxLevel=_PYRAMID_LEVELS,
            criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.02),
            flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        )
        kept = followed.ravel().astype(bool)
        tracked, corners = np.asarray(ends, dtype=np.float64)[kept, 0], corners[kept]
        return _fitted(tracked, corners, (rows, cols)), float(
            np.median(np.hypot(*(tracked - start[kept]).T)) if len(tracked) else np.inf
        )

    def _at(self, zoom: float) -> _Softened:
        """Reference softened for a zoom, in steps; computed once for each step."""
        step = max(round(log(max(zoom, 1.0)) / log(_ZOOM_STEP)), 0)
        if step not in self._softened:
            rounded = _ZOOM_STEP**step
            levels = self._levels
            if step:
                sigma = _PSF_PX * sqrt(rounded**2 - 1)
                levels = np.asarray(cv2.GaussianBlur(levels, (0, 0), sigma), dtype=np.uint8)
            self._softened[step] = _Softened(levels, _corners_px(levels, rounded))
        return self._softened[step]


def _fitted(tracked: FloatArray, corners: FloatArray, shape: tuple[int, int]) -> TrackedPose:
    if len(tracked) < _INLIERS_MIN:
        raise RegistrationError(
            f"only {len(tracked)} corners of the reference could be tracked",
            reason="no_matches",
            count=len(tracked),
        )
    # From the reference to the frame, because the flow's error is in pixels of the frame.
    fit, mask = cv2.findHomography(
        corners, tracked, cv2.RANSAC, _INLIER_PX, maxIters=500, confidence=0.999
    )
    inverse = np.asarray(fit, dtype=np.float64)
    # If it finds nothing, OpenCV returns an empty matrix or None.
    count = int(np.count_nonzero(mask)) if inverse.shape == (3, 3) else 0
    if count < _INLIERS_MIN or count / len(tracked) < _INLIER_SHARE_MIN:
        raise RegistrationError(
            f"only {count} of {len(tracked)} corners agree on a pose",
            reason="no_common_pose",
            count=count,
        )
    inlier = mask.ravel().astype(bool)
    rest = np.column_stack(project(inverse, *corners[inlier].T)) - tracked[inlier]
    matrix: FloatArray = np.linalg.inv(inverse).astype(np.float64)
    matrix /= matrix[2, 2]
    zoom = zoom_at_centre(matrix, shape)
    if not (1 / _ZOOM_MAX < zoom < _ZOOM_MAX and np.linalg.det(matrix) > 0):
        raise RegistrationError(
            f"the pose found is not possible for a camera (zoom {zoom:.3g})", reason="inside_out"
        )
    return TrackedPose(
        matrix=matrix,
        zoom=zoom,
        inlier_count=count,
        rms_px=float(np.sqrt(np.mean(np.sum(rest**2, axis=1)))),
        frame_px=tracked[inlier],
        reference_px=corners[inlier],
    )


def _corners_px(levels: ByteImage, zoom: float) -> FloatArray:
    """Corners ``(x, y)``, shape (n, 2), well apart and away from the border."""
    border = round(_WINDOW_PX // 2 * zoom)
    mask = np.zeros(levels.shape, dtype=np.uint8)
    mask[border:-border, border:-border] = 255
    found = cv2.goodFeaturesToTrack(
        levels, _CORNERS, _CORNER_QUALITY, _CORNER_DISTANCE_PX * zoom, mask=mask, blockSize=5
    )
    # If it finds none, OpenCV returns None.
    corners = np.asarray(() if not np.shape(found) else found, dtype=np.float64).reshape(-1, 2)
    if len(corners) < _INLIERS_MIN:
        raise RegistrationError(
            f"the reference has only {len(corners)} corners to track",
            reason="no_detail",
            at_fault="reference",
            count=len(corners),
        )
    return corners


def _lit_like(warped: ByteImage, frame: ByteImage, corners: Float32Array) -> ByteImage:
    """Reference in the frame's light: mean and contrast around the corners are made equal."""
    reach_px = _WINDOW_PX // 2
    steps = np.arange(-reach_px, reach_px + 1, 5)
    y, x = (
        (places[:, None, None] + offsets).clip(0, most - 1)
        for places, offsets, most in (
            (np.rint(corners[:, 1]).astype(np.intp), steps[:, None], frame.shape[0]),
            (np.rint(corners[:, 0]).astype(np.intp), steps[None, :], frame.shape[1]),
        )
    )
    was, seen = warped[y, x], frame[y, x]
    contrast = max(float(was.std()), _MIN_CONTRAST)
    gain = float(seen.std()) / contrast
    lit = np.clip(gain * (np.arange(256.0) - was.mean()) + seen.mean() + 0.5, 0.0, 255.0)
    return np.asarray(cv2.LUT(warped, lit.astype(np.uint8)), dtype=np.uint8)


def _bytes_of(image: AnyArray) -> ByteImage:
    """Levels from 0 to 255, as the flow needs them."""
    if image.ndim != 2 or min(image.shape) < 4 * _WINDOW_PX:
        raise ValueError(
            f"tracking needs grey images of at least {4 * _WINDOW_PX} px each way, "
            f"got {image.shape}"
        )
    values = np.asarray(image, dtype=np.float32)
    low, high = np.percentile(values[::3, ::3], [_CLIPPED_PERCENT, 100 - _CLIPPED_PERCENT])
    if not np.isfinite([low, high]).all():
        raise ValueError("tracking needs images with finite values")
    if high <= low:
        raise RegistrationError("a constant image cannot be tracked", reason="no_detail", count=0)
    if image.dtype == np.uint8:
        return np.ascontiguousarray(image, dtype=np.uint8)
    gain = 255.0 / float(high - low)
    return np.asarray(np.clip((values - low) * gain + 0.5, 0.0, 255.0), dtype=np.uint8)
