"""Cholesky factors of a band and of a few terms beside it, and what is solved with them.

All is written out: LAPACK's routines take longer to compile for so small systems than to run.
"""

from math import log

import numpy as np

from simulation.arrays import FloatArray
from simulation.compiled import compiled_part

BAND = 4  # the diagonal and three beside it


@compiled_part()
def band_factor(data: FloatArray, penalty: FloatArray, weight: float) -> FloatArray:
    """Lower Cholesky factor in the band; its first element is 0 where there is none."""
    count = data.shape[0]
    factor = np.zeros((count + BAND - 1, BAND))  # three rows of zeros come before the first
    inverse3 = inverse2 = inverse1 = 0.0  # of the diagonal in the rows before
    for i in range(count):
        k = i + BAND - 1
        third = (data[i, 3] + weight * penalty[i, 3]) * inverse3
        second = data[i, 2] + weight * penalty[i, 2] - third * factor[k - 2, 1]
        second *= inverse2
        first = data[i, 1] + weight * penalty[i, 1]
        first -= third * factor[k - 1, 2] + second * factor[k - 1, 1]
        first *= inverse1
        pivot = data[i, 0] + weight * penalty[i, 0]
        pivot -= first * first + second * second + third * third
        if not pivot > 0.0:
            factor[BAND - 1, 0] = 0.0
            break
        root = np.sqrt(pivot)
        inverse3, inverse2, inverse1 = inverse2, inverse1, 1.0 / root
        factor[k, 0], factor[k, 1], factor[k, 2], factor[k, 3] = root, first, second, third
    return factor[BAND - 1 :]


@compiled_part()
def forward_solved(factor: FloatArray, right: FloatArray) -> FloatArray:
    """Solve with the lower factor for columns of right sides, shape ``(n, k)``."""
    out = right.copy()
    for i in range(out.shape[0]):
        first, second, third = factor[i, 1], factor[i, 2], factor[i, 3]
        scale = 1.0 / factor[i, 0]
        # What lies before the first row has factors of 0.
        one, two, three = max(i - 1, 0), max(i - 2, 0), max(i - 3, 0)
        for k in range(out.shape[1]):
            left = first * out[one, k] + second * out[two, k] + third * out[three, k]
            out[i, k] = (out[i, k] - left) * scale
    return out


@compiled_part()
def backward_solved(factor: FloatArray, right: FloatArray) -> FloatArray:
    """Solve with the transposed factor."""
    out = right.copy()
    count = out.size
    for i in range(count - 1, -1, -1):
        for d in range(1, min(BAND, count - i)):
            out[i] -= factor[i + d, d] * out[i + d]
        out[i] /= factor[i, 0]
    return out


@compiled_part()
def lower_factor(square: FloatArray) -> FloatArray:
    """Lower Cholesky factor of the few terms."""
    factor = np.zeros_like(square)
    for i in range(square.shape[0]):
        for j in range(i + 1):
            total = square[i, j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            factor[i, j] = np.sqrt(max(total, 0.0)) if i == j else total / factor[j, j]
    return factor


@compiled_part()
def lower_solved(factor: FloatArray, right: FloatArray) -> FloatArray:
    """Solve with a small lower factor for columns of right sides, shape ``(m, k)``."""
    out = np.empty_like(right)
    for i in range(factor.shape[0]):
        for k in range(out.shape[1]):
            left = right[i, k]
            for j in range(i):
                left -= factor[i, j] * out[j, k]
            out[i, k] = left / factor[i, i]
    return out


@compiled_part()
def column_products(left: FloatArray, right: FloatArray) -> FloatArray:
    """Products of the columns, ``left.T @ right``."""
    out = np.zeros((left.shape[1], right.shape[1]))
    for i in range(left.shape[0]):
        for j in range(left.shape[1]):
            for k in range(right.shape[1]):
                out[j, k] += left[i, j] * right[i, k]
    return out


@compiled_part()
def log_of_diagonal(factor: FloatArray) -> float:
    """Logarithm of the product of the diagonal, in parts that do not overflow."""
    total, product = 0.0, 1.0
    for i in range(factor.shape[0]):
        product *= factor[i, 0]
        if not 1e-100 < product < 1e100:
            total += log(product)
            product = 1.0
    return total + log(product)
