"""Parallax of a scene with depth, between two photographs that a plane aligns."""

from dataclasses import dataclass, field, replace
from math import ceil, floor, sqrt

import cv2
import numpy as np

from calibration.parallax._correction import correction_of_pixels
from calibration.parallax._epipolar import EpipolarGeometry, find_geometry
from calibration.parallax._matching import (
    HELD_OUT_PERIOD_PX,
    AlignedViews,
    MatchedViews,
    match_views,
)
from calibration.parallax._occlusion import (
    filled_holes,
    filled_surface,
    guarded,
    hidden_in_other,
    is_elsewhere,
    known_surface,
    matched_both_ways,
    place_error,
)
from calibration.parallax._refinement import (
    SMOOTHING_PX,
    in_own_light,
    refined_parallax,
    seen_at,
    shifted_along,
    spline_of,
)
from calibration.registration import DistortedPose, PixelParallax
from calibration.robust import robust_sigma
from simulation.arrays import AnyArray, BoolArray, Float32Array, FloatArray
from simulation.by_value import ByValue

_MATCHED_ON_PX = 7e5
"""Pixels above which matching is done on an image that is reduced first."""

_BEYOND_SHARE, _BEYOND_PX = 0.25, 3
"""Parallax that is looked for beyond that of the features, which are not at every extreme."""

_MOST_PX = 160
_EXTREMES = (0.5, 99.5)
_ALIKE, _ALIKE_PX = 3, 1.5
"""A surface has several features, and a wrong match is alone: an extreme counts if so many are
within so much of it."""
_LEAST_GAIN, _SURE_SD = 0.05, 2.5
"""Share of what differs in held-out blocks that parallax must explain, and its standard errors."""

_COARSER, _LEAST_COARSE_PX = 2, 1e5
"""First tried at half the resolution; a small frame then has few blocks, and takes little time."""

_WORSE_SD = 1.0
"""What explains less there than the plane, by so many standard errors, is not looked at again."""

_TRIMMED_SD = 6.0
_BORDER_PX = 5.0
"""From the border of what a photograph shows: there a surface is known from one side alone, and
errs by .5 px where .1 is usual."""

_FEW_ROUNDS = 2


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Parallax(ByValue):
    """Parallax of a scene with depth.

    Parameters
    ----------
    pose
        Position of every follow-up pixel in the reference.
    parallax_px, parallax_err_px
        Displacement beside the plane towards the epipole, of each pixel of the photograph that
        ``pose.parallax`` names, and its standard error; both NaN where it is not known, shape
        ``(rows, cols)``.
    epipole_px
        The other camera's centre in that photograph, homogeneous ``(x, y, w)``.
    matches, agreeing
        Matched features, and those within a pixel of their epipolar lines.
    held_out_gain
        Share of what the plane leaves unexplained in blocks that were not looked at, which parallax
        explains.
    """

    pose: DistortedPose
    parallax_px: Float32Array = field(repr=False)
    parallax_err_px: Float32Array = field(repr=False)
    epipole_px: tuple[float, float, float]
    matches: int
    agreeing: int
    held_out_gain: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Surface:
    """Parallax of one view's pixels, its error, where it is known, and that of a surface."""

    parallax_px: Float32Array
    error_px: Float32Array
    is_known: BoolArray
    is_sure: BoolArray


def find_parallax(reference: AnyArray, followup: AnyArray, pose: DistortedPose) -> Parallax | None:
    """Parallax of the coarser photograph's pixels; None where the photographs tell of none.

    ``reference, followup``: grey, shape ``(rows, cols)``. ``pose``: of a plane that explains most
    of the scene, or some.
    """
    if pose.zoom >= 1:
        return _parallax_of(followup, reference, pose)
    found = _parallax_of(reference, followup, pose.inverse())
    return None if found is None else replace(found, pose=found.pose.inverse())


