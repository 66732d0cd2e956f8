"""Rows of an image combined by weights, two sums at a time; compiled.

Both sums of three vectors of columns stay in registers while the rows go by. The compiler is told
those instructions, because it does not find them: a loop over the columns for every six rows reads
and writes the sums as often as it reads pixels, and takes twice the time.
"""

from collections.abc import Callable
from functools import partial
from typing import Any, cast

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from simulation.arrays import FloatImage, IntArray
from simulation.compiled import compiled

VECTOR_BYTES = 64
"""Of a row that are combined by one instruction, or by two of half the length."""

_WIDE = 3
"""Vectors of either row of a pair that are summed at a time, in six registers or in twelve."""

PACKED_BYTES = 768
"""Of an image's rows that are copied side by side: where rows are far apart, the caches and the
translation of addresses hold few of them."""


def whole_vectors(count: int, dtype: "np.dtype[Any]") -> int:
    """Round a number of pixels up to whole vectors."""
    lanes = VECTOR_BYTES // dtype.itemsize
    return -(-count // lanes) * lanes


_ORDER = ("reassoc", "contract", "nsz")
"""Sums may be reordered; NaN and infinity keep their meaning."""


def _products(vectors: int) -> Callable[..., None]:
    """Make the compiled part that combines rows for ``vectors`` times 64 bytes of either result."""

    @intrinsic
    def add(
        _context: Any,  # noqa: ANN401
        rows: Any,  # noqa: ANN401
        stride: Any,  # noqa: ANN401
        weights: Any,  # noqa: ANN401
        out: Any,  # noqa: ANN401
        adds: Any,  # noqa: ANN401
    ) -> tuple[Any, Any]:
        signature = types.void(rows, stride, weights, out, adds)
        return signature, partial(_emit_products, vectors)

    return cast("Callable[..., None]", add)


def _emit_products(
    vectors: int,
    context: Any,  # noqa: ANN401
    builder: Any,  # noqa: ANN401
    signature: Any,  # noqa: ANN401
    arguments: Any,  # noqa: ANN401
) -> Any:  # noqa: ANN401
    """Keep the sums in registers, where a loop over the columns would read and write them."""
    kinds = signature.args
    element = context.get_data_type(kinds[0].dtype)
    size = context.get_abi_sizeof(element)
    lanes = VECTOR_BYTES // size
    vector, index = ir.VectorType(element, lanes), ir.IntType(64)
    unset, places = ir.Constant(vector, ir.Undefined), ir.VectorType(ir.IntType(32), lanes)
    rows, weights = (context.make_array(kinds[k])(context, builder, arguments[k]) for k in (0, 2))
    outs = [
        context.make_array(kinds[3].dtype)(context, builder, builder.extract_value(arguments[3], k))
        for k in range(2)
    ]

    def place(start: Any, number: int) -> Any:  # noqa: ANN401
        pointer = builder.gep(start, [ir.Constant(index, number * lanes)])
        return builder.bitcast(pointer, vector.as_pointer())

    def repeated(at: Any) -> Any:  # noqa: ANN401
        value = builder.load(builder.gep(weights.data, [at]))
        single = builder.insert_element(unset, value, ir.Constant(ir.IntType(32), 0))
        return builder.shuffle_vector(single, unset, ir.Constant(places, [0] * lanes))

    held = cast("Callable[..., Any]", cgutils.alloca_once)
    sums = [[held(builder, vector) for _ in range(vectors)] for _ in outs]
    for out, own in zip(outs, sums, strict=True):
        for number, total in enumerate(own):
            so_far = builder.load(place(out.data, number), align=size)
            zero = ir.Constant(vector, [0.0] * lanes)
            builder.store(builder.select(arguments[4], so_far, zero), total)
    count = builder.lshr(builder.extract_value(weights.shape, 0), ir.Constant(index, 1))
    with cgutils.for_range(builder, count) as loop:
        row = builder.gep(rows.data, [builder.mul(loop.index, arguments[1])])
        first = builder.shl(loop.index, ir.Constant(index, 1))
        factors = [repeated(builder.add(first, ir.Constant(index, k))) for k in range(2)]
        for number in range(vectors):
            pixels = builder.load(place(row, number), align=size)
            for factor, own in zip(factors, sums, strict=True):
                product = builder.fmul(factor, pixels, flags=_ORDER)
                total = builder.fadd(builder.load(own[number]), product, flags=_ORDER)
                builder.store(total, own[number])
    for out, own in zip(outs, sums, strict=True):
        for number, total in enumerate(own):
            builder.store(builder.load(total), place(out.data, number), align=size)
    return context.get_dummy_value()


_add_wide, _add_narrow = _products(_WIDE), _products(1)


@compiled(nogil=True)
def combine_rows(
    image: FloatImage,
    pairs: tuple[IntArray, IntArray, FloatImage],
    out: FloatImage,
    adds: bool,
    room: FloatImage,
) -> None:
    """Write, or add, pairs of combined rows of ``image`` to ``out``, of an even number of rows.

    ``out`` has as many columns as ``image``, but for a last vector to be full. ``room`` takes as
    many columns of ``image`` at a time as it has; if it has none, ``image`` itself is read.
    """
    starts, bands, weights = pairs
    lanes = VECTOR_BYTES // image.itemsize
    top, packed, width = 0, image, out.shape[1]
    if room.shape[1] > 0:
        top, packed, width = starts.min(), room, room.shape[1]
    pixels, stride = packed.reshape(-1), packed.shape[1]
    for left in range(0, out.shape[1], width):
        if room.shape[1] > 0:
            cols = min(width, image.shape[1] - left)
            for i in range((starts + bands).max() - top):
                copy, source = room[i], image[top + i, left : left + cols]
                for k in range(cols):
                    copy[k] = source[k]
        j, stop = 0, min(width, out.shape[1] - left)
        while j < stop:
            is_wide = j + _WIDE * lanes <= stop
            for k in range(len(starts)):
                rows, own = pixels[(starts[k] - top) * stride + j :], weights[k, : 2 * bands[k]]
                both = out[2 * k, left + j :], out[2 * k + 1, left + j :]
                if is_wide:
                    _add_wide(rows, stride, own, both, adds)
                else:
                    _add_narrow(rows, stride, own, both, adds)
            j += _WIDE * lanes if is_wide else lanes


@compiled(nogil=True, fastmath={*_ORDER})
def add_weighted(
    total: FloatImage,
    made: FloatImage,
    weights: tuple[FloatImage, IntArray, FloatImage],
    adds: bool,
) -> None:
    """Write, or add, what was made of an image, times weights as of `TermWeights`, its rows' own.

    A row of ``made`` is a column of the result.
    """
    values, node, part = weights
    for i in range(len(node)):
        before, after = values[node[i]], values[min(node[i] + 1, len(values) - 1)]
        share, own, row = part[i], total[i], made[i]
        for j in range(values.shape[1]):
            weighted = (before[j] + share * (after[j] - before[j])) * row[j]
            own[j] = own[j] + weighted if adds else weighted
