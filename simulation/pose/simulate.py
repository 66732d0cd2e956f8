"""The image that a camera would take of the same plane from another pose.

For any homography (tilt, rotation, perspective), lens distortion and PSF the reference is filtered
by a kernel that varies over it, and sampled once by a piecewise polynomial. The theory is in
``docs/theory-pose.md``. Two models choose both:

``matched``
    The ratio of the two transfer functions, up to the Nyquist frequency, then a quintic spline.
``lmmse``
    The least mean squared error for scenes with a first-order covariance, aliases included.

The sampling is compiled. Along a row of the follow-up the warp is evaluated every few pixels and
interpolated by cubics between, which is exact to 1e-6 px wherever its derivative changes slowly;
elsewhere, and where the sharper of the two images is in doubt, every pixel is evaluated. The
compiler is told the instructions of the sum over six by six pixels, because it does not find them:
a row of six pixels and its weights are read as one vector of eight, the last two weights being 0.
That takes less than half the time of single multiplications. Along a warp that keeps the directions
of rows and columns, as a plain zoom does, banded matrices filter and sample at once, at the
follow-up's pixels alone. Measured by ``benchmarks/speed/pose.py``.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from math import ceil, comb
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import cv2
import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic
from numpy.typing import NDArray

from simulation.arrays import AnyArray, BoolArray, FloatArray, FloatImage, IntArray
from simulation.by_value import ByValue
from simulation.compiled import compiled, compiled_part
from simulation.notebook import Shown
from simulation.pose._frontal import frontal_filter, keeps_axes, shown_px, sure_nearer
from simulation.pose._prefilter import SAMPLING_KERNELS
from simulation.pose._varying_filter import VaryingFilter
from simulation.pose._view_filter import ViewRequest, view_filter
from simulation.pose._warp import BORDER_PX, NEARER_TOLERANCE_PX2, BlurredWarp, surveyed
from simulation.pose.view import DEFAULT_OPTIONS, PoseOptions, PoseView
from simulation.psf import Psf, PsfField
from simulation.sampling_grid import reference_shape, refuse_non_finite

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


_READ_PX = 8
"""Pixels that are read at a time; those beyond the sixth must exist and be finite."""

_ORDER = ("reassoc", "contract", "nsz")
"""Sums may be reordered; NaN and infinity keep their meaning."""


def weight_table(pieces: FloatArray) -> FloatArray:
    """Polynomials of a sampling kernel's six weights, shape (6, 8), from its pieces, shape (3, 6).

    For a position t px after a pixel, the weight of the pixel ``m - 2`` px from that one is ``sum_k
    table[k, m] t^k``; the last two columns are 0.
    """
    # (1 - t)^k in powers of t.
    mirrored = np.array([[(-1) ** j * comb(k, j) for j in range(6)] for k in range(6)])
    table = np.zeros((6, _READ_PX))
    table[:, :3] = pieces[::-1].T
    table[:, 3:6] = (pieces @ mirrored).T
    return table


@intrinsic
def _weighted_six_by_six(
    _context: Any,  # noqa: ANN401
    pixels: Any,  # noqa: ANN401
    start: Any,  # noqa: ANN401
    down: Any,  # noqa: ANN401
    table: Any,  # noqa: ANN401
    part: Any,  # noqa: ANN401
) -> tuple[Any, Any]:
    indices = types.UniTuple(types.intp, 2)  # type: ignore[no-untyped-call]
    signature = pixels.dtype(pixels, indices, down, table, part)
    return signature, _emit


weighted_six_by_six = cast("Callable[..., float]", _weighted_six_by_six)
"""Sum of six rows of pixels: ``(pixels, start, down, table, part)``.

``start`` is the first pixel's index and the rows' stride, ``down`` a tuple of the rows' weights;
those of the columns are by `weight_table` for the position ``part`` px after the third of them.
All have the pixels' dtype."""


