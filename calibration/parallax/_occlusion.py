"""What is on a surface, what lies between two, and what only one photograph shows.

A pixel whose match does not look like it, or is not matched back, says nothing of its depth: it may
have changed. Between two places of one surface its parallax is interpolated along the line; at a
jump only what was matched counts, as what is hidden in the other photograph lies there.
"""

from typing import Final

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.parallax._views import AlignedViews, shifted_along
from simulation.arrays import BoolArray, Float32Array
from simulation.compiled import compiled, compiled_part

_TWO_WAY_PX: Final = 1.5
"""Distance at which a match there and back ends."""

_MOST_UNLIKE, _UNLIKE_MEAN_PX = 2.2, 1.5
"""Mean over a Gaussian of this width of what a match leaves over what is expected, for a match."""

_UNLIKE_GROWN_PX: Final = 4
_LEAST_ISLAND_PX: Final = 80
_JUMP_PX, _JUMP_SLOPE = 1.0, 0.12
"""Parallax of one surface at both sides of a gap differs by at most so much, and by so much a pixel
of the gap."""

_MOST_GAP_PX: Final = 20
"""At a jump, of a gap in which what was matched counts: what is larger is a thing by itself."""

_FARTHEST_PX: Final = 80
_LEAST_HOLE_PX, _MOST_HOLE_SHARE = 12, 0.05
"""Of a hole in a surface; the share is of the frame."""

_RING_PX, _LEAST_RING_PX, _RING_ROUNDS = 3, 24, 5
_MOST_OF_RING, _STEEPEST = 0.8, 0.25
"""Share of the pixels around a hole that one plane must explain, and parallax by which that may
change from a pixel to the next: what is steeper joins two surfaces."""

_UNSEEN_APART, _LEAST_SEEN = np.float32(2.0), 0.5
"""In units of the contrast, of what is beyond the other photograph; and the share of a window that
is within it."""

_LIKENESS_PX: Final = 9
"""Window in which levels are compared with those at another parallax."""

_FAR_BETTER, _OFF_SURFACE, _AS_FAR = 0.2, 2.0, 0.5
"""Share of what a surface leaves beyond noise, below which something looks far more like it; what
leaves so many times what noise leaves is not of a surface; and the share beyond noise that the same
thing leaves at least from the other side."""

_LEAST_HIDDEN_PX: Final = 16
"""What is hidden in fewer pixels is an error of either parallax."""

_GUARD_PX: Final = 2
_AROUND_PX, _SPREAD_SHARE, _UNMATCHED_SPREAD_SHARE = 13, 0.1, 0.5
"""Window, and the share of the parallax's range in it by which a pixel may be off: one that was
matched, and one that was not."""

_INTERPOLATED_PX: Final = 0.3
"""And that of a pixel which was not matched."""


def matched_both_ways(own: Float32Array, other: Float32Array, views: AlignedViews) -> BoolArray:
    """Pixels whose parallax is that of the place which they find in the other view."""
    back = shifted_along(other, views, own, cv2.INTER_NEAREST)
    # Written so that NaN is not matched.
    return np.asarray(np.abs(back - own) <= _TWO_WAY_PX)


def known_surface(parallax_px: Float32Array, matched: BoolArray, unlike: Float32Array) -> BoolArray:
    """Matched pixels that look like their match, in patches of some size."""
    is_unlike = (cv2.GaussianBlur(unlike, (0, 0), _UNLIKE_MEAN_PX) > _MOST_UNLIKE) & matched
    if is_unlike.any():
        size = 2 * _UNLIKE_GROWN_PX + 1
        disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
        is_unlike = cv2.dilate(is_unlike.astype(np.uint8), disc).astype(np.bool_)
    known = matched & ~is_unlike
    labels, sizes = surface_patches(parallax_px, known)
    return np.asarray(known & (sizes[labels] >= _LEAST_ISLAND_PX))


