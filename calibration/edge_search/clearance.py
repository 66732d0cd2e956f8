"""How near other edges come to an edge, and the stretches of it that they leave clear."""

from math import cos, sin

import numpy as np

from calibration.edge_search.segments import EdgeLine
from simulation.arrays import FloatArray, IntArray
from simulation.compiled import compiled


@compiled()
def nearest_others(
    points: FloatArray, line: EdgeLine, own_px: float, reach_px: float
) -> FloatArray:
    """Distance to the nearest ridge beside an edge that is not its own, in steps along it.

    Parameters
    ----------
    points
        Shape ``(n, 2)``: x and y of ridge pixels, from top to bottom.
    line
        The edge.
    own_px, reach_px
        Ridges nearer than the first belong to the edge; those farther than the second are not
        looked for.

    Returns
    -------
    ndarray of float64
        One distance in px per px of the edge's length; infinite where there is nothing.
    """
    c, s = cos(line.normal_rad), sin(line.normal_rad)
    length = 2.0 * line.half_length_px
    count = max(int(np.ceil(length)), 1)
    nearest = np.full(count, np.inf)
    reach_x = reach_px * abs(c) + line.half_length_px * abs(s)
    reach_y = reach_px * abs(s) + line.half_length_px * abs(c)
    for i in range(np.searchsorted(points[:, 1], line.y_px - reach_y), len(points)):
        dx, dy = points[i, 0] - line.x_px, points[i, 1] - line.y_px
        if dy > reach_y:
            break
        if abs(dx) > reach_x:
            continue
        across, along = abs(c * dx + s * dy), -s * dx + c * dy
        if across <= own_px or across > reach_px or abs(along) > line.half_length_px:
            continue
        k = min(int((along + line.half_length_px) / length * count), count - 1)
        nearest[k] = min(nearest[k], across)
    return nearest


@compiled()
def clear_stretches(nearest: FloatArray, least_px: float, margin_steps: int) -> IntArray:
    """First and last step of each stretch with nothing nearer than ``least_px``.

    ``nearest`` is as from ``nearest_others``; a stretch ends ``margin_steps`` before what is too
    near. Returned is an array of shape ``(stretches, 2)``.
    """
    count = len(nearest)
    stretches = np.empty((count + 1, 2), np.int64)
    found, first, blocked = 0, 0, -1
    for k in range(count + 1):
        if k < count and nearest[k] >= least_px:
            continue
        last = k - 1 - margin_steps if k < count else count - 1
        first = 0 if blocked < 0 else blocked + 1 + margin_steps
        if last >= first:
            stretches[found] = first, last
            found += 1
        blocked = k
    return stretches[:found]
