"""The sum over six by six pixels by which a follow-up is sampled, in vector instructions.

The compiler is told the instructions, because it does not find them: a row of six pixels and its
weights are read as one vector of eight, the last two weights being 0. That takes less than half the
time of single multiplications, as ``benchmarks/bench_pose.py`` shows.
"""

from collections.abc import Callable
from math import comb
from typing import Any, cast

import numpy as np
from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.extending import intrinsic

from simulation.arrays import FloatArray

READ_PX = 8
"""Pixels that are read at a time; those beyond the sixth must exist and be finite."""

_ORDER = ("reassoc", "contract", "nsz")
"""Sums may be reordered; NaN and infinity keep their meaning."""


def weight_table(pieces: FloatArray) -> FloatArray:
    """Polynomials of a sampling kernel's six weights.

    Parameters
    ----------
    pieces
        Shape (3, 6): coefficients of the kernel at the distances ``j + u``, u from 0 to 1.

    Returns
    -------
    ndarray of shape (6, 8)
        For a position t px after a pixel, the weight of the pixel ``m - 2`` px from that one is
        ``sum_k table[k, m] t^k``; the last two columns are 0.
    """
    # (1 - t)^k in powers of t.
    mirrored = np.array([[(-1) ** j * comb(k, j) for j in range(6)] for k in range(6)])
    table = np.zeros((6, READ_PX))
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
those of the columns are by `weight_table` for the position ``part`` px after the third of them. All
have the pixels' dtype."""


def _emit(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:  # noqa: ANN401
    element = context.get_data_type(signature.return_type)
    vector, size = ir.VectorType(element, READ_PX), context.get_abi_sizeof(element)
    pixels, start, down, table, part = arguments
    pixels = context.make_array(signature.args[0])(context, builder, pixels).data
    table = context.make_array(signature.args[3])(context, builder, table).data

    def repeated(value: Any) -> Any:  # noqa: ANN401
        unset, lanes = ir.Constant(vector, ir.Undefined), ir.VectorType(ir.IntType(32), READ_PX)
        single = builder.insert_element(unset, value, ir.Constant(ir.IntType(32), 0))
        return builder.shuffle_vector(single, unset, ir.Constant(lanes, [0] * READ_PX))

    def read(start: Any, index: Any) -> Any:  # noqa: ANN401
        pointer = builder.bitcast(builder.gep(start, [index]), vector.as_pointer())
        return builder.load(pointer, align=size)

    def plus_product(total: Any, one: Any, other: Any) -> Any:  # noqa: ANN401
        return builder.fadd(total, builder.fmul(one, other, flags=_ORDER), flags=_ORDER)

    powers = [read(table, ir.Constant(ir.IntType(64), READ_PX * power)) for power in range(6)]
    part, along = repeated(part), powers[5]
    for power in powers[4::-1]:
        along = plus_product(power, along, part)
    index, stride = builder.extract_value(start, 0), builder.extract_value(start, 1)
    total = ir.Constant(vector, [0.0] * READ_PX)
    for row in range(6):
        weight = repeated(builder.extract_value(down, row))
        total = plus_product(total, weight, read(pixels, index))
        index = builder.add(index, stride)
    summed = cgutils.get_or_insert_function(  # type: ignore[no-untyped-call]
        builder.module,
        ir.FunctionType(element, [element, vector]),
        f"llvm.vector.reduce.fadd.v{READ_PX}f{8 * size}",
    )
    products = builder.fmul(total, along, flags=_ORDER)
    return builder.call(summed, [ir.Constant(element, -0.0), products], fastmath=_ORDER)