@compiled(nogil=True)
def surface_patches(
    parallax: Float32Array, known: BoolArray
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Number of the connected patch of each known pixel, and the patches' sizes; 0 for others."""
    rows, cols = parallax.shape
    labels = np.zeros((rows, cols), dtype=np.int32)
    sizes = np.zeros(rows * cols + 1, dtype=np.int32)
    stack = np.empty((rows * cols, 2), dtype=np.int32)
    count = 0
    for row in range(rows):
        for col in range(cols):
            if not known[row, col] or labels[row, col]:
                continue
            count += 1
            labels[row, col] = count
            stack[0, 0], stack[0, 1] = row, col
            height = 1
            while height:
                height -= 1
                y, x = stack[height, 0], stack[height, 1]
                sizes[count] += 1
                for side in range(4):
                    j, i = y + (side == 0) - (side == 1), x + (side == 2) - (side == 3)
                    if not (0 <= j < rows and 0 <= i < cols and known[j, i]) or labels[j, i]:
                        continue
                    if abs(parallax[j, i] - parallax[y, x]) <= _JUMP_PX:
                        labels[j, i] = count
                        stack[height, 0], stack[height, 1] = j, i
                        height += 1
    return labels, sizes


@compiled_part()
def _side(known: BoolArray, row: int, col: int, to_y: float, to_x: float) -> tuple[int, int, int]:
    """First known pixel from a place on, and how far it is; -1 if there is none near enough."""
    rows, cols = known.shape
    for step in range(1, _FARTHEST_PX + 1):
        y, x = int(np.floor(row + step * to_y + 0.5)), int(np.floor(col + step * to_x + 0.5))
        if y < 0 or x < 0 or y >= rows or x >= cols:
            return -1, -1, step
        if known[y, x]:
            return y, x, step
    return -1, -1, _FARTHEST_PX


@compiled(nogil=True)
def filled_surface(
    parallax: Float32Array,
    known: BoolArray,
    matched: BoolArray,
    to_x: Float32Array,
    to_y: Float32Array,
) -> tuple[Float32Array, BoolArray]:
    """Parallax of every pixel, and whether it is that of a surface: interpolated between its sides.

    At a jump what was matched is taken as matched, and what was not has the parallax of what is
    nearest along the line, but does not count.
    """
    rows, cols = parallax.shape
    filled, is_sure = parallax.copy(), known.copy()
    for row in range(rows):
        for col in range(cols):
            if known[row, col]:
                continue
            u, v = to_x[row, col], to_y[row, col]
            ahead_y, ahead_x, ahead = _side(known, row, col, v, u)
            back_y, back_x, back = _side(known, row, col, -v, -u)
            if ahead_y < 0 and back_y < 0:
                # Across the line, where nothing lies along it.
                ahead_y, ahead_x, ahead = _side(known, row, col, u, -v)
                back_y, back_x, back = _side(known, row, col, -u, v)
            if ahead_y < 0 and back_y < 0:
                filled[row, col] = 0.0
                continue
            if ahead_y < 0 or back_y < 0:
                one = parallax[back_y, back_x] if ahead_y < 0 else parallax[ahead_y, ahead_x]
                gap = back if ahead_y < 0 else ahead
                is_sure[row, col] = (
                    matched[row, col]
                    and abs(parallax[row, col] - one) <= _JUMP_PX
                    and gap <= _MOST_GAP_PX
                )
                if not is_sure[row, col]:
                    filled[row, col] = one
                continue
            first, last = parallax[back_y, back_x], parallax[ahead_y, ahead_x]
            if abs(first - last) <= _JUMP_PX + _JUMP_SLOPE * (ahead + back):
                filled[row, col] = first + (last - first) * back / (ahead + back)
                is_sure[row, col] = True
            else:
                is_sure[row, col] = matched[row, col] and ahead + back <= _MOST_GAP_PX
                if not matched[row, col]:
                    filled[row, col] = first if back <= ahead else last
    return filled, is_sure


def filled_holes(
    parallax_px: Float32Array, known: BoolArray, shown: BoolArray
) -> tuple[Float32Array, BoolArray]:
    """Fill holes within one surface by a plane; also returns where.

    What one photograph hides lies between two surfaces. A hole that one surface surrounds is where
    something changed, or nothing is to be seen. ``shown``: pixels that both photographs reach.
    """
    filled, is_hole = parallax_px.copy(), np.zeros_like(known)
    holes = (~known).astype(np.uint8)
    count, labels, stats, _ = cv2.connectedComponentsWithStats(holes, connectivity=4)
    most = _MOST_HOLE_SHARE * known.size
    inner = shown.copy()
    inner[:1] = inner[-1:] = inner[:, :1] = inner[:, -1:] = False
    for number in range(1, count):
        left, top, width, height, area = stats[number].tolist()
        if not _LEAST_HOLE_PX <= area <= most:
            continue
        reach = _RING_PX
        part = np.s_[
            max(top - reach, 0) : top + height + reach, max(left - reach, 0) : left + width + reach
        ]
        own = labels[part] == number
        window = np.ones((2 * reach + 1, 2 * reach + 1), dtype=np.uint8)
        around = cv2.dilate(own.astype(np.uint8), window).astype(np.bool_)
        # Beside a border nothing says what is on its other side.
        if not inner[part][around].all():
            continue
        ring = around & known[part]
        level = _one_surface(parallax_px[part], ring)
        if level is not None:
            filled[part][own] = level[own]
            is_hole[part] |= own
    return filled, is_hole


def is_elsewhere(
    views: AlignedViews,
    parallax_px: tuple[Float32Array, Float32Array],
    matched: tuple[BoolArray, BoolArray],
    range_px: tuple[int, int],
) -> BoolArray:
    """Unmatched pixels of the target that lie elsewhere on their line, and those beside them.

    A small thing may have no match, and be taken for a hole in what is behind it. Its place in the
    source is one that looks far more like it, and is no more of the source's surface there than it
    is of the target's, or is matched with it. ``views``: in their own light. ``parallax_px,
    matched``: of the target's surface and of the source's.
    """
    doubtful = ~matched[0] & views.is_target
    if not doubtful.any():
        return doubtful
    own = _left_at(views, parallax_px[0])
    # What noise leaves.
    least = np.float32(np.median(own[matched[0]]) if matched[0].any() else 0)
    other = _left_at(views.reversed(), parallax_px[1])
    alike, as_far = (least + np.float32(share) * (own - least) for share in (_FAR_BETTER, _AS_FAR))
    known_px = np.where(matched[1], parallax_px[1], np.float32(np.nan))
    found = np.zeros_like(doubtful)
    for parallax in range(range_px[0], range_px[1] + 1):
        moved = np.full_like(own, parallax)
        off_there, known_there = (
            shifted_along(one, views, moved, cv2.INTER_NEAREST) for one in (other, known_px)
        )
        is_its = off_there > as_far
        is_its |= np.abs(known_there - moved) <= _TWO_WAY_PX
        found |= is_its & (_left_at(views, moved) < alike)
    found &= doubtful & (own > _OFF_SURFACE * least)
    # Windows find its middle, and not its outline.
    around = np.ones((_LIKENESS_PX, _LIKENESS_PX), dtype=np.uint8)
    return cv2.dilate(found.astype(np.uint8), around).astype(np.bool_)


def _left_at(views: AlignedViews, parallax_px: Float32Array) -> Float32Array:
    """Mean difference around the target's pixels, at that parallax."""
    apart = np.abs(shifted_along(views.source, views, parallax_px, cv2.INTER_LINEAR) - views.target)
    is_seen = np.isfinite(apart)
    window = (_LIKENESS_PX, _LIKENESS_PX)
    total = cv2.blur(np.where(is_seen, apart, np.float32(0)), window)
    share = np.maximum(cv2.blur(is_seen.astype(np.float32), window), np.float32(1e-6))
    return np.where(share > _LEAST_SEEN, total / share, _UNSEEN_APART).astype(np.float32)


def _one_surface(parallax_px: Float32Array, ring: BoolArray) -> Float32Array | None:
    """The plane through a ring of pixels, where it is that of nearly all of them."""
    rows, cols = np.nonzero(ring)
    if len(rows) < _LEAST_RING_PX:
        return None
    design = np.column_stack([np.ones(len(rows)), rows, cols])
    levels = parallax_px[ring].astype(np.float64)
    weight = np.ones(len(rows))
    for _ in range(_RING_ROUNDS):
        plane = np.linalg.lstsq(design * weight[:, None], levels * weight, rcond=None)[0]
        apart = np.abs(levels - design @ plane)
        weight = np.asarray(1 / np.sqrt(np.maximum(apart, 0.1)))
    if np.mean(apart < _JUMP_PX) < _MOST_OF_RING or np.hypot(plane[1], plane[2]) > _STEEPEST:
        return None
    y, x = np.indices(ring.shape)
    return np.asarray(plane[0] + plane[1] * y + plane[2] * x, dtype=np.float32)


def hidden_in_other(
    own: Float32Array, other: Float32Array, is_other_sure: BoolArray, views: AlignedViews
) -> BoolArray:
    """Pixels at whose place the other view has another surface, as far as that is known."""
    there = shifted_along(other, views, own, cv2.INTER_NEAREST)
    sure = shifted_along(is_other_sure.astype(np.float32), views, own, cv2.INTER_NEAREST)
    hidden = ((sure > 0) & (np.abs(there - own) > _TWO_WAY_PX)).astype(np.uint8)
    # As wide as a jump is high, and as long as what stands before it.
    _, labels, stats, _ = cv2.connectedComponentsWithStats(hidden, connectivity=8)
    is_large = stats[:, cv2.CC_STAT_AREA] >= _LEAST_HIDDEN_PX
    is_large[0] = False
    return np.asarray(is_large[labels])


def place_error(
    parallax_px: Float32Array, error_px: Float32Array, apart_px: Float32Array, matched: BoolArray
) -> Float32Array:
    """How far pixels may be from their places: by noise, and by how much the surface varies around.

    Beside a jump, and on a steep slope, neighbours are of other depths than a pixel itself.
    ``apart_px``: from what the other photograph's pixels say of the same place. What was not
    ``matched`` may be of any depth around.
    """
    around = np.ones((_AROUND_PX, _AROUND_PX), dtype=np.uint8)
    spread = cv2.dilate(parallax_px, around) - cv2.erode(parallax_px, around)
    measured = np.where(np.isfinite(error_px), error_px, np.float32(_INTERPOLATED_PX))
    # Noise, and what is averaged with a pixel, are much the same there and back.
    measured = np.maximum(measured, apart_px)
    share = np.where(matched, np.float32(_SPREAD_SHARE), np.float32(_UNMATCHED_SPREAD_SHARE))
    return np.asarray(np.hypot(measured, share * spread), dtype=np.float32)


def guarded(is_seen: BoolArray, matched: BoolArray, parallax_px: Float32Array) -> BoolArray:
    """Pixels further than a guard band from what is not seen in both, and from a jump.

    Lenses mix what is at both sides of it, and each photograph has them at another distance. Where
    nothing is ``matched`` lines are filled one by one, and a jump between two of them is none.
    """
    around = np.ones((3, 3), dtype=np.uint8)
    known = is_seen & matched
    most = cv2.dilate(np.where(known, parallax_px, np.float32(-1e9)), around)
    least = cv2.erode(np.where(known, parallax_px, np.float32(1e9)), around)
    left_out = ~is_seen | (most - least > _TWO_WAY_PX)
    disc = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _GUARD_PX + 1, 2 * _GUARD_PX + 1))
    return ~cv2.dilate(left_out.astype(np.uint8), disc).astype(np.bool_)
