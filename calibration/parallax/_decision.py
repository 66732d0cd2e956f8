"""Where parallax explains more than the plane, surface by surface, by pixels that were held out.

A plate on a table is a small part of the frame: over all of it, noise may hide what the plate's
parallax explains. And in a scene with depth, a surface that the plane explains better is on it.
"""

from dataclasses import dataclass, replace
from typing import Self

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.parallax._matching import HELD_OUT_PX, MatchedViews
from calibration.parallax._occlusion import surface_patches
from calibration.parallax._refinement import SMOOTHING_PX
from calibration.parallax._views import AlignedViews, seen_at, shifted_along, spline_of
from calibration.robust import robust_sigma
from simulation.arrays import BoolArray, Float32Array, FloatArray, IntArray

_LEAST_GAIN, _SURE_SD = 0.05, 2.5
"""Share of what the plane leaves that parallax must explain, and its standard errors."""

_WORSE_SD = 1.0
"""A frame that parallax explains less than the plane, by so many standard errors, has no depth."""

_TRIMMED_SD = 6.0
_NOTHING = 1e-30


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class HeldOutGain:
    """How much more than the plane parallax explains in held-out blocks.

    ``gain``: relative to what the plane leaves, without surfaces that lose. ``has_depth``: whether
    the parallax of the frame, or of a surface, explains more for certain, and that of the frame not
    less. ``may_have_depth``: whether a closer look may find that. ``surfaces``: number of each
    pixel's surface, 0 on the plane, at the sampling of the matching. ``loses``: by number, whether
    the plane explains more for certain.
    """

    gain: float
    has_depth: bool
    may_have_depth: bool
    surfaces: NDArray[np.int32]
    loses: BoolArray

    @classmethod
    def of(cls, views: AlignedViews, matched: MatchedViews, factor: int) -> Self:
        """``views``: in their own light. ``matched``: of them, reduced by the factor."""
        surfaces, sizes = surface_patches(matched.held_out, matched.held_out != 0)
        part, before, better = _left_by_part(views, matched, factor, surfaces)
        sums = (_sums(part, values, len(sizes)) for values in (before, better, np.square(better)))
        # Of each surface, and last of the frame.
        left, gained, squares = (np.append(one, one.sum()) for one in sums)
        # Where a plane is as good, a block is better or worse by chance.
        spread = np.sqrt(squares)
        wins = (gained > 0) & (gained >= _LEAST_GAIN * left) & (gained >= _SURE_SD * spread)
        loses = ((gained < 0) & (gained <= -_SURE_SD * spread))[:-1]
        is_worse = bool(gained[-1] <= -_WORSE_SD * spread[-1])
        return cls(
            gain=float(gained[:-1][~loses].sum() / max(left[-1], _NOTHING)),
            has_depth=bool(wins.any()) and not is_worse,
            may_have_depth=bool(wins.any()) or not is_worse,
            surfaces=surfaces,
            loses=loses,
        )

    def kept(self, matched: MatchedViews, small: AlignedViews) -> MatchedViews:
        """The same with the surfaces that lose on the plane. ``small``: what was matched."""
        if not self.loses.any():
            return matched
        target, loses = _on_plane(matched.target, self.loses[self.surfaces])
        there = shifted_along(
            loses.astype(np.float32), small.reversed(), matched.source, cv2.INTER_NEAREST
        )
        source, _ = _on_plane(matched.source, there > 0)
        return replace(matched, target=target, source=source)


def _sums(number: IntArray, values: FloatArray, count: int = 0) -> FloatArray:
    return np.bincount(number, values, count).astype(np.float64)


def _on_plane(parallax_px: Float32Array, loses: BoolArray) -> tuple[Float32Array, BoolArray]:
    """Put surfaces on the plane of whose pixels most lose; also returns where."""
    surfaces, sizes = surface_patches(parallax_px, parallax_px != 0)
    losing = np.bincount(surfaces[loses], minlength=len(sizes))
    is_on = (losing > 0.5 * sizes)[surfaces] & (parallax_px != 0)
    return np.where(is_on, np.float32(0), parallax_px), is_on


def _left_by_part(
    views: AlignedViews, matched: MatchedViews, factor: int, surfaces: NDArray[np.int32]
) -> tuple[IntArray, FloatArray, FloatArray]:
    """What the plane leaves of each surface's part of each held-out block, and parallax less.

    The first is the surface's number.
    """
    target, source = (
        np.asarray(cv2.GaussianBlur(one, (0, 0), SMOOTHING_PX), dtype=np.float32)
        for one in (views.target, views.source)
    )
    shape = target.shape
    parallax = enlarged(matched.held_out, factor, shape) * factor
    # By splines: a mean of neighbours has less noise, which is not the parallax's doing.
    rows, cols = np.mgrid[0 : shape[0], 0 : shape[1]].astype(np.float32)
    at_y, at_x = rows + parallax * views.to_y, cols + parallax * views.to_x
    bent = np.abs(target - seen_at(spline_of(source), at_y, at_x))
    counts = enlarged(matched.is_held_out.astype(np.float32), factor, shape) > 0.5
    counts &= views.is_target & views.is_source & np.isfinite(bent)
    apart = (target - source)[counts]
    if not apart.any():
        return np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0)
    # Where nothing is seen, nothing differs: that says nothing of the scatter.
    most = np.float32(_TRIMMED_SD * robust_sigma(apart[apart != 0]))
    before, after = (np.minimum(one, most) for one in (np.abs(apart), bent[counts]))
    rows, cols = np.nonzero(counts)
    block = HELD_OUT_PX * factor
    number = enlarged(surfaces.astype(np.float32), factor, shape)[counts].astype(np.int64)
    blocks_a_row = shape[1] // block + 1
    blocks = (shape[0] // block + 1) * blocks_a_row
    key = number * blocks + rows // block * blocks_a_row + cols // block
    parts, part = np.unique(key, return_inverse=True)
    left, better = (_sums(part, one) for one in (before, before - after))
    return np.asarray(parts // blocks, dtype=np.int64), left, better


def enlarged(image: Float32Array, factor: int, shape: tuple[int, ...]) -> Float32Array:
    """Pixels so many times as small, up to the border."""
    if factor == 1:
        return image
    large = np.repeat(np.repeat(image, factor, axis=0), factor, axis=1)
    rows, cols = (n - m for n, m in zip(shape, large.shape, strict=True))
    return np.asarray(np.pad(large, ((0, rows), (0, cols)), mode="edge"), dtype=np.float32)
