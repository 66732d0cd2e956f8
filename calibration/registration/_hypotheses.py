"""Poses that features, an operator's hints or a search speak for, the most promising first.

Poses between photographs from very different directions. Features are recognised up to a tilt of
some 60 degrees. Beyond, one of the two photographs is foreshortened on purpose in every direction,
as it would look from aside, and the features of each such view are matched with the other
photograph's.

Poses found without features: every zoom and turn tried, every shift correlated. For scenes without
corners or blobs, or so noisy that none is found twice. Both photographs are reduced to thumbnails;
where they agree best over a large overlap is worth a refinement.

References
----------
J.-M. Morel and G. Yu, "ASIFT: a new framework for fully affine invariant image comparison", 2009,
for the tilts, the turns and the blur before the sampling.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from math import atan2, cos, pi, sin, sqrt

import cv2
import numpy as np
import scipy.fft
from numpy.typing import NDArray

from calibration.errors import RegistrationError
from calibration.registration._agreement import AlignedPhotograph, locally_normalised
from calibration.registration._distorted_pose import FeatureMatches
from calibration.registration._features import (
    ImageFeatures,
    NearestFeatures,
    RegistrationHints,
    features_of,
    homography_pose,
)
from simulation.arrays import Float32Array, FloatArray
from simulation.compiled import compiled
from simulation.pose import project, projection_depth, projection_slopes

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
    """Hypotheses of matched features, near the expected zoom, follow-up over reference, if any."""
    if zoom is not None:
        nearest = near.nearest_to(far, _centred_mask(near, far, zoom))
        for one in _consistent(near, far, nearest, zoom):
            yield replace(one, is_expected=True)
    scales = None
    if zoom is not None:
        ratio = np.log(near.frames[:, 0] / zoom) - np.log(far.frames[:, :1])
        scales = (np.abs(ratio) < _SCALE_TOLERANCE).astype(np.uint8)
    nearest = near.nearest_to(far, scales)
    yield from _consistent(near, far, nearest, zoom)
    yield from _voted(near, far, nearest, zoom)


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
    near: ImageFeatures, far: ImageFeatures, nearest: NearestFeatures, zoom: float | None
) -> Iterator[PoseHypothesis]:
    """Homographies on which many matches agree, each without those of the ones before it."""
    pairs = nearest.within(_RATIO)
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
    near: ImageFeatures, far: ImageFeatures, nearest: NearestFeatures, zoom: float | None
) -> Iterator[PoseHypothesis]:
    """Similarities for which most matches vote: each match alone gives one.

    References
    ----------
    D. Lowe, "Distinctive image features from scale-invariant keypoints", 2004, section 7.3.
    """
    pairs = nearest.within(_LOOSE_RATIO)[:_LOOSE_MATCHES]
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
    """Hypotheses of matched features of views from aside, those of most matches first."""
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


_LONG_SIDE_PX = 64
_WINDOW_PX = 15
_TURN_STEP_RAD = pi / 18
_ZOOM_STEP = 0.13
"""Of the log zoom: at the thumbnail's edge neither step moves a detail by more than its size."""

_SEARCHED_ZOOMS = (0.4, 2.8)
_OVERLAP_LEAST = 0.2
"""Of the smaller of the two views."""

_FOUND = 8


@dataclass(frozen=True, slots=True, eq=False)
class _Thumbnail:
    """Normalised levels and which count; ``factor`` photograph pixels to one."""

    levels: Float32Array
    counted: Float32Array
    factor: float

    def to_photograph(self) -> FloatArray:
        """Thumbnail pixel ``(x, y, 1)`` to photograph pixel."""
        aside = (self.factor - 1) / 2
        return np.array([[self.factor, 0, aside], [0, self.factor, aside], [0, 0, 1.0]])


def searched_poses(
    reference: AlignedPhotograph, followup: AlignedPhotograph, zoom: float | None
) -> Iterator[PoseHypothesis]:
    """Similarities for which thumbnails agree best, the best first; without zoom at 0.4 to 2.8."""
    low, high = _SEARCHED_ZOOMS if zoom is None else (zoom * 0.85, zoom * 1.18)
    zooms = np.exp(np.arange(np.log(low), np.log(high) + _ZOOM_STEP, _ZOOM_STEP))
    near = _thumbnail(reference, _LONG_SIDE_PX)
    found: list[tuple[float, FloatArray]] = []
    for one in zooms.tolist():
        # The follow-up's thumbnail has about the pixels that the reference shows of it.
        far = _thumbnail(followup, max(round(_LONG_SIDE_PX * min(one, 1.0)), 16))
        scale = one * far.factor / near.factor
        spectra = _Spectra(near, far, scale)
        turns = np.arange(0.0, 2 * pi, _TURN_STEP_RAD).tolist()
        found += [spectra.best_shift(turn) for turn in turns]
        found.sort(key=lambda pair: -pair[0])
        del found[4 * _FOUND :]
    kept: list[FloatArray] = []
    for _, matrix in found:
        if not any(_is_same(matrix, other) for other in kept):
            kept.append(matrix)
        if len(kept) == _FOUND:
            break
    for matrix in kept:
        yield PoseHypothesis(matrix=matrix)