def _emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ANN401
    element = context.get_data_type(signature.return_type)
    vector, size = ir.VectorType(element, _READ_PX), context.get_abi_sizeof(element)
    pixels, start, down, table, part = arguments
    pixels = context.make_array(signature.args[0])(context, builder, pixels).data
    table = context.make_array(signature.args[3])(context, builder, table).data

    def repeated(value: Any) -> Any:  # noqa: ANN401
        unset, lanes = ir.Constant(vector, ir.Undefined), ir.VectorType(ir.IntType(32), _READ_PX)
        single = builder.insert_element(unset, value, ir.Constant(ir.IntType(32), 0))
        return builder.shuffle_vector(single, unset, ir.Constant(lanes, [0] * _READ_PX))

    def read(start: Any, index: Any) -> Any:  # noqa: ANN401
        pointer = builder.bitcast(builder.gep(start, [index]), vector.as_pointer())
        return builder.load(pointer, align=size)

    def plus_product(total: Any, one: Any, other: Any) -> Any:  # noqa: ANN401
        return builder.fadd(total, builder.fmul(one, other, flags=_ORDER), flags=_ORDER)

    powers = [read(table, ir.Constant(ir.IntType(64), _READ_PX * power)) for power in range(6)]
    part, along = repeated(part), powers[5]
    for power in powers[4::-1]:
        along = plus_product(power, along, part)
    index, stride = builder.extract_value(start, 0), builder.extract_value(start, 1)
    total = ir.Constant(vector, [0.0] * _READ_PX)
    for row in range(6):
        weight = repeated(builder.extract_value(down, row))
        total = plus_product(total, weight, read(pixels, index))
        index = builder.add(index, stride)
    summed = cgutils.get_or_insert_function(  # type: ignore[no-untyped-call]
        builder.module,
        ir.FunctionType(element, [element, vector]),
        f"llvm.vector.reduce.fadd.v{_READ_PX}f{8 * size}",
    )
    products = builder.fmul(total, along, flags=_ORDER)
    return builder.call(summed, [ir.Constant(element, -0.0), products], fastmath=_ORDER)


REACH_BEFORE_PX, REACH_AFTER_PX = 3, _READ_PX - 3
"""Coefficients on either side of a position that are read: before it 3, after it 3 that have a
weight and those that are read with them."""

_BLOCK_PX = 32
"""Longest piece of a row that is interpolated; it is halved until its cubic is nearly straight."""

_LEAST_BLOCK_PX = 4
"""Shorter pieces are evaluated pixel by pixel."""

_CUBIC_PX = 0.01
"""Largest cubic part of a piece. What a cubic leaves is less by the piece over the distance on
which the warp changes, and by 16: below 1e-5 px for a tilt, 3e-4 px for a frame of 100 px that is
distorted by 5 %."""

_DOUBT = 2.0
"""Changes of the least eigenvalue over a piece within which its sign is not interpolated."""


class CoefficientWindow(NamedTuple):
    """A part of the filtered reference, including what is beyond its border.

    Element (0, 0) of ``coefficients`` belongs to the reference pixel ``origin`` (row, col);
    ``size`` are the rows and columns of the whole reference, ``table`` the weights of the sampling
    kernel by `weight_table`, in the dtype of the coefficients.
    """

    coefficients: FloatImage
    origin: tuple[int, int]
    size: tuple[int, int]
    table: FloatImage


class _Canvas(NamedTuple):
    """One plane of the follow-up to write to, and its masks; what is past the reference stays."""

    image: FloatImage
    nearer: BoolArray
    outside: BoolArray


# Sums may be reordered, which vectorises them; NaN and infinity keep their meaning.
_FREE_ORDER = {"fastmath": {"reassoc", "contract", "nsz"}, "nogil": True}