def _parallax_of(target: AnyArray, source: AnyArray, pose: DistortedPose) -> Parallax | None:
    """Parallax of the target's pixels, in the source."""
    geometry = find_geometry(source, target, pose)
    if geometry is None:
        return None
    source, target = (np.asarray(image, dtype=np.float32) for image in (source, target))
    views = _aligned(target, source, geometry)
    least, most = _extremes(geometry.parallax_px[geometry.near])
    factor = max(ceil(sqrt(target.size / _MATCHED_ON_PX)), 1)
    small = views.reduced(factor)
    room = _BEYOND_SHARE * (most - least) + _BEYOND_PX
    low, high = (
        max(int(np.floor((min(least, 0.0) - room) / factor)), -_MOST_PX),
        min(int(np.ceil((max(most, 0.0) + room) / factor)), _MOST_PX),
    )
    lit = _in_own_light(views)
    if not _gains_coarsely(views, lit, (low, high), factor):
        return None
    matched = match_views(small, low, high)
    gain, sure_sd = _held_out_gain(lit, matched, factor)
    if not (gain >= _LEAST_GAIN and sure_sd >= _SURE_SD):
        return None
    rough, agrees = _rough(views, small, matched, factor)
    parallax, _, _ = refined_parallax(lit, rough, agrees, _FEW_ROUNDS)
    better = correction_of_pixels(lit, parallax, agrees, geometry.epipole)
    if better is not None:
        geometry = geometry.corrected(better)
        lit = _in_own_light(_aligned(target, source, geometry))
    own, other = _surfaces(lit, small, matched, factor)
    is_seen, is_seen_back = _seen_in(own, other, lit), _seen_in(other, own, _reversed(lit))
    depth = PixelParallax(
        displaced_px=np.stack([own.parallax_px * lit.to_y, own.parallax_px * lit.to_x]),
        restored_px=np.stack([-other.parallax_px * lit.to_y, -other.parallax_px * lit.to_x]),
        is_seen=guarded(is_seen, own.parallax_px),
        is_seen_back=guarded(is_seen_back, other.parallax_px),
        error_px=place_error(own.parallax_px, own.error_px, _apart(own, other, lit)),
        photograph="followup",
    )
    unknown = np.float32(np.nan)
    x, y, w = geometry.epipole.tolist()
    return Parallax(
        pose=replace(geometry.pose, parallax=depth),
        parallax_px=np.where(is_seen, own.parallax_px, unknown),
        parallax_err_px=np.where(is_seen & np.isfinite(own.error_px), own.error_px, unknown),
        epipole_px=(x, y, w),
        matches=len(geometry.near),
        agreeing=int(np.count_nonzero(geometry.near)),
        held_out_gain=gain,
    )


def _extremes(parallax_px: FloatArray) -> tuple[float, float]:
    """Least and largest parallax of features."""
    every = np.sort(parallax_px)
    first = np.searchsorted(every, every - _ALIKE_PX, "left")
    last = np.searchsorted(every, every + _ALIKE_PX, "right")
    kept = every[last - first >= _ALIKE]
    least, most = np.percentile(kept if kept.size else every, _EXTREMES).tolist()
    return least, most


def _aligned(
    target: Float32Array, source: Float32Array, geometry: EpipolarGeometry
) -> AlignedViews:
    """Bring the source to the target's pixels by the plane, at the target's sampling."""
    pose = geometry.pose
    softer_px = 0.5 * sqrt(max(pose.zoom**2 - 1, 0.0))
    if softer_px > 0.1:
        source = np.asarray(cv2.GaussianBlur(source, (0, 0), softer_px), dtype=np.float32)
    to_y, to_x = (at.astype(np.float32) for at in pose.followup_places_px())
    seen = seen_at(spline_of(source), to_y, to_x)
    is_source = np.isfinite(seen)
    is_target = np.isfinite(target)
    rows, cols = target.shape
    y, x = np.meshgrid(np.arange(float(rows)), np.arange(float(cols)), indexing="ij")
    along_x, along_y = geometry.directions(x, y)
    return AlignedViews(
        target=np.where(is_target, target, np.float32(0)),
        source=np.where(is_source, seen, np.float32(np.mean(seen[is_source]))).astype(np.float32),
        is_target=is_target,
        is_source=is_source,
        to_x=along_x.astype(np.float32),
        to_y=along_y.astype(np.float32),
    )


