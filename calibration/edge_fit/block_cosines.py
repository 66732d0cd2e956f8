"""The cosines of blocks of 8 x 8 pixels, in which JPEG stores their levels."""

from math import pi, sqrt

import numpy as np

from simulation.arrays import FloatArray
from simulation.compiled import compiled_part

BLOCK = 8


@compiled_part()
def cosine_transform() -> FloatArray:
    """The orthonormal cosine transform of eight values, shape ``(8, 8)``, by rising frequency."""
    matrix = np.empty((BLOCK, BLOCK))
    for k in range(BLOCK):
        scale = sqrt((1.0 if k == 0 else 2.0) / BLOCK)
        for n in range(BLOCK):
            matrix[k, n] = scale * np.cos(pi * (2 * n + 1) * k / (2 * BLOCK))
    return matrix


@compiled_part()
def put_cosines(transform: FloatArray, block: FloatArray) -> None:
    """Put the cosines of a block of 64 values, row by row, in their place."""
    by_row = np.zeros(BLOCK**2)
    for k in range(BLOCK):
        for m in range(BLOCK):
            for n in range(BLOCK):
                by_row[k * BLOCK + n] += transform[k, m] * block[m * BLOCK + n]
    for k in range(BLOCK):
        for n in range(BLOCK):
            total = 0.0
            for m in range(BLOCK):
                total += by_row[k * BLOCK + m] * transform[n, m]
            block[k * BLOCK + n] = total
