"""Epipolar geometry of two photographs beside the plane that aligns them.

In the plane's frame a point of a rigid scene is displaced along the line to the epipole, by its
height above the plane over its depth (R. Kumar, P. Anandan, K. Hanna, "Direct recovery of shape
from multiple views: a parallax based approach", ICPR 1994). The plane is chosen among those that
the geometry permits, so that this holds exactly (R. Hartley, A. Zisserman, "Multiple View Geometry
in Computer Vision", 2nd edition, result 13.6).
"""

from dataclasses import dataclass, replace
from typing import Self

import cv2
import numpy as np

from calibration.parallax._correction import Correction, correction_of_features
from calibration.parallax._flow import matches_of_flow
from calibration.parallax._views import AlignedViews, matching_factor
from calibration.registration import DistortedPose, FeatureMatches, ImageFeatures, features_of
from simulation.arrays import AnyArray, BoolArray, Float32Array, FloatArray
from simulation.pose import ideal_points, lens_of

_NEAR_PX = 1.0
"""Distance from its epipolar line within which a match agrees."""

_DISPLACED_PX = 1.5
"""Parallax from which a match tells of depth: planes align details to .3 to .9 px."""

_TELLS_MOST_PX = 6.0
_ENOUGH_DISPLACED = 60
"""Features off the plane that tell the geometry better than flow does, whose places err alike."""

_LEAST_MATCHES = 20
_LEAST_SHARE = 0.2
"""Of all matches, those that must agree with a geometry: by chance, 1 or 2 of 100 do."""

_RATIO = 0.8
_REACH = 0.08
"""How far from where the plane has it a feature is looked for, relative to the longer side."""

_GUIDED_PX, _GUIDED_REACH = 2.5, 0.16
"""How far from its line, once that is known, and along it: there it has fewer rivals."""

_LEAST_OFF_PLANE = 0.1
"""Of what is off the plane, the share that must agree: wrong matches do by chance, a few of 100."""

_CELLS = 8
_LEAST_CELLS = 0.15
"""Share of the cells with matches in which some are displaced: a thing that moved is in few."""

_LENS_GAIN = 0.7
"""Of the misfit without distortion, what is left with one that is taken."""

