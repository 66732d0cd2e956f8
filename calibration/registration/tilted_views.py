"""Poses between photographs from very different directions.

Features are recognised up to a tilt of some 60 degrees. Beyond, one of the two photographs is
foreshortened on purpose in every direction, as it would look from aside, and the features of each
such view are matched with the other photograph's.

References
----------
J.-M. Morel and G. Yu, "ASIFT: a new framework for fully affine invariant image comparison", 2009,
for the tilts, the turns and the blur before the sampling.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import cos, pi, sin, sqrt

import cv2
import numpy as np

from calibration.registration.dense import AlignedPhotograph
from calibration.registration.feature_matches import FeatureMatches
from calibration.registration.features import ImageFeatures, features_of
from calibration.registration.hypotheses import PoseHypothesis, feature_poses, is_plausible
from simulation.arrays import FloatArray
from simulation.pose import project

_VIEWS = ((2.8, 7), (5.6, 14))
"""Foreshortening and the number of directions over half a turn: 72 degrees over the former."""

_BLUR_PX = 0.8
_WORKED_ON_PX = 0.3e6
"""Pixels above which a photograph is reduced first."""

_BORDER_PX = 5
_ASKED = 6
"""Hypotheses of the views of one photograph that are handed on."""


@dataclass(frozen=True, slots=True, eq=False)
class _TiltedView:
    """Features of a photograph seen from aside; ``matrix`` takes the view to the photograph."""

    features: ImageFeatures
    matrix: FloatArray


def tilted_poses(
    photographs: tuple[AlignedPhotograph, AlignedPhotograph],
    features: tuple[ImageFeatures, ImageFeatures],
    zoom: float | None,
) -> Iterator[PoseHypothesis]:
    """Hypotheses of matched features of views from aside, those of most matches first.

    Parameters
    ----------
    photographs, features
        The reference and the follow-up, and their features as they are.
    zoom
        Expected ratio of distances, follow-up over reference; None for any.
    """
    (reference, followup), (near, far) = photographs, features
    seen = [
        _of_reference(one, view.matrix)
        for view in _views(reference)
        for one in feature_poses(view.features, far, None)
    ]
    yield from _most_promising(seen, followup.shape, zoom)
    seen = [
        _of_followup(one, view.matrix)
        for view in _views(followup)
        for one in feature_poses(near, view.features, None)
    ]
    yield from _most_promising(seen, followup.shape, zoom)


def _most_promising(
    found: list[PoseHypothesis], shape: tuple[int, int], zoom: float | None
) -> list[PoseHypothesis]:
    possible = [one for one in found if is_plausible(one.matrix, shape, zoom)]
    return sorted(possible, key=lambda one: -one.match_count)[:_ASKED]


def _of_reference(found: PoseHypothesis, view: FloatArray) -> PoseHypothesis:
    """A hypothesis whose reference is a view, as one of the photograph."""
    matches = found.matches
    if matches is not None:
        matches = FeatureMatches(matches.followup_px, _moved(view, matches.reference_px))
    return PoseHypothesis(matrix=view @ found.matrix, matches=matches, is_tilted=True)


def _of_followup(found: PoseHypothesis, view: FloatArray) -> PoseHypothesis:
    """A hypothesis whose follow-up is a view, as one of the photograph."""
    matches = found.matches
    if matches is not None:
        matches = FeatureMatches(_moved(view, matches.followup_px), matches.reference_px)
    matrix = np.asarray(found.matrix @ np.linalg.inv(view))
    return PoseHypothesis(matrix=matrix, matches=matches, is_tilted=True)


def _moved(matrix: FloatArray, points_px: FloatArray) -> FloatArray:
    return np.column_stack(project(matrix, *points_px.T))


def _views(photograph: AlignedPhotograph) -> Iterator[_TiltedView]:
    rows, cols = photograph.shape
    factor = max(round(sqrt(rows * cols / _WORKED_ON_PX)), 1)
    small = photograph.reduced(factor)
    whole = np.array([[factor, 0, (factor - 1) / 2], [0, factor, (factor - 1) / 2], [0, 0, 1.0]])
    for tilt, turns in _VIEWS:
        for number in range(turns):
            view = _seen_aside(small, tilt, number * pi / turns)
            yield _TiltedView(view.features, whole @ view.matrix)


def _seen_aside(photograph: AlignedPhotograph, tilt: float, turn: float) -> _TiltedView:
    """The photograph turned, and foreshortened along x."""
    rows, cols = photograph.shape
    turned = np.array([[cos(turn), -sin(turn)], [sin(turn), cos(turn)]])
    corners = turned @ np.array([[0, cols - 1, 0, cols - 1], [0, 0, rows - 1, rows - 1]])
    low, high = corners.min(axis=1), corners.max(axis=1)
    width, height = (int(along) + 1 for along in high - low)
    to_turned = np.column_stack([turned, -low])
    levels = cv2.warpAffine(
        photograph.levels, to_turned, (width, height), borderMode=cv2.BORDER_REPLICATE
    )
    levels = cv2.GaussianBlur(levels, (0, 0), _BLUR_PX * sqrt(tilt**2 - 1), sigmaY=1e-3)
    usable = np.ones((rows, cols), np.uint8)
    if photograph.usable is not None:
        usable = photograph.usable.astype(np.uint8)
    usable = np.asarray(cv2.warpAffine(usable, to_turned, (width, height)), dtype=np.uint8)
    size, shrink = (max(int(width / tilt), 1), height), np.diag([1 / tilt, 1.0, 1.0])
    levels = cv2.warpAffine(levels, shrink[:2], size, borderMode=cv2.BORDER_REPLICATE)
    usable = np.asarray(
        cv2.warpAffine(usable, shrink[:2], size, flags=cv2.INTER_NEAREST), dtype=np.uint8
    )
    square = np.ones((2 * _BORDER_PX + 1,) * 2, dtype=np.uint8)
    usable = np.asarray(cv2.erode(usable, square, borderType=cv2.BORDER_CONSTANT, borderValue=0))
    to_view = shrink @ np.vstack([to_turned, [0, 0, 1.0]])
    return _TiltedView(
        features_of(np.asarray(levels, dtype=np.float32), usable.astype(np.bool_)),
        np.asarray(np.linalg.inv(to_view)),
    )
