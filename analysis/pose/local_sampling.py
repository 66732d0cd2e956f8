"""How densely a follow-up samples its reference at each point, from the homography alone."""

from dataclasses import dataclass

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.pose import project, projection_depth, projection_slopes


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LocalSampling:
    """Reference pixels per follow-up pixel at points of the follow-up, shape (rows, cols) each.

    Parameters
    ----------
    worst_zoom, best_zoom
        Along the direction that is sampled most coarsely, and most densely.
    inside
        Whether the point is within the reference.
    """

    worst_zoom: FloatArray
    best_zoom: FloatArray
    inside: BoolArray

    @property
    def anisotropy(self) -> FloatArray:
        """Worst over best zoom, at least 1."""
        return self.worst_zoom / self.best_zoom

    @property
    def overlap(self) -> float:
        """Share of the follow-up that the reference covers."""
        return float(self.inside.mean())


def local_sampling(
    matrix: FloatArray,
    followup_size: tuple[int, int],
    reference_size: tuple[int, int],
    step_px: int = 4,
) -> LocalSampling:
    """Work out the sampling at every ``step_px``-th pixel of a follow-up, its border included.

    Parameters
    ----------
    matrix
        Shape (3, 3): follow-up pixel centres ``(x, y, 1)`` to reference pixel centres.
    followup_size, reference_size
        ``(width, height)``.
    step_px
        Distance between the points; the outermost pixels are always among them.

    Raises
    ------
    ValueError
        If the horizon of the plane lies in the follow-up's frame.
    """
    width, height = followup_size
    x, y = np.meshgrid(_places(width, step_px), _places(height, step_px))
    h = np.asarray(matrix, dtype=np.float64)
    depth = projection_depth(h, x, y)
    if not (np.all(depth > 0) or np.all(depth < 0)):
        raise ValueError("the horizon of the plane is within the follow-up's frame")
    ref_x, ref_y, worst, best = sampled_places(h, x, y)
    inside = (
        (ref_x >= -0.5)
        & (ref_x <= reference_size[0] - 0.5)
        & (ref_y >= -0.5)
        & (ref_y <= reference_size[1] - 0.5)
    )
    return LocalSampling(
        worst_zoom=worst,
        best_zoom=best,
        inside=inside,
    )


def sampled_places(
    matrix: FloatArray, x: FloatArray, y: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Reference coordinates of follow-up points, and the zoom there: worst and best direction.

    Parameters
    ----------
    matrix
        Shape (..., 3, 3): follow-up pixel centres to reference pixel centres.
    x, y
        Follow-up pixels, of a shape that broadcasts against the leading axes.
    """
    h = np.moveaxis(matrix, (-2, -1), (0, 1))
    ref_x, ref_y = project(h, x, y)
    # A = d p / d u, as in docs/theory-pose.md.
    a, b, c, d = projection_slopes(h, x, y)
    # Singular values of a 2 x 2 matrix: half the sum and half the difference of two lengths.
    turning, shearing = np.hypot(a + d, c - b), np.hypot(a - d, c + b)
    return ref_x, ref_y, (turning + shearing) / 2, np.abs(turning - shearing) / 2


def _places(size: int, step_px: int) -> FloatArray:
    count = max(round((size - 1) / step_px), 1) + 1
    return np.linspace(0, size - 1, count)