def _thumbnail(photograph: AlignedPhotograph, long_side_px: int) -> _Thumbnail:
    rows, cols = photograph.shape
    factor = max(max(rows, cols) / long_side_px, 1.0)
    # Blurred before it is sampled.
    coarse = photograph.reduced(max(int(factor / 2), 1))
    rest = factor / max(int(factor / 2), 1)
    blurred = coarse.smoothed(0.5 * rest, 0.5 * rest)
    matrix = np.array([[rest, 0, (rest - 1) / 2], [0, rest, (rest - 1) / 2]])
    size = (int(coarse.shape[1] / rest), int(coarse.shape[0] / rest))
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    levels = np.asarray(cv2.warpAffine(blurred.levels, matrix, size, flags=flags), dtype=np.float32)
    counted = np.ones(levels.shape, dtype=np.bool_)
    if blurred.usable is not None:
        share = cv2.warpAffine(blurred.usable.astype(np.float32), matrix, size, flags=flags)
        counted = np.asarray(share > 0.9)
    return _Thumbnail(
        locally_normalised(levels, counted, _WINDOW_PX), counted.astype(np.float32), factor
    )


class _Spectra:
    """The reference's thumbnail and a follow-up's at a scale, to be correlated turn after turn."""

    def __init__(self, near: _Thumbnail, far: _Thumbnail, scale: float) -> None:
        self._near, self._far, self._scale = near, far, scale
        self._side = int(np.hypot(*far.levels.shape) * scale) + 2
        self._size = scipy.fft.next_fast_len(self._side + max(near.levels.shape), real=True)
        self._levels = self._spectrum(near.levels)
        self._squares = self._spectrum(np.square(near.levels))
        self._counted = self._spectrum(near.counted)

    def best_shift(self, turn: float) -> tuple[float, FloatArray]:
        """Evidence and matrix, follow-up to reference photograph, of the best shift."""
        far = self._far
        rows, cols = far.levels.shape
        middle, own = self._side / 2, np.array([(cols - 1) / 2, (rows - 1) / 2])
        linear = self._scale * np.array([[cos(turn), -sin(turn)], [sin(turn), cos(turn)]])
        matrix = np.column_stack([linear, middle - linear @ own])
        size = (self._side, self._side)
        levels = np.asarray(cv2.warpAffine(far.levels, matrix, size), dtype=np.float32)
        counted = np.asarray(cv2.warpAffine(far.counted, matrix, size) > 0.9, dtype=np.float32)
        levels *= counted
        mask = np.conj(self._spectrum(counted))
        number = self._inverse(mask * self._counted)
        product = self._inverse(np.conj(self._spectrum(levels)) * self._levels)
        ours = self._inverse(np.conj(self._spectrum(np.square(levels))) * self._counted)
        theirs = self._inverse(mask * self._squares)
        least = _OVERLAP_LEAST * min(float(counted.sum()), float(self._near.counted.sum()))
        square = np.where(
            (number > least) & (product > 0), product**2 / np.maximum(ours * theirs, 1e-6), 0.0
        )
        evidence = -0.5 * number * np.log(1 - np.minimum(square, 0.999))
        best = int(np.argmax(evidence))
        shift_y, shift_x = (
            at if at < self._size - self._side else at - self._size
            for at in np.unravel_index(best, evidence.shape)
        )
        whole = np.vstack([matrix, [0, 0, 1.0]])
        whole[:2, 2] += shift_x, shift_y
        back = np.asarray(np.linalg.inv(far.to_photograph()))
        return float(evidence.flat[best]), self._near.to_photograph() @ whole @ back

    def _spectrum(self, values: Float32Array) -> FloatArray:
        return np.asarray(scipy.fft.rfft2(values, s=(self._size, self._size)))

    def _inverse(self, series: FloatArray) -> Float32Array:
        return np.asarray(scipy.fft.irfft2(series, s=(self._size, self._size)))


def _is_same(one: FloatArray, other: FloatArray) -> bool:
    """Whether two similarities are neighbours among those tried."""
    ours, theirs = (complex(matrix[0, 0], matrix[1, 0]) for matrix in (one, other))
    ratio = ours / theirs
    turned = abs(atan2(ratio.imag, ratio.real))
    return turned < 1.5 * _TURN_STEP_RAD and abs(np.log(abs(ratio))) < 1.5 * _ZOOM_STEP