def _in_own_light(views: AlignedViews) -> AlignedViews:
    return replace(
        views,
        target=in_own_light(views.target, views.is_target),
        source=in_own_light(views.source, views.is_source),
    )


def _reversed(views: AlignedViews) -> AlignedViews:
    """The same from the source, from which the target lies the other way."""
    return replace(
        views,
        target=views.source,
        source=views.target,
        is_target=views.is_source,
        is_source=views.is_target,
        to_x=-views.to_x,
        to_y=-views.to_y,
    )


def _surfaces(
    views: AlignedViews, small: AlignedViews, matched: MatchedViews, factor: int
) -> tuple[_Surface, _Surface]:
    """Surfaces of the target's pixels and of the source's."""
    back, small_back = _reversed(views), _reversed(small)
    turned = replace(matched, target=matched.source, source=matched.target)
    found = []
    for whole, reduced, both in ((views, small, matched), (back, small_back, turned)):
        rough, agrees = _rough(whole, reduced, both, factor)
        parallax, error, unlike = refined_parallax(whole, rough, agrees, coarse_px=factor)
        known = known_surface(parallax, agrees, unlike)
        parallax, is_hole = filled_holes(parallax, known, whole.is_target & whole.is_source)
        known |= is_hole
        filled, is_sure = filled_surface(parallax, known, agrees, whole.to_x, whole.to_y)
        is_sure &= ~_is_elsewhere(whole, filled, is_sure & (is_hole | ~known), both, factor)
        found.append(
            _Surface(
                parallax_px=filled,
                error_px=error,
                is_known=known,
                is_sure=is_sure & whole.is_target,
            )
        )
    return found[0], found[1]


def _is_elsewhere(
    views: AlignedViews,
    parallax_px: Float32Array,
    doubtful: BoolArray,
    matched: MatchedViews,
    factor: int,
) -> BoolArray:
    """Doubtful pixels that something else on their line explains, on the image of the matching."""
    reduced = views.reduced(factor)
    rows, cols = reduced.target.shape
    part = np.s_[: rows * factor : factor, : cols * factor : factor]
    found = is_elsewhere(
        reduced, parallax_px[part] / np.float32(factor), doubtful[part], matched.range_px
    )
    return _enlarged(found.astype(np.float32), factor, doubtful.shape) > 0.5


def _seen_in(own: _Surface, other: _Surface, views: AlignedViews) -> BoolArray:
    """Pixels of a surface that nothing hides in the other view, away from both borders."""
    hidden = hidden_in_other(own.parallax_px, other.parallax_px, other.is_known, views)
    inner = _within(views.is_source).astype(np.float32)
    is_inner = shifted_along(inner, views, own.parallax_px, cv2.INTER_NEAREST) > 0
    # What was matched there and back is there.
    return own.is_sure & (own.is_known | ~hidden) & is_inner & _within(views.is_target)


def _apart(own: _Surface, other: _Surface, views: AlignedViews) -> Float32Array:
    """How far the other view's surface is from this one's, which it should be: both err."""
    there = shifted_along(other.parallax_px, views, own.parallax_px, cv2.INTER_LINEAR)
    return np.asarray(np.nan_to_num(np.abs(there - own.parallax_px)), dtype=np.float32)


def _within(shown: BoolArray) -> BoolArray:
    """Pixels that have neighbours on all sides by which their surface is known."""
    padded = np.pad(shown, 1).astype(np.uint8)
    apart = cv2.distanceTransform(padded, cv2.DIST_L2, cv2.DIST_MASK_5)[1:-1, 1:-1]
    return np.asarray(apart > _BORDER_PX)