@compiled(**_FREE_ORDER)
def _render(
    view: BlurredWarp,
    window: CoefficientWindow,
    canvas: _Canvas,
    first: tuple[int, int],
    shape: tuple[int, int],
) -> None:
    """Write a tile of the follow-up, whose first pixel is ``first``; both as (row, col).

    A missing variance below ``-NEARER_TOLERANCE_PX2`` marks it ``nearer``.
    """
    coefficients, origin, size, table = window
    image, nearer, outside = canvas
    left = first[1]
    places = np.empty((3, shape[1]))
    room = np.empty((8, shape[1]), coefficients.dtype)
    corners = np.empty(shape[1], np.int64)
    x, y = places[0], places[1]  # unpacked, they would count as strided
    for i in range(shape[0]):
        row = first[0] + i
        gone, near = outside[row, left : left + shape[1]], nearer[row, left : left + shape[1]]
        _mark_row(view, (row, left), size, places, (gone, near))
        start, stop = 0, shape[1]
        while start < stop and gone[start]:
            start += 1
        while start < stop and gone[stop - 1]:
            stop -= 1
        if start < stop:
            _sample_row(
                coefficients,
                (x[start:stop], origin[1], y[start:stop], origin[0]),
                (room[:, : stop - start], corners[: stop - start], table),
                gone[start:stop],
                image[row, left + start : left + stop],
            )


@compiled(**_FREE_ORDER)
def _mark(
    view: BlurredWarp,
    size: tuple[int, int],
    canvas: _Canvas,
    first: tuple[int, int],
    shape: tuple[int, int],
) -> None:
    """Write the masks of a tile as `_render` does; ``size`` is the whole reference's."""
    _, nearer, outside = canvas
    left = first[1]
    places = np.empty((3, shape[1]))
    for row in range(first[0], first[0] + shape[0]):
        gone, near = outside[row, left : left + shape[1]], nearer[row, left : left + shape[1]]
        _mark_row(view, (row, left), size, places, (gone, near))


@compiled(**_FREE_ORDER)
def sample_at(window: CoefficientWindow, x: FloatArray, y: FloatArray, out: FloatImage) -> None:
    """Write the image at reference positions, shape ``(rows, cols)``; not where they are NaN."""
    coefficients, origin, _, table = window
    cols = out.shape[1]
    room = np.empty((8, cols), coefficients.dtype)
    corners, outside = np.empty(cols, np.int64), np.empty(cols, np.bool_)
    at_x, at_y = np.empty(cols), np.empty(cols)
    for i in range(out.shape[0]):
        for j in range(cols):
            outside[j] = not (abs(x[i, j]) < np.inf)
            at_x[j] = float(origin[1] + 2) if outside[j] else x[i, j]
            at_y[j] = float(origin[0] + 2) if outside[j] else y[i, j]
        _sample_row(
            coefficients,
            (at_x, origin[1], at_y, origin[0]),
            (room, corners, table),
            outside,
            out[i],
        )


@compiled_part(**_FREE_ORDER)
def _mark_row(
    view: BlurredWarp,
    first: tuple[int, int],
    size: tuple[int, int],
    places: FloatArray,
    masks: tuple[BoolArray, BoolArray],
) -> None:
    """Fill in the places of a row's pixels, and where they are outside and nearer."""
    _place_row(view, first[0], first[1], places)
    gone, near = masks
    x, y, least = places[0], places[1], places[2]  # unpacked, they would count as strided
    right, bottom = size[1] - 1 + BORDER_PX, size[0] - 1 + BORDER_PX
    for j in range(len(x)):
        # Without short cuts, which would keep it from being done in vectors.
        is_inside = (x[j] >= -BORDER_PX) & (x[j] <= right) & (y[j] >= -BORDER_PX) & (y[j] <= bottom)
        gone[j] = not is_inside
        near[j] = is_inside & (least[j] < -NEARER_TOLERANCE_PX2)


