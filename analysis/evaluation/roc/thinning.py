"""Points of a curve that a figure needs: its corners, and no more than can be told apart."""

import numpy as np

from simulation.arrays import FloatArray, IntArray

MOST_POINTS = 400


def needed_points(across: FloatArray, up: FloatArray) -> IntArray:
    """Indices of the points to keep of a curve that nowhere falls; the first and last among them.

    Points on a straight line between two others are dropped, which changes nothing. If more than
    ``MOST_POINTS`` are left, one is kept per step of ``2 / (MOST_POINTS - 2)`` in the sum of both
    coordinates, each as a share of its largest: no point is then further than that from the curve.

    Parameters
    ----------
    across, up
        Shape (n,), at least one point, neither falling.
    """
    steps = np.stack([np.diff(across), np.diff(up)])
    cross = steps[0, :-1] * steps[1, 1:] - steps[0, 1:] * steps[1, :-1]
    # Counts over counts: what is straight crosses by rounding alone.
    scale = np.linalg.norm(steps[:, :-1], axis=0) * np.linalg.norm(steps[:, 1:], axis=0)
    is_corner = np.ones(across.size, dtype=np.bool_)
    is_corner[1:-1] = np.abs(cross) > 1e-9 * scale
    kept = np.flatnonzero(is_corner).astype(np.int64)
    if kept.size <= MOST_POINTS:
        return kept
    shares = [each[kept] / max(float(each[-1]), np.finfo(float).tiny) for each in (across, up)]
    cell = np.floor((shares[0] + shares[1]) * ((MOST_POINTS - 2) / 2))
    is_first = np.ones(kept.size, dtype=np.bool_)
    is_first[1:-1] = np.diff(cell[:-1]) > 0
    return kept[is_first]
