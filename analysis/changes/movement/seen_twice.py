"""Whether a thing is seen at both places, as it must be to have moved.

What is gone before a plain ground seems to have come from anywhere around it: the ground that was
uncovered is found beside it. Where the other place has changed as well, what is there has come or
gone; of the rest, of before and after the one decides that has structure in the change which its
surroundings do not have: what is there must be found, at its other place, in the other photograph.
"""

from math import ceil

import numpy as np
from scipy.ndimage import map_coordinates

from analysis.changes.movement.surroundings import Surroundings
from analysis.changes.movement.trial import Images
from simulation.arrays import BoolArray, FloatArray, IntArray

_RING_PX = (2.0, 8.0)
"""Distances from the change of the surroundings with which it is compared."""

_AS_STRUCTURED = 0.7
"""A side counts that has at least so much of the structure of the other one."""

_EXPLAINED, _EXPLAINED_TOO = 0.8, 0.85
"""Share of the squared difference of the photographs that the shift has to explain, of all of a
change and of what has changed at its other place too. What moved is explained to 1.0, and less
where the pose errs; of 200 things that were put into photographs or taken out of them six have more
than 0.8 of what changed too explained, two more than 0.87, and of 100 that moved 71 and 65."""

_CHANGED_TOO, _LEAST_CHANGED = 0.3, 6
"""Share and number of a change's pixels whose other place has changed, from which those decide."""

_MARGIN_PX = 12


def is_seen_twice(
    images: Images,
    changed: BoolArray,
    places: tuple[IntArray, IntArray],
    displacement_px: FloatArray,
) -> bool:
    """Say whether what a change shows is at its other place in the other photograph.

    Parameters
    ----------
    images
        Before and after.
    changed
        Pixels of all changes.
    places
        Rows and columns of the one that is asked about.
    displacement_px
        ``(y, x)`` from before to after.
    """
    rows, cols = places
    margin = _MARGIN_PX + ceil(float(np.abs(displacement_px).max()))
    around = Surroundings.of(rows, cols, images.valid, _RING_PX, margin)
    sides = [
        np.asarray(one[around.crop], np.float64) for one in (images.before_dn, images.after_dn)
    ]
    variance = float(np.mean(np.square(images.sd_dn[rows, cols], dtype=np.float64)))
    structures = [around.structure(side) for side in sides]
    inside, marked = around.inside, changed[around.crop]
    apart = np.square(sides[1] - sides[0])[inside]
    if apart.sum() <= variance * len(rows):
        return False
    at = np.stack([rows - around.top, cols - around.left]).astype(np.float64)
    shift = displacement_px[:, np.newaxis]
    for own, other, sign in ((0, 1, 1.0), (1, 0, -1.0)):
        there = at + sign * shift
        left = np.square(
            sides[own][inside] - map_coordinates(sides[other], there, order=1, mode="nearest")
        )
        row, col = np.rint(there).astype(np.int64)
        too = marked[np.clip(row, 0, marked.shape[0] - 1), np.clip(col, 0, marked.shape[1] - 1)]
        least = _EXPLAINED_TOO
        if np.count_nonzero(too) < max(_LEAST_CHANGED, _CHANGED_TOO * len(too)):
            if structures[own] < _AS_STRUCTURED * max(structures):
                continue
            too, least = np.ones_like(too), _EXPLAINED
        noise = variance * np.count_nonzero(too)
        squares, left_over = apart[too].sum() - noise, left[too].sum() - noise
        if squares > 0 and 1 - left_over / squares >= least:
            return True
    return False
