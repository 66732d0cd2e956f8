"""Displacements beside a plane where there are few features: optical flow, there and back.

T. Kroeger, R. Timofte, D. Dai, L. Van Gool, "Fast optical flow using dense inverse search", ECCV
2016, as OpenCV has it. What lies on a plate of few details has no features, and still outlines.
"""

from math import sqrt

import cv2
import numpy as np

from calibration.parallax._views import AlignedViews
from calibration.registration import DistortedPose, FeatureMatches
from simulation.arrays import BoolArray, Float32Array

_MOST = 1500
_LEAST_APART_PX = 2
_TWO_WAY_PX = 1.0
"""Distance at which a displacement there and back ends."""

_BYTES_PER_CONTRAST = 42.0
"""Of levels in units of the contrast around: three of them to either side of the middle."""


def matches_of_flow(views: AlignedViews, factor: int, pose: DistortedPose) -> FeatureMatches:
    """Places of the target, on a grid, and of the source that lie there and back on one another.

    ``views``: in their own light, aligned by the plane of ``pose``, reduced by the factor.
    """
    shown = views.is_target & views.is_source
    target, source = (_bytes(one, shown) for one in (views.target, views.source))
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
    start = np.zeros((*target.shape, 2), dtype=np.float32)
    there, back = flow.calc(target, source, start.copy()), flow.calc(source, target, start)
    rows, cols = target.shape
    y, x = np.mgrid[0:rows, 0:cols].astype(np.float32)
    to_x, to_y = x + there[..., 0], y + there[..., 1]
    returned = there + cv2.remap(back, to_x, to_y, cv2.INTER_LINEAR, borderValue=(np.nan,) * 4)
    is_shown = cv2.remap(shown.astype(np.uint8), to_x, to_y, cv2.INTER_NEAREST) > 0
    agrees = shown & is_shown & (np.hypot(returned[..., 0], returned[..., 1]) < _TWO_WAY_PX)
    apart = max(int(sqrt(np.count_nonzero(agrees) / _MOST)), _LEAST_APART_PX)
    chosen = np.zeros_like(agrees)
    chosen[::apart, ::apart] = agrees[::apart, ::apart]
    own_y, own_x, other_y, other_x = (
        factor * (one[chosen].astype(np.float64) + 0.5) - 0.5 for one in (y, x, to_y, to_x)
    )
    at_y, at_x = pose.to_reference_px(other_y, other_x)
    return FeatureMatches(np.column_stack([own_x, own_y]), np.column_stack([at_x, at_y]))


def _bytes(levels: Float32Array, shown: BoolArray) -> cv2.typing.MatLike:
    known = np.where(shown, levels, np.float32(0))
    return np.clip(128 + _BYTES_PER_CONTRAST * known, 0, 255).astype(np.uint8)
