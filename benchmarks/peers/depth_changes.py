"""Changes of scenes with depth by OpenCV's stereo and flow: the difference where each is matched.

Both begin with the reference on the follow-up's pixels by the true homography. What has no match
says nothing of a change.
"""

from typing import Any

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

from benchmarks.peers.alignments import Matching, detector_of, matches_of
from benchmarks.peers.changes import SMOOTHING_PX, WARP, AlignedPair, program
from benchmarks.peers.program import PeerError, stretched
from simulation.arrays import AnyArray, FloatArray

_MATCHING = Matching(tolerance_px=1.0)
_LEAST_AGREEING = 8
_FARTHEST_PX = 48
_BLOCK_PX = 5
_SMOOTH = (8 * _BLOCK_PX**2, 32 * _BLOCK_PX**2)
"""Penalties of a step of one and of more, as OpenCV's own example has them."""

_SIXTEENTHS = 16.0


def flow_difference(pair: AlignedPair) -> FloatArray:
    """Difference behind OpenCV's dense inverse search (Kroeger and others 2016)."""
    before, after = (stretched(image) for image in (pair.warped, pair.followup))
    nothing: Any = None
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(after, before, nothing)
    return _difference(pair.followup, _seen(pair.warped, flow[..., 0], flow[..., 1]))


def stereo_difference(pair: AlignedPair) -> FloatArray:
    """Difference behind semi-global matching (Hirschmüller 2008) of the rectified pair.

    Rectified without calibration (Hartley 1999) by SIFT's matches that agree with a fundamental
    matrix; the difference is brought back to the follow-up's pixels.
    """
    before, after = (stretched(image) for image in (pair.warped, pair.followup))
    matches = matches_of(before, after, detector_of("sift"), _MATCHING)
    ends = matches.followup_px, matches.reference_px
    fundamental, agreeing = cv2.findFundamentalMat(
        *ends, cv2.USAC_MAGSAC, _MATCHING.tolerance_px, 0.999, 10_000
    )
    if np.shape(fundamental) != (3, 3) or np.count_nonzero(agreeing) < _LEAST_AGREEING:
        raise PeerError("no epipolar geometry")
    kept = agreeing.ravel() > 0
    rows, cols = pair.followup.shape
    is_found, to_after, to_before = cv2.stereoRectifyUncalibrated(
        ends[0][kept], ends[1][kept], fundamental, (cols, rows)
    )
    if not is_found:
        raise PeerError("the pair cannot be rectified")
    rectified = [
        cv2.warpPerspective(image, matrix, (cols, rows), flags=cv2.INTER_CUBIC)
        for image, matrix in ((after, to_after), (before, to_before))
    ]
    matcher = cv2.StereoSGBM.create(
        minDisparity=-_FARTHEST_PX,
        numDisparities=2 * _FARTHEST_PX,
        blockSize=_BLOCK_PX,
        P1=_SMOOTH[0],
        P2=_SMOOTH[1],
        disp12MaxDiff=1,
        uniquenessRatio=10,
        mode=cv2.STEREO_SGBM_MODE_HH,
    )
    disparity = matcher.compute(*rectified).astype(np.float32) / np.float32(_SIXTEENTHS)
    disparity[disparity < -_FARTHEST_PX] = np.nan
    own, other = (
        cv2.warpPerspective(image, matrix, (cols, rows), flags=cv2.INTER_CUBIC)
        for image, matrix in ((pair.followup, to_after), (pair.warped, to_before))
    )
    found = _difference(own, _seen(other, -disparity, np.zeros_like(disparity)))
    back = cv2.WARP_INVERSE_MAP | cv2.INTER_LINEAR
    return np.asarray(cv2.warpPerspective(found, to_after, (cols, rows), flags=back), np.float64)


def _seen(image: AnyArray, right_px: AnyArray, down_px: AnyArray) -> FloatArray:
    """The image at places so far from each pixel; NaN where there is none."""
    y, x = np.indices(image.shape).astype(np.float32)
    return np.asarray(
        cv2.remap(
            image.astype(np.float32),
            x + right_px.astype(np.float32),
            y + down_px.astype(np.float32),
            cv2.INTER_CUBIC,
            borderValue=(np.nan,) * 4,
        ),
        dtype=np.float64,
    )


def _difference(followup: AnyArray, seen: FloatArray) -> FloatArray:
    """Absolute difference smoothed by 1 px; none where nothing is seen."""
    apart = np.nan_to_num(np.asarray(followup, dtype=np.float64) - seen)
    return np.abs(gaussian_filter(apart, SMOOTHING_PX))


_OPENCV = "opencv-contrib-python-headless"
PROGRAMS = (
    program(
        "difference-flow",
        f"absolute difference behind OpenCV's DIS flow from the {WARP}",
        flow_difference,
        _OPENCV,
        has_threshold=True,
    ),
    program(
        "difference-stereo",
        "absolute difference behind OpenCV's SGBM of the pair, rectified by SIFT's matches, from "
        f"the {WARP}",
        stereo_difference,
        _OPENCV,
        has_threshold=True,
    ),
)