_TRIALS = 2000
_ROUNDS = 8
_LOCAL_ROUNDS = 4
_SEED = 12


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class EpipolarGeometry:
    """A plane's pose of a target in a source, and the epipole in the target's ideal pixels.

    ``pose``: of a plane that the geometry permits. ``epipole``: homogeneous, shape (3,), of length
    1. ``near``: matches that agree. ``parallax_px``: of each match, towards the epipole.
    ``misfit``: mean square distance of all matches from their lines, at most 1 px each.
    """

    pose: DistortedPose
    epipole: FloatArray
    near: BoolArray
    parallax_px: FloatArray
    misfit: float

    @property
    def displaced(self) -> int:
        """Number of matches that agree and are off the plane."""
        return int(np.count_nonzero(self.near & (np.abs(self.parallax_px) > _DISPLACED_PX)))

    def corrected(self, by: Correction) -> Self:
        """Return the geometry with a better plane and epipole."""
        pose = self.pose.with_(self.pose.matrix @ by.change, self.pose.k1)
        return replace(self, pose=pose, epipole=by.epipole)

    def aligned(self, target: Float32Array, source: Float32Array) -> AlignedViews:
        """Both on the target's pixels, by the plane, with their epipolar lines."""
        rows, cols = target.shape
        y, x = np.meshgrid(np.arange(float(rows)), np.arange(float(cols)), indexing="ij")
        return AlignedViews.of(target, source, self.pose).along(*self.directions(x, y))

    def directions(self, x_px: FloatArray, y_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Unit vectors ``(x, y)`` towards the epipole at seen pixels of the target; 0 at it."""
        points = np.column_stack([np.ravel(x_px), np.ravel(y_px)]).astype(np.float64)
        lens = _target_lens(self.pose)
        if lens[0] == 0:
            to_x, to_y = _towards(self.epipole, points)
        else:
            step = 0.5
            ideal = [
                ideal_points(lens, points + np.array(by))
                for by in ((step, 0), (-step, 0), (0, step), (0, -step))
            ]
            (a, c), (b, d) = (ideal[0] - ideal[1]).T, (ideal[2] - ideal[3]).T
            u, v = _towards(self.epipole, ideal_points(lens, points))
            to_x, to_y = d * u - b * v, a * v - c * u
            length = np.maximum(np.hypot(to_x, to_y), 1e-12)
            to_x, to_y = to_x / length, to_y / length
        return to_x.reshape(np.shape(x_px)), to_y.reshape(np.shape(x_px))


def _towards(epipole: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Unit vectors from points (n, 2) to an epipole whose last coordinate is not negative.

    Beyond infinity they go on as they were, away from it: a correction turns none of them round.
    """
    x = epipole[0] - epipole[2] * points[:, 0]
    y = epipole[1] - epipole[2] * points[:, 1]
    length = np.maximum(np.hypot(x, y), 1e-12)
    return x / length, y / length


def _target_lens(pose: DistortedPose) -> FloatArray:
    return lens_of(pose.k1, pose.reference_shape, pose.followup_shape)


def _source_lens(pose: DistortedPose) -> FloatArray:
    lens = _target_lens(pose)
    return np.array([lens[0], lens[3], lens[4], lens[1], lens[2]])


def _in_plane(pose: DistortedPose, matches: FeatureMatches) -> tuple[FloatArray, FloatArray]:
    """Matches in ideal pixels of the target, of which the source's were brought by the plane."""
    own = ideal_points(_target_lens(pose), matches.followup_px.astype(np.float64))
    other = ideal_points(_source_lens(pose), matches.reference_px.astype(np.float64))
    return own, _mapped(_inverse(pose.matrix), other)


def find_geometry(
    source: AnyArray, target: AnyArray, pose: DistortedPose
) -> EpipolarGeometry | None:
    """Epipolar geometry by features, and by optical flow; None where they do not tell of depth.

    ``source, target``: grey, shape ``(rows, cols)``. ``pose``: of the target in the source.
    """
    source, target = (np.asarray(image, dtype=np.float32) for image in (source, target))
    own, other = features_of(target), features_of(source)
    none = FeatureMatches(np.zeros((0, 2)), np.zeros((0, 2)))
    by_features = _guided(own, other, pose, none)
    if by_features is not None and by_features.displaced >= _ENOUGH_DISPLACED:
        return by_features
    plane = pose.with_(pose.matrix, pose.k1)
    factor = matching_factor(target.size)
    views = AlignedViews.of(target, source, plane).in_own_light().reduced(factor)
    return _guided(own, other, pose, matches_of_flow(views, factor, plane)) or by_features


def _guided(
    own: ImageFeatures, other: ImageFeatures, pose: DistortedPose, more: FeatureMatches
) -> EpipolarGeometry | None:
    """The geometry of features and more matches; along its lines features have fewer rivals."""
    expected = pose.nearest_homography()
    geometry = epipolar_geometry(_joined(_matches(own, other, expected), more), pose)
    if geometry is None:
        return None
    guided = epipolar_geometry(_joined(_matches(own, other, expected, geometry), more), pose)
    if guided is None or np.count_nonzero(guided.near) < np.count_nonzero(geometry.near):
        return geometry
    return guided


def _joined(one: FeatureMatches, more: FeatureMatches) -> FeatureMatches:
    return FeatureMatches(
        np.concatenate([one.followup_px, more.followup_px]),
        np.concatenate([one.reference_px, more.reference_px]),
    )


def _matches(
    own: ImageFeatures,
    other: ImageFeatures,
    expected: FloatArray,
    geometry: EpipolarGeometry | None = None,
) -> FeatureMatches:
    """Features that match near where a plane has them, and near their epipolar lines."""
    at = _mapped(expected, own.points_px)
    away = at[:, None].astype(np.float32) - other.points_px.astype(np.float32)
    reach = _REACH if geometry is None else _GUIDED_REACH
    near = np.hypot(away[..., 0], away[..., 1]) < reach * max(other.shape)
    if geometry is not None:
        here, _ = _in_plane(geometry.pose, FeatureMatches(own.points_px, own.points_px))
        _, there = _in_plane(geometry.pose, FeatureMatches(other.points_px, other.points_px))
        to_x, to_y = (one.astype(np.float32) for one in _towards(geometry.epipole, here))
        apart = there.astype(np.float32) - here[:, None].astype(np.float32)
        aside = apart[..., 0] * to_y[:, None] - apart[..., 1] * to_x[:, None]
        near &= np.abs(aside) < _GUIDED_PX
    pairs = other.pairs_with(own, _RATIO, near.astype(np.uint8))
    return FeatureMatches(own.points_px[pairs[:, 0]], other.points_px[pairs[:, 1]])


def _inverse(matrix: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.inv(matrix), dtype=np.float64)


def _mapped(matrix: FloatArray, points: FloatArray) -> FloatArray:
    found = np.column_stack([points, np.ones(len(points))]) @ matrix.T
    return np.asarray(found[:, :2] / found[:, 2:])


def epipolar_geometry(matches: FeatureMatches, pose: DistortedPose) -> EpipolarGeometry | None:
    """The geometry that matches agree with; None where they do not tell of depth.

    ``matches``: of the target, as the follow-up, with the source. ``pose``: of the target in the
    source, which a plane explains.
    """
    if len(matches.followup_px) < _LEAST_MATCHES:
        return None
    # Of a scene with depth, what was fitted as the lens's distortion may be parallax.
    plain = _beside_plane(pose.with_(pose.nearest_homography(), 0.0), matches)
    if pose.k1 == 0:
        return plain
    seen = _beside_plane(pose.with_(pose.matrix, pose.k1), matches)
    if plain is None or seen is None:
        return plain or seen
    return seen if seen.misfit < _LENS_GAIN * plain.misfit else plain


def _beside_plane(plane: DistortedPose, matches: FeatureMatches) -> EpipolarGeometry | None:
    """The geometry with one lens."""
    own, other = _in_plane(plane, matches)
    told = _told(own, other)
    found = None
    most = 0.0
    for fundamental in _hypotheses(own, other):
        better, near = _locally_best(fundamental, own, other)
        if told[near].sum() > most and near.mean() >= _LEAST_SHARE:
            found, most = better, told[near].sum()
    if found is None:
        return None
    near = _distances(found, own, other) < _NEAR_PX
    if np.count_nonzero(near) < _LEAST_MATCHES:
        return None
    matrix, epipole = _compatible_plane(found, own[near], other[near])
    for _ in range(_ROUNDS):
        parallax, aside = _beside_lines(matrix, epipole, own, other)
        asked = correction_of_features(own[near], parallax[near], aside[near], epipole)
        matrix, epipole = np.asarray(matrix @ asked.change), asked.epipole
        near = np.abs(_beside_lines(matrix, epipole, own, other)[1]) < _NEAR_PX
    parallax, aside = _beside_lines(matrix, epipole, own, other)
    if not _tells_of_depth(own, near, parallax):
        return None
    turned = plane.with_(plane.matrix @ matrix, plane.k1)
    return EpipolarGeometry(
        pose=turned,
        epipole=epipole,
        near=near,
        parallax_px=parallax,
        misfit=float(np.mean(np.minimum(np.abs(aside), _NEAR_PX) ** 2)),
    )


def _beside_lines(
    matrix: FloatArray, epipole: FloatArray, own: FloatArray, other: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """How far matches are displaced beside a plane along their lines, and to the right of these."""
    away = _mapped(_inverse(matrix), other) - own
    to_x, to_y = _towards(epipole, own)
    return away[:, 0] * to_x + away[:, 1] * to_y, away[:, 1] * to_x - away[:, 0] * to_y


def _told(own: FloatArray, other: FloatArray) -> FloatArray:
    """How much a match that agrees tells of a geometry, shape (n,).

    The farther it is off the plane, the less likely it agrees by chance, and the likelier it is a
    wrong match. What a plane explains says nothing.
    """
    away = np.hypot(*(other - own).T)
    return np.where(away > _DISPLACED_PX, np.log(np.clip(away, 1.0, _TELLS_MOST_PX)), 0.0)


def _hypotheses(own: FloatArray, other: FloatArray) -> list[FloatArray]:
    """Fundamental matrices: of eight matches, and of the plane with two that it does not explain.

    Where most of a scene is flat, eight matches seldom tell of more than the plane (O. Chum, T.
    Werner, J. Matas, "Two-view geometry estimation unaffected by a dominant plane", CVPR 2005).
    """
    found = []
    made = _fundamental(own, other, cv2.USAC_MAGSAC)
    if made is not None:
        found.append(made)
    told = _told(own, other)
    displaced = told > 0
    if np.count_nonzero(displaced) >= 2:
        found.append(_plane_and_two(own[displaced], other[displaced], told[displaced]))
    return found


def _fundamental(own: FloatArray, other: FloatArray, method: int) -> FloatArray | None:
    """What OpenCV finds, if anything.

    It returns None or several matrices where matches do not suffice, and raises an error of its own
    where a sample that it refines has no solution.
    """
    try:
        made: object = cv2.findFundamentalMat(own, other, method, _NEAR_PX, 0.9999, 5000)[0]
    except cv2.error:
        return None
    if not isinstance(made, np.ndarray) or made.shape != (3, 3):
        return None
    return np.asarray(made, dtype=np.float64)


def _plane_and_two(own: FloatArray, other: FloatArray, told: FloatArray) -> FloatArray:
    """The geometry of the plane and the epipole that displaced matches' lines tell most of."""
    rng = np.random.default_rng(_SEED)
    a, b = (np.column_stack([points, np.ones(len(points))]) for points in (own, other))
    lines = np.cross(a, b)
    lines /= np.maximum(np.hypot(lines[:, 0], lines[:, 1])[:, None], 1e-12)
    pairs = rng.integers(0, len(own), (_TRIALS, 2))
    epipoles = np.cross(lines[pairs[:, 0]], lines[pairs[:, 1]])
    length = np.linalg.norm(epipoles, axis=1, keepdims=True)
    epipoles = epipoles[length[:, 0] > 1e-9] / length[length[:, 0] > 1e-9]
    best, most = np.array([1.0, 0.0, 0.0]), -1.0
    for epipole in epipoles:
        to_x, to_y = _towards(epipole, a[:, :2])
        aside = (b - a)[:, 0] * to_y - (b - a)[:, 1] * to_x
        heard = float(told[np.abs(aside) < _NEAR_PX].sum())
        if heard > most:
            best, most = epipole, heard
    return _cross(best)


def _cross(vector: FloatArray) -> FloatArray:
    x, y, z = vector.tolist()
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def _distances(fundamental: FloatArray, own: FloatArray, other: FloatArray) -> FloatArray:
    """Distances of matches from their lines, as Sampson has them, (n,)."""
    a, b = (np.column_stack([points, np.ones(len(points))]) for points in (own, other))
    there, here = a @ fundamental.T, b @ fundamental
    product = np.sum(b * there, axis=1)
    slope = np.sqrt((there[:, :2] ** 2).sum(axis=1) + (here[:, :2] ** 2).sum(axis=1))
    # Of lines in one frame, the distance from one is sqrt(2) of Sampson's.
    return np.asarray(np.sqrt(2) * np.abs(product) / np.maximum(slope, 1e-300))


def _locally_best(
    fundamental: FloatArray, own: FloatArray, other: FloatArray
) -> tuple[FloatArray, BoolArray]:
    """Fit all that agree, and again with what agrees then, as long as it is more."""
    near = _distances(fundamental, own, other) < _NEAR_PX
    for _ in range(_LOCAL_ROUNDS):
        if np.count_nonzero(near) < 8:
            break
        refined = _fundamental(own[near], other[near], cv2.FM_8POINT)
        if refined is None:
            break
        again = _distances(refined, own, other) < _NEAR_PX
        if np.count_nonzero(again) <= np.count_nonzero(near):
            break
        fundamental, near = refined, again
    return fundamental, near


def _compatible_plane(
    fundamental: FloatArray, own: FloatArray, other: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Homography that the geometry permits, nearest to the plane of the matches, and the epipole.

    Least sum of absolute distances along the lines: what stands out of the plane does not bend it.
    """
    u, _, _ = np.linalg.svd(fundamental)
    there = u[:, 2]
    base = _cross(there) @ fundamental
    # The scale is that at which the third coordinate of what is mapped is about 1.
    a, b = (np.column_stack([points, np.ones(len(points))]) for points in (own, other))
    scale = np.median((a @ base.T)[:, :2] @ np.ones(2) / (b[:, :2] @ np.ones(2)))
    base = base / (scale if abs(scale) > 1e-12 else 1.0)
    weight: FloatArray = np.ones(len(own))
    size = np.maximum(np.abs(a).max(axis=0), 1.0)
    for _ in range(_ROUNDS):
        # base a + there (v a) is proportional to b: two equations for v.
        start = a @ base.T
        rows, levels = [], []
        for k in range(2):
            rows.append((there[k] - b[:, k] * there[2])[:, None] * (a / size))
            levels.append(b[:, k] * start[:, 2] - start[:, k])
        design = np.concatenate(rows) * np.tile(weight, 2)[:, None]
        right = np.concatenate(levels) * np.tile(weight, 2)
        plane = np.asarray(np.linalg.lstsq(design, right, rcond=None)[0], dtype=np.float64)
        matrix = np.asarray(base + np.outer(there, plane / size), dtype=np.float64)
        away = np.hypot(*(_mapped(matrix, own) - other).T)
        depth = np.abs((a @ matrix.T)[:, 2])
        weight = np.asarray(1 / (np.sqrt(np.maximum(away, 0.1)) * np.maximum(depth, 1e-6)))
    matrix = np.asarray(matrix / matrix[2, 2], dtype=np.float64)
    # In the plane's own frame both epipoles are this one.
    epipole = np.linalg.solve(matrix, there)
    epipole = epipole / np.linalg.norm(epipole)
    return matrix, np.asarray(epipole if epipole[2] >= 0 else -epipole, dtype=np.float64)


def _tells_of_depth(own: FloatArray, near: BoolArray, parallax: FloatArray) -> bool:
    """Whether displaced matches lie in many places of the frame."""
    low, high = own[near].min(axis=0), own[near].max(axis=0)
    cell = np.clip(((own - low) / np.maximum(high - low, 1e-9) * _CELLS).astype(int), 0, _CELLS - 1)
    number = cell[:, 1] * _CELLS + cell[:, 0]
    with_matches = np.unique(number[near])
    off_plane = np.abs(parallax) > _DISPLACED_PX
    displaced = near & off_plane
    if np.count_nonzero(displaced) < _LEAST_OFF_PLANE * np.count_nonzero(off_plane):
        return False
    return len(np.unique(number[displaced])) >= _LEAST_CELLS * len(with_matches)
