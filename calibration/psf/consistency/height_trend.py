"""Does the width of the PSF change with the camera's height? A test for focus drift."""

from math import sqrt

import numpy as np
from pydantic import BaseModel, ConfigDict
from scipy.special import fdtrc, stdtr

from calibration.psf.repeatability import excess_variance
from simulation.arrays import FloatArray

_DRIFT_P = 0.01
_DRIFT_LEAST = 0.01  # relative change over the range of heights
_FEWEST_FREEDOM = 3


class HeightGroup(BaseModel):
    """Width at one height, relative to the calibration as a whole in the same direction.

    ``sigma_x_px`` and ``sigma_y_px`` are medians over its vertical and horizontal edges.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    height_mm: float
    edges: int
    relative_width: float
    relative_width_err: float
    sigma_x_px: float | None = None
    sigma_x_err_px: float | None = None
    sigma_y_px: float | None = None
    sigma_y_err_px: float | None = None


class HeightTrend(BaseModel):
    """Weighted straight line through the relative widths, and a test of any difference by height.

    ``p_value`` is that of the slope, two-sided; ``p_value_between`` is that of any difference
    between the heights, including a bend through best focus. ``is_drift`` says whether the
    change is significant (p below 0.01) and large enough to report (over 1 %).
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    slope_per_mm: float
    slope_err_per_mm: float
    p_value: float
    p_value_between: float
    is_drift: bool
    heights: tuple[HeightGroup, ...]

    @property
    def change(self) -> float:
        """Largest relative difference between two heights."""
        widths = [group.relative_width for group in self.heights]
        return max(widths) - min(widths)


def fit_height_trend(
    height_mm: FloatArray, relative_width: FloatArray, relative_width_err: FloatArray
) -> HeightTrend | None:
    """Fit a line to widths over heights.

    Parameters
    ----------
    height_mm
        Height of the camera for each edge, shape ``(n,)``.
    relative_width, relative_width_err
        Width across each edge divided by the width that the calibration predicts; same shape.

    Returns
    -------
    HeightTrend or None
        None with fewer than two heights, or too few edges to estimate their scatter.
    """
    heights = np.unique(height_mm)
    freedom = height_mm.size - heights.size
    if heights.size < 2 or freedom < _FEWEST_FREEDOM:
        return None
    group = np.searchsorted(heights, height_mm)
    # The scatter of edges at one height beyond their errors is part of every error here.
    plain = np.bincount(group, relative_width) / np.bincount(group)
    scatter2 = excess_variance(
        relative_width - plain[group], relative_width_err, np.ones(group.size), freedom
    )
    weight = 1.0 / (relative_width_err**2 + scatter2)
    group_weight = np.bincount(group, weight)
    means = np.bincount(group, weight * relative_width) / group_weight
    centre = float(np.average(heights, weights=group_weight))
    middle = float(np.average(means, weights=group_weight))
    power = float(np.sum(group_weight * (heights - centre) ** 2))
    slope = float(np.sum(group_weight * (heights - centre) * (means - middle))) / power
    slope_err = 1.0 / sqrt(power)
    extra = heights.size - 1
    between = float(np.sum(group_weight * (means - middle) ** 2)) / extra
    p_value = float(2 * stdtr(freedom, -abs(slope) / slope_err))
    p_value_between = float(fdtrc(extra, freedom, between))
    is_sure = min(p_value, p_value_between) < _DRIFT_P
    return HeightTrend(
        slope_per_mm=slope,
        slope_err_per_mm=slope_err,
        p_value=p_value,
        p_value_between=p_value_between,
        is_drift=is_sure and float(np.ptp(means)) > _DRIFT_LEAST,
        heights=tuple(
            HeightGroup(
                height_mm=float(height),
                edges=int(np.count_nonzero(group == k)),
                relative_width=float(means[k]),
                relative_width_err=1.0 / sqrt(float(group_weight[k])),
            )
            for k, height in enumerate(heights)
        ),
    )