@compiled_part(**_FREE_ORDER)
def _place_row(view: BlurredWarp, row: int, first: int, places: FloatArray) -> None:
    """Fill in positions x, y and the least eigenvalues of the missing blur for a row's pixels."""
    matrix, lens, psf, frame = view
    x, y, least = places[0], places[1], places[2]  # unpacked, they would count as strided
    count = len(x)
    x0, y0, a0, c0, least0 = surveyed(matrix, lens, psf, frame, first, row)
    start, length = 0, _BLOCK_PX
    while start < count:
        length = min(length, count - start)
        x1, y1, a1, c1, least1 = surveyed(matrix, lens, psf, frame, first + start + length, row)
        mean_x, mean_y = (x1 - x0) / length, (y1 - y0) / length
        skew_x, skew_y = a0 + a1 - 2 * mean_x, c0 + c1 - 2 * mean_y
        # Written so that infinite positions are not straight.
        is_straight = length * (abs(skew_x) + abs(skew_y)) <= _CUBIC_PX
        if not is_straight and length > _LEAST_BLOCK_PX:
            length = length // 2
            continue
        is_sure = min(
            abs(least0 + NEARER_TOLERANCE_PX2), abs(least1 + NEARER_TOLERANCE_PX2)
        ) >= _DOUBT * abs(least1 - least0)
        if is_straight and is_sure:
            bend_x, bend_y = (mean_x - a0 - skew_x) / length, (mean_y - c0 - skew_y) / length
            skew_x, skew_y = skew_x / length**2, skew_y / length**2
            to_x, to_y = x[start : start + length], y[start : start + length]
            for k in range(length):
                t = np.float64(np.int32(k))
                to_x[k] = x0 + t * (a0 + t * (bend_x + t * skew_x))
                to_y[k] = y0 + t * (c0 + t * (bend_y + t * skew_y))
            least[start : start + length] = least0
        else:
            for k in range(start, start + length):
                x[k], y[k], _, _, least[k] = surveyed(matrix, lens, psf, frame, first + k, row)
        x0, y0, a0, c0, least0 = x1, y1, a1, c1, least1
        start, length = start + length, min(2 * length, _BLOCK_PX)


@compiled_part(**_FREE_ORDER)
def _put_weights(part: FloatImage, table: FloatImage, out: FloatImage) -> None:
    """Weights of the six rows around every position, shape (6, n)."""
    for m in range(6):
        c0, c1, c2 = table[0, m], table[1, m], table[2, m]
        c3, c4, c5 = table[3, m], table[4, m], table[5, m]
        weight = out[m]
        for j in range(len(part)):
            t = part[j]
            weight[j] = c0 + t * (c1 + t * (c2 + t * (c3 + t * (c4 + t * c5))))


@compiled_part(**_FREE_ORDER)
def _sample_row(
    coefficients: FloatImage,
    places: tuple[FloatArray, int, FloatArray, int],
    scratch: tuple[FloatImage, IntArray, FloatImage],
    outside: BoolArray,
    out: FloatImage,
) -> None:
    """Write the image at reference positions x and y, except where they are outside."""
    x, left, y, top = places
    room, corners, table = scratch
    stride, pixels = coefficients.shape[1], coefficients.reshape(-1)
    part_x, part_y = room[6], room[7]
    for j in range(len(out)):
        col, row = np.floor(x[j]), np.floor(y[j])
        corners[j] = (int(row) - 2 - top) * stride + int(col) - 2 - left
        part_x[j], part_y[j] = x[j] - col, y[j] - row
    _put_weights(part_y, table, room)
    v0, v1, v2, v3, v4, v5 = room[0], room[1], room[2], room[3], room[4], room[5]
    for j in range(len(out)):
        if not outside[j]:
            down = v0[j], v1[j], v2[j], v3[j], v4[j], v5[j]
            out[j] = weighted_six_by_six(pixels, (corners[j], stride), down, table, part_x[j])


_TILE_PX = 1024
"""Side of the follow-up's tiles: at zoom 1.5 each needs 20 MB of memory in float32."""

