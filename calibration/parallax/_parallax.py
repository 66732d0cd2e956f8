"""Parallax of a scene with depth, between two photographs that a plane aligns."""

from dataclasses import dataclass, field, replace
from math import ceil, floor

import cv2
import numpy as np

from calibration.parallax._correction import correction_of_pixels
from calibration.parallax._decision import HeldOutGain, enlarged
from calibration.parallax._epipolar import find_geometry
from calibration.parallax._matching import MatchedViews, match_views
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
from calibration.parallax._refinement import refined_parallax
from calibration.parallax._views import AlignedViews, matching_factor, shifted_along
from calibration.registration import DistortedPose, PixelParallax
from simulation.arrays import AnyArray, BoolArray, Float32Array, FloatArray
from simulation.by_value import ByValue

_BEYOND_SHARE, _BEYOND_PX = 1.0, 3
"""Parallax that is looked for beyond that of the features, which are not at every extreme."""

_LEAST_COMMON_PX = 16
"""Pixels of the coarse look that are matched there and back at much the same parallax."""

_MOST_PX = 160
_EXTREMES = (0.5, 99.5)
_ALIKE, _ALIKE_PX = 3, 1.5
"""A surface has several features, and a wrong match is alone: an extreme counts if so many are
within so much of it."""
_COARSER, _LEAST_COARSE_PX = 2, 1e5
"""First tried at half the resolution; a small frame then has few blocks, and takes little time."""

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
        Matched features and places of the flow, and those within a pixel of their epipolar lines.
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
class Surface:
    """Parallax of one view's pixels, its error, where it is matched, known, and that of a surface.

    ``is_elsewhere``: what has no match here, and looks like another place on its line.
    """

    parallax_px: Float32Array
    error_px: Float32Array
    is_matched: BoolArray
    is_known: BoolArray
    is_sure: BoolArray
    is_elsewhere: BoolArray


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
    views = geometry.aligned(target, source)
    factor = matching_factor(target.size)
    small = views.reduced(factor)
    lit = views.in_own_light()
    range_px = _coarse_range(views, lit, _extremes(geometry.parallax_px[geometry.near]), factor)
    if range_px is None:
        return None
    matched = match_views(small, *range_px)
    held_out = HeldOutGain.of(lit, matched, factor)
    if not held_out.has_depth:
        return None
    matched = held_out.kept(matched, small)
    rough, agrees = _rough(views, small, matched, factor)
    parallax, _, _ = refined_parallax(lit, rough, agrees, _FEW_ROUNDS)
    better = correction_of_pixels(lit, parallax, agrees, geometry.epipole)
    if better is not None:
        geometry = geometry.corrected(better)
        lit = geometry.aligned(target, source).in_own_light()
    own, other = _surfaces(lit, small, matched, factor)
    is_seen, is_seen_back = seen_in_both(own, other, lit), seen_in_both(other, own, lit.reversed())
    depth = PixelParallax(
        displaced_px=np.stack([own.parallax_px * lit.to_y, own.parallax_px * lit.to_x]),
        restored_px=np.stack([-other.parallax_px * lit.to_y, -other.parallax_px * lit.to_x]),
        is_seen=guarded(is_seen, own.is_matched, own.parallax_px),
        is_seen_back=guarded(is_seen_back, other.is_matched, other.parallax_px),
        error_px=place_error(
            own.parallax_px, own.error_px, _apart(own, other, lit), own.is_matched
        ),
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
        held_out_gain=held_out.gain,
    )


def _extremes(parallax_px: FloatArray) -> tuple[float, float]:
    """Least and largest parallax of features."""
    every = np.sort(parallax_px)
    first = np.searchsorted(every, every - _ALIKE_PX, "left")
    last = np.searchsorted(every, every + _ALIKE_PX, "right")
    kept = every[last - first >= _ALIKE]
    least, most = np.percentile(kept if kept.size else every, _EXTREMES).tolist()
    return least, most


def _surfaces(
    views: AlignedViews, small: AlignedViews, matched: MatchedViews, factor: int
) -> tuple[Surface, Surface]:
    """Surfaces of the target's pixels and of the source's."""
    back = views.reversed()
    turned = replace(matched, target=matched.source, source=matched.target)
    own = _surface_of(views, small, matched, factor)
    other = _surface_of(back, small.reversed(), turned, factor)
    return (
        _without_elsewhere(views, (own, other), matched.range_px, factor),
        _without_elsewhere(back, (other, own), matched.range_px, factor),
    )


