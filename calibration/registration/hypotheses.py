"""Poses that matched features or an operator's hints speak for, the most promising first."""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.errors import RegistrationError
from calibration.registration.feature_matches import FeatureMatches
from calibration.registration.features import ImageFeatures, homography_pose
from calibration.registration.hints import RegistrationHints
from simulation.arrays import FloatArray
from simulation.compiled import compiled
from simulation.pose import projection_depth, projection_slopes

_RATIO = 0.8
_LOOSE_RATIO = 0.92
_LOOSE_MATCHES = 700
_INLIERS_MIN = 6
_ROUNDS = 3
_VOTES = 4
_VOTES_MIN = 3
_VOTE_REACH = 0.04
"""Of the longer side: how far two matches of one pose may lie from a common similarity."""

_VOTE_TURN = 0.35
_VOTE_ZOOM = 0.35
"""Differences of direction in radians and of log scale between matches of one pose."""

_ZOOM_TOLERANCE = 0.3
"""Tolerated log ratio of a hypothesis's zoom to the expected one; tilted ones are refined later."""

_SCALE_TOLERANCE = 0.7
_ZOOM_RANGE = (1 / 8, 8.0)
_ANISOTROPY_MAX = 8.0
"""Ratio of the largest to the smallest local zoom: one by 75 degrees against one by 60 across."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PoseHypothesis:
    """A homography from the follow-up to the reference and the matches that speak for it.

    ``is_given`` by the operator; ``is_expected`` where the expected zoom about the middle of both
    frames puts it: of several periods of a scene, that one. ``is_tilted`` where it is of a view
    from aside: of many, so that more is asked of it. ``is_second_look`` where its matches were
    looked for at a pose, which they therefore do not speak for alone.
    """

    matrix: FloatArray
    matches: FeatureMatches | None = field(default=None, repr=False)
    is_given: bool = False
    is_expected: bool = False
    is_tilted: bool = False
    is_second_look: bool = False

    @property
    def match_count(self) -> int:
        """Number of matches that speak for it."""
        return 0 if self.matches is None else len(self.matches.followup_px)


def given_poses(hints: RegistrationHints) -> Iterator[PoseHypothesis]:
    """Hypotheses that an operator has given: points first, as they are more precise."""
    points = hints.points
    if points is not None:
        matrix = points_homography(points)
        if matrix is not None:
            yield PoseHypothesis(matrix=matrix, matches=points, is_given=True)
    if hints.matrix is not None:
        yield PoseHypothesis(matrix=hints.matrix, is_given=True)


def points_homography(points: FeatureMatches) -> FloatArray | None:
    """Homography, shape (3, 3), that all pairs of points determine; None where they do not."""
    found, _ = cv2.findHomography(points.followup_px, points.reference_px, 0)
    return np.asarray(found, dtype=np.float64) if np.shape(found) == (3, 3) else None


def feature_poses(
    near: ImageFeatures, far: ImageFeatures, zoom: float | None
) -> Iterator[PoseHypothesis]:
    """Hypotheses of matched features, near the expected zoom if there is one.

    Parameters
    ----------
    near, far
        Features of the reference and of the follow-up.
    zoom
        Expected ratio of distances, follow-up over reference.
    """
    if zoom is not None:
        for one in _consistent(near, far, _centred_mask(near, far, zoom), zoom):
            yield replace(one, is_expected=True)
    scales = None
    if zoom is not None:
        ratio = np.log(near.frames[:, 0] / zoom) - np.log(far.frames[:, :1])
        scales = (np.abs(ratio) < _SCALE_TOLERANCE).astype(np.uint8)
    yield from _consistent(near, far, scales, zoom)
    yield from _voted(near, far, scales, zoom)


def _centred_mask(near: ImageFeatures, far: ImageFeatures, zoom: float) -> NDArray[np.uint8]:
    """Pairs of features that lie together where both frames have the same centre."""
    middles = [(np.array(one.shape[1::-1]) - 1) / 2 for one in (near, far)]
    expected = (far.points_px - middles[1]) * zoom + middles[0]
    return within(expected, near.points_px, 2 * _VOTE_REACH * max(near.shape))


@compiled(nogil=True)
def within(left: FloatArray, right: FloatArray, reach_px: float) -> NDArray[np.uint8]:
    """Whether points ``(x, y)`` lie nearer to each other than that: 1 of every pair that does."""
    found = np.empty((len(left), len(right)), np.uint8)
    for i in range(len(left)):
        for j in range(len(right)):
            dx, dy = left[i, 0] - right[j, 0], left[i, 1] - right[j, 1]
            found[i, j] = dx * dx + dy * dy < reach_px * reach_px
    return found


def _consistent(
    near: ImageFeatures, far: ImageFeatures, mask: NDArray[np.uint8] | None, zoom: float | None
) -> Iterator[PoseHypothesis]:
    """Homographies on which many matches agree, each without those of the ones before it."""
    pairs = near.pairs_with(far, _RATIO, mask)
    for _ in range(_ROUNDS):
        if len(pairs) < _INLIERS_MIN:
            return
        matches = FeatureMatches(far.points_px[pairs[:, 0]], near.points_px[pairs[:, 1]])
        try:
            matrix, inlier = homography_pose(matches, _INLIERS_MIN)
        except RegistrationError:
            return
        agreeing = FeatureMatches(matches.followup_px[inlier], matches.reference_px[inlier])
        if is_plausible(matrix, far.shape, zoom):
            yield PoseHypothesis(matrix=matrix, matches=agreeing)
        pairs = pairs[~inlier]


def _voted(
    near: ImageFeatures, far: ImageFeatures, mask: NDArray[np.uint8] | None, zoom: float | None
) -> Iterator[PoseHypothesis]:
    """Similarities for which most matches vote: each match alone gives one.

    References
    ----------
    D. Lowe, "Distinctive image features from scale-invariant keypoints", 2004, section 7.3.
    """
    pairs = near.pairs_with(far, _LOOSE_RATIO, mask)[:_LOOSE_MATCHES]
    if len(pairs) < _VOTES_MIN:
        return
    own, other = near.points_px[pairs[:, 1]], far.points_px[pairs[:, 0]]
    log_zoom = np.log(near.frames[pairs[:, 1], 0] / far.frames[pairs[:, 0], 0])
    turn = near.frames[pairs[:, 1], 1] - far.frames[pairs[:, 0], 1]
    # Points as complex numbers: a similarity is a product and a sum.
    factor = np.exp(log_zoom + 1j * turn)
    to, at = own @ (1, 1j), other @ (1, 1j)
    aside = to - factor * at
    away = np.abs(factor[:, None] * at + aside[:, None] - to)
    turned = np.angle(np.exp(1j * (turn[:, None] - turn)))
    agrees = (
        (away < _VOTE_REACH * max(near.shape))
        & (np.abs(turned) < _VOTE_TURN)
        & (np.abs(log_zoom[:, None] - log_zoom) < _VOTE_ZOOM)
    )
    for _ in range(_VOTES):
        votes = agrees.sum(axis=1)
        best = int(np.argmax(votes))
        if votes[best] < _VOTES_MIN:
            return
        chosen = agrees[best].copy()
        agrees[:, chosen] = False
        matrix = _similarity(at[chosen], to[chosen])
        if matrix is not None and is_plausible(matrix, far.shape, zoom):
            yield PoseHypothesis(matrix=matrix, matches=FeatureMatches(other[chosen], own[chosen]))


def _similarity(at: FloatArray, to: FloatArray) -> FloatArray | None:
    """Least-squares similarity between points given as complex numbers."""
    about, centre = at - at.mean(), to.mean()
    square = float(np.sum(np.abs(about) ** 2))
    if square <= 0:
        return None
    factor = np.sum(np.conj(about) * (to - centre)) / square
    aside = centre - factor * at.mean()
    return np.array(
        [
            [factor.real, -factor.imag, aside.real],
            [factor.imag, factor.real, aside.imag],
            [0.0, 0.0, 1.0],
        ]
    )


def is_plausible(matrix: FloatArray, shape: tuple[int, ...], zoom: float | None) -> bool:
    """Whether a camera before the scene can have the pose, near the expected zoom if given."""
    rows, cols = shape
    x, y = (
        np.array([0.0, cols - 1.0, 0.0, cols - 1.0]),
        np.array([0.0, 0.0, rows - 1.0, rows - 1.0]),
    )
    middle = (cols - 1) / 2, (rows - 1) / 2
    # A corner beyond the horizon may be; the middle must be seen.
    if projection_depth(matrix, *middle) <= 0 or np.all(projection_depth(matrix, x, y) <= 0):
        return False
    slopes = np.array(projection_slopes(matrix, *middle)).reshape(2, 2)
    largest, smallest = np.linalg.svd(slopes, compute_uv=False)
    if not np.isfinite(largest) or np.linalg.det(slopes) <= 0:
        return False
    found = float(np.sqrt(largest * smallest))
    if zoom is not None and abs(np.log(found / zoom)) > _ZOOM_TOLERANCE:
        return False
    return bool(largest < _ANISOTROPY_MAX * smallest and _ZOOM_RANGE[0] < found < _ZOOM_RANGE[1])