_BORDER_STEP_PX = 32
_BOW_PX = 1.0
"""Steps along a tile's border, and the bow by a lens in between, up to zoom 4 at 10 %; the margin
of the sampling is larger."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class SimulatedPose(Shown, ByValue):
    """A simulated follow-up on its own pixel grid.

    Parameters
    ----------
    image
        The follow-up, shape ``(rows, cols)`` or ``(rows, cols, channels)``, float32 or float64,
        finite; 0 where ``outside``.
    nearer
        Mask, shape ``(rows, cols)``, of the pixels at which a real follow-up would be sharper than
        the reference in at least one direction, which no simulation can recover; False where
        ``outside``.
    outside
        Mask, shape ``(rows, cols)``, of the pixels that look past the reference by more than half a
        pixel.
    hidden
        Of a scene with depth: mask, shape ``(rows, cols)``, of the pixels that see what was hidden
        from the reference, or lies at a depth that is not known; 0 there too.
    """

    image: FloatImage
    nearer: BoolArray
    outside: BoolArray
    hidden: BoolArray | None = None

    def __repr__(self) -> str:
        rows, cols = self.image.shape[:2]
        return (
            f"SimulatedPose({cols} x {rows} px, {self.outside.mean():.1%} outside the reference, "
            f"{self.nearer.mean():.1%} less sharp than it should be)"
        )

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return a figure of the follow-up, from its darkest to its brightest level."""
        from simulation.figures import drawn  # matplotlib, for whoever looks

        shown = self.image.astype(np.float64)
        dark, bright = (
            np.percentile(shown[~self.outside], [0.1, 99.9]) if not self.outside.all() else (0, 1)
        )
        shown = np.clip((shown - dark) / max(bright - dark, 1e-9), 0.0, 1.0)

        def draw(axes: "Axes") -> None:
            axes.imshow(shown, cmap="gray", vmin=0.0, vmax=1.0)
            axes.set(xlabel="x / px", ylabel="y / px")

        rows, cols = shown.shape[:2]
        return drawn(draw, ax, (6.4, 6.4 * rows / cols + 0.6))


def simulate_pose_of_image(
    image: AnyArray,
    homography: NDArray[np.floating[Any]],
    size: tuple[int, int],
    psf: Psf | PsfField | None,
    options: PoseOptions = DEFAULT_OPTIONS,
) -> SimulatedPose:
    """Image of the same plane from another pose of the same camera.

    ``image`` has the shape ``(rows, cols)`` or ``(rows, cols, channels)``, of uint8, uint16,
    float32 or float64, linear in light. ``homography``, shape (3, 3), takes follow-up pixels ``(x,
    y, 1)`` to reference pixels, up to a factor, pixel centres at integers; ``size`` is ``(width,
    height)`` of the follow-up. A PSF field is evaluated at each image's own pixel. The result is in
    the input's units, float64 for float64 input, else float32.

    A ValueError if the homography is singular or puts its horizon inside the follow-up's frame; if
    the follow-up shows nothing of the reference; if the image is of another kind or not finite; if
    the PSF is missing or a field belongs to another frame; if no lens has such a distortion; if the
    follow-up needs too wide a blur.
    """
    view = PoseView.of(
        homography, reference_shape(image), size, psf, options.origin_px, options.distortion_k1
    )
    request = ViewRequest.of(view, options)
    view_filter(request)
    refuse_non_finite(image)
    dtype = np.dtype(np.float64 if image.dtype == np.float64 else np.float32)
    planes = np.moveaxis(image[:, :, None] if image.ndim == 2 else image, 2, 0)
    result = np.zeros((len(planes), *view.follow_up), dtype=dtype)
    put = _put_frontal if keeps_axes(view) else _put_tilted
    nearer, outside = put(request, planes, result, options.threads)
    if outside.all():
        raise ValueError("the follow-up shows nothing of the reference")
    pixels = result[0] if image.ndim == 2 else np.ascontiguousarray(np.moveaxis(result, 0, -1))
    return SimulatedPose(image=pixels, nearer=nearer, outside=outside)


def _put_frontal(
    request: ViewRequest, planes: AnyArray, result: FloatImage, threads: int
) -> tuple[BoolArray, BoolArray]:
    """Write planes of a view that `keeps_axes`; return its masks ``nearer`` and ``outside``."""
    view = request.view
    outside = np.ones(view.follow_up, dtype=np.bool_)
    shown = tuple(shown_px(view, axis)[0] for axis in (1, 0))
    outside[shown] = False
    if outside.all():
        return ~outside, outside
    frontal = frontal_filter(request, result.dtype)
    for plane, out in zip(planes, result, strict=True):
        frontal.put(plane, out, threads)
    nearer = sure_nearer(view)
    if nearer is None:
        nearer = np.empty_like(outside)
        _mark(view.warp, view.reference, _Canvas(result[0], nearer, outside), (0, 0), outside.shape)
    return nearer & ~outside, outside