def _rough(
    views: AlignedViews, small: AlignedViews, matched: MatchedViews, factor: int
) -> tuple[Float32Array, BoolArray]:
    """The target's parallax to a pixel or so, and where it is matched both ways."""
    shape = views.target.shape
    is_matched = matched_both_ways(matched.target, matched.source, small)
    agrees = _enlarged(is_matched.astype(np.float32), factor, shape) > 0.5
    rough = _enlarged(matched.target, factor, shape) * factor
    is_source = views.is_source.astype(np.float32)
    agrees &= shifted_along(is_source, views, rough, cv2.INTER_NEAREST) > 0
    return rough, agrees & views.is_target


def _enlarged(image: Float32Array, factor: int, shape: tuple[int, ...]) -> Float32Array:
    """Pixels so many times as small, up to the border."""
    if factor == 1:
        return image
    large = np.repeat(np.repeat(image, factor, axis=0), factor, axis=1)
    rows, cols = (n - m for n, m in zip(shape, large.shape, strict=True))
    return np.asarray(np.pad(large, ((0, rows), (0, cols)), mode="edge"), dtype=np.float32)


def _gains_coarsely(
    views: AlignedViews, lit: AlignedViews, range_px: tuple[int, int], factor: int
) -> bool:
    """Whether parallax may explain anything: at half the resolution, looking costs an eighth."""
    coarse = _COARSER * factor
    low, high = floor(range_px[0] / _COARSER), ceil(range_px[1] / _COARSER)
    small = views.reduced(coarse)
    if small.target.size < _LEAST_COARSE_PX:
        return True
    _, sure_sd = _held_out_gain(lit, match_views(small, low, high), coarse)
    return sure_sd > -_WORSE_SD


def _held_out_gain(views: AlignedViews, matched: MatchedViews, factor: int) -> tuple[float, float]:
    """Share by which parallax explains more of held-out blocks than the plane, in errors too."""
    shape = views.target.shape
    parallax = _enlarged(matched.held_out, factor, shape) * factor
    held_out = _enlarged(matched.is_held_out.astype(np.float32), factor, shape) > 0.5
    target, source = (
        np.asarray(cv2.GaussianBlur(one, (0, 0), SMOOTHING_PX), dtype=np.float32)
        for one in (views.target, views.source)
    )
    plane = np.abs(target - source)
    bent = np.abs(target - shifted_along(source, views, parallax, cv2.INTER_LINEAR))
    counts = held_out & views.is_target & views.is_source & np.isfinite(bent)
    if not counts.any():
        return 0.0, 0.0
    apart = (target - source)[counts]
    if not apart.any():
        return 0.0, 0.0
    # Where nothing is seen, nothing differs: that says nothing of the scatter.
    most = np.float32(_TRIMMED_SD * robust_sigma(apart[apart != 0]))
    block = HELD_OUT_PERIOD_PX // 2 * factor  # of those at any offset, each is alone
    rows, cols = (n // block for n in shape)

    def by_block(image: Float32Array) -> Float32Array:
        cut = np.where(counts, image, np.float32(0))[: rows * block, : cols * block]
        return np.asarray(cut.reshape(rows, block, cols, block).sum(axis=(1, 3)))

    before, after = (by_block(np.minimum(image, most)) for image in (plane, np.nan_to_num(bent)))
    total = float(before.sum())
    better = (before - after)[by_block(np.ones_like(plane)) > 0]
    if total <= 0 or len(better) < 2:
        return 0.0, 0.0
    # Where a plane is as good, a block is better or worse by chance.
    spread = float(np.sqrt(np.sum(np.square(better), dtype=np.float64)))
    return float(better.sum()) / total, float(better.sum()) / max(spread, 1e-30)