def _surface_of(
    views: AlignedViews, small: AlignedViews, matched: MatchedViews, factor: int
) -> Surface:
    """The surface of the target's pixels by what was matched, and holes in it."""
    rough, agrees = _rough(views, small, matched, factor)
    parallax, error, unlike = refined_parallax(views, rough, agrees, coarse_px=factor)
    is_matched = known_surface(parallax, agrees, unlike)
    parallax, is_hole = filled_holes(parallax, is_matched, views.is_target & views.is_source)
    known = is_matched | is_hole
    filled, is_sure = filled_surface(parallax, known, agrees, views.to_x, views.to_y)
    return Surface(
        parallax_px=filled,
        error_px=error,
        is_matched=is_matched,
        is_known=known,
        is_sure=is_sure & views.is_target,
        is_elsewhere=np.zeros_like(known),
    )


def _without_elsewhere(
    views: AlignedViews, both: tuple[Surface, Surface], range_px: tuple[int, int], factor: int
) -> Surface:
    """The target's surface less what lies elsewhere, looked for on the image of the matching.

    ``both``: the target's surface and the source's.
    """
    own, other = both
    reduced = views.reduced(factor)
    rows, cols = reduced.target.shape
    part = np.s_[: rows * factor : factor, : cols * factor : factor]
    scale = np.float32(factor)
    found = is_elsewhere(
        reduced,
        (own.parallax_px[part] / scale, other.parallax_px[part] / scale),
        (own.is_matched[part], other.is_matched[part]),
        range_px,
    )
    elsewhere = enlarged(found.astype(np.float32), factor, own.is_matched.shape) > 0.5
    return replace(own, is_elsewhere=elsewhere, is_sure=own.is_sure & (own.is_matched | ~elsewhere))


def seen_in_both(own: Surface, other: Surface, views: AlignedViews) -> BoolArray:
    """Pixels of a surface that nothing hides in the other view, away from both borders."""
    hidden = hidden_in_other(own.parallax_px, other.parallax_px, other.is_known, views)
    hides = other.is_elsewhere.astype(np.float32)
    hidden |= shifted_along(hides, views, own.parallax_px, cv2.INTER_NEAREST) > 0
    inner = _within(views.is_source).astype(np.float32)
    is_inner = shifted_along(inner, views, own.parallax_px, cv2.INTER_NEAREST) > 0
    # What was matched there and back is there.
    return own.is_sure & (own.is_matched | ~hidden) & is_inner & _within(views.is_target)


def _apart(own: Surface, other: Surface, views: AlignedViews) -> Float32Array:
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
    agrees = enlarged(is_matched.astype(np.float32), factor, shape) > 0.5
    rough = enlarged(matched.target, factor, shape) * factor
    is_source = views.is_source.astype(np.float32)
    agrees &= shifted_along(is_source, views, rough, cv2.INTER_NEAREST) > 0
    return rough, agrees & views.is_target


def _coarse_range(
    views: AlignedViews, lit: AlignedViews, extremes_px: tuple[float, float], factor: int
) -> tuple[int, int] | None:
    """Range of the parallax in pixels of the matching; None if there is none.

    At half the resolution, where looking costs an eighth. ``extremes_px``: of the features.
    """
    least, most = min(extremes_px[0], 0.0), max(extremes_px[1], 0.0)
    coarse = _COARSER * factor
    room = _BEYOND_SHARE * (most - least) + _BEYOND_PX
    small = views.reduced(coarse)
    matched = match_views(
        small,
        max(floor((least - room) / coarse), -_MOST_PX // _COARSER),
        min(ceil((most + room) / coarse), _MOST_PX // _COARSER),
    )
    tells = small.target.size >= _LEAST_COARSE_PX
    if tells and not HeldOutGain.of(lit, matched, coarse).may_have_depth:
        return None
    found = matched.target[matched_both_ways(matched.target, matched.source, small)]
    low, high = matched.range_px
    count = np.bincount((found - low).astype(np.int64), minlength=high - low + 1)
    common = low + np.flatnonzero(np.convolve(count, np.ones(3), "same") >= _LEAST_COMMON_PX)
    least = min(floor(least / coarse), *common.tolist())
    most = max(ceil(most / coarse), *common.tolist())
    return _COARSER * max(least - 1, low), _COARSER * min(most + 1, high)