def _put_tilted(
    request: ViewRequest, planes: AnyArray, result: FloatImage, threads: int
) -> tuple[BoolArray, BoolArray]:
    """Write planes of any view; return its masks ``nearer`` and ``outside``."""
    view, filtered = request.view, view_filter(request)
    nearer = np.zeros(view.follow_up, dtype=np.bool_)
    outside = np.ones(view.follow_up, dtype=np.bool_)
    pieces = np.array(SAMPLING_KERNELS[request.model].pieces)
    table = weight_table(pieces).astype(result.dtype)

    def make(tile: tuple[slice, slice]) -> None:
        first, shape = (tile[0].start, tile[1].start), nearer[tile].shape
        seen = _seen(view, first, shape)
        if seen is None:
            return
        for plane, out in zip(planes, result, strict=True):
            window = coefficient_window(plane, seen, filtered, table)
            _render(view.warp, window, _Canvas(out, nearer, outside), first, shape)

    if threads == 1:
        for tile in tiles(*view.follow_up):
            make(tile)
    else:
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(make, tiles(*view.follow_up)))
    return nearer, outside


def tiles(height: int, width: int) -> Iterator[tuple[slice, slice]]:
    """Rows and columns of the tiles of a follow-up."""
    for top in range(0, height, _TILE_PX):
        for left in range(0, width, _TILE_PX):
            yield slice(top, top + _TILE_PX), slice(left, left + _TILE_PX)


def coefficient_window(
    image: AnyArray, seen: tuple[int, int, int, int], filtered: VaryingFilter, table: FloatImage
) -> CoefficientWindow:
    """Coefficients around a window, its ends included; mirrored at the image's edge."""
    top, bottom, left, right = seen
    before, after = REACH_BEFORE_PX + filtered.radius, REACH_AFTER_PX + filtered.radius
    rows, cols = image.shape
    inside = image[
        max(top - before, 0) : bottom + after + 1, max(left - before, 0) : right + after + 1
    ]
    window = cv2.copyMakeBorder(
        np.ascontiguousarray(inside, table.dtype),
        max(before - top, 0),
        max(bottom + after + 1 - rows, 0),
        max(before - left, 0),
        max(right + after + 1 - cols, 0),
        cv2.BORDER_REFLECT,
    )
    origin = (top - REACH_BEFORE_PX, left - REACH_BEFORE_PX)
    coefficients = filtered.apply(np.asarray(window), origin)
    return CoefficientWindow(coefficients, origin, image.shape[:2], table)


def _seen(
    view: PoseView, first: tuple[int, int], shape: tuple[int, int]
) -> tuple[int, int, int, int] | None:
    """Reference pixels around what a tile sees: top, bottom, left, right, or None."""
    rows, cols = (
        np.linspace(start, start + count - 1, max(2, ceil((count - 1) / _BORDER_STEP_PX) + 1))
        for start, count in zip(first, shape, strict=True)
    )
    # Without the horizon in the frame, the inside of the tile is inside its warped border.
    border = [view.survey(rows[[0, -1]], cols), view.survey(rows, cols[[0, -1]])]
    x, y = np.concatenate([points[..., :2].reshape(-1, 2) for points in border]).T
    # A homography keeps the border's lines straight; a lens bows them.
    bow_px = 0.0 if view.lens[0] == 0 else _BOW_PX
    bounds = []
    for coordinate, size in ((y, view.reference[0]), (x, view.reference[1])):
        low, high = coordinate.min() - bow_px, coordinate.max() + bow_px
        if high < -BORDER_PX or low > size - 1 + BORDER_PX:
            return None
        bounds += [max(int(np.floor(low)), -1), min(int(np.ceil(high)), size)]
    return bounds[0], bounds[1], bounds[2], bounds[3]
