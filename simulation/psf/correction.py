"""What edges show of a lens beyond its parametric transfer function: radial splines, harmonics."""

from dataclasses import dataclass
from functools import cache
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from simulation.arrays import FloatArray

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

CORRECTION_KNOTS_CY_PER_PX = np.array(
    [0.0, 0.05, 0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0, 1.1, 1.2, 1.3]
)
"""Dense where a halo shows; above the last, edges are lost in noise."""

CORRECTION_SPLINES = len(CORRECTION_KNOTS_CY_PER_PX) - 2
"""Cubic splines that are 0 at the first knot and, with two derivatives, at the last."""

CORRECTION_HARMONICS = (1, 3, 5)
"""How many of 1, cos 2a, sin 2a, cos 4a and sin 4a there may be."""


@cache
def _splines() -> "BSpline":
    from scipy.interpolate import BSpline  # .2 s, where edges show more than a lens

    # The first knot fourfold: the first spline is 1 there, and has no weight. Beyond the last one
    # there must be three more; the splines that reach there have no weight either.
    return BSpline(
        np.concatenate([np.zeros(3), CORRECTION_KNOTS_CY_PER_PX, [1.4, 1.5, 1.6]]),
        np.eye(CORRECTION_SPLINES + 4)[:, 1:-3],
        3,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class OtfCorrection:
    """A part of a transfer function that is added to a parametric one; 0 at frequency 0.

    ``sum_m T_m(a) sum_j c_mj B_j(|f|)`` with the angle a of the frequency, the harmonics T_m and
    cubic B-splines B_j over ``CORRECTION_KNOTS_CY_PER_PX``.

    Parameters
    ----------
    coefficients
        A row for each harmonic, with ``CORRECTION_SPLINES`` numbers each.

    Raises
    ------
    ValueError
        If the rows are not as many or not as long as they may be, or a number is not finite.
    """

    coefficients: tuple[tuple[float, ...], ...]

    def __post_init__(self) -> None:
        rows = self.coefficients
        if len(rows) not in CORRECTION_HARMONICS or {len(r) for r in rows} != {CORRECTION_SPLINES}:
            raise ValueError(
                f"a correction has 1, 3 or 5 rows of {CORRECTION_SPLINES} coefficients, "
                f"got rows of {[len(row) for row in rows]}"
            )
        if not all(isfinite(value) for row in rows for value in row):
            raise ValueError("the coefficients of a correction must be finite")

    def __repr__(self) -> str:
        return f"OtfCorrection({len(self.coefficients)} x {CORRECTION_SPLINES} coefficients)"

    def __call__(self, fx_cy_per_px: FloatArray, fy_cy_per_px: FloatArray) -> FloatArray:
        """Return the correction at frequencies in cycles per pixel; the two are broadcast."""
        fx, fy = np.asarray(fx_cy_per_px), np.asarray(fy_cy_per_px)
        radial = correction_splines(np.hypot(fx, fy)) @ np.array(self.coefficients).T
        angular = correction_harmonics(np.arctan2(fy, fx), len(self.coefficients))
        return np.asarray(np.sum(radial * angular, axis=-1))


def correction_splines(freq_cy_per_px: FloatArray) -> FloatArray:
    """Values of the radial splines, shape ``(..., CORRECTION_SPLINES)``; 0 beyond the knots."""
    freq = np.asarray(freq_cy_per_px, dtype=np.float64)
    first, last = CORRECTION_KNOTS_CY_PER_PX[[0, -1]]
    return np.asarray(_splines()(np.clip(freq, first, last)))


def correction_roughness() -> FloatArray:
    """Integrals of the products of the splines' second derivatives, as a matrix."""
    node, weight = np.polynomial.legendre.leggauss(2)  # exact for products of straight lines
    widths = np.diff(CORRECTION_KNOTS_CY_PER_PX)[:, None]
    freq = CORRECTION_KNOTS_CY_PER_PX[:-1, None] + widths * (node + 1) / 2
    bend = _splines()(freq.ravel(), 2)
    return np.asarray((bend * (widths * weight / 2).reshape(-1, 1)).T @ bend)


def correction_harmonics(angle_rad: FloatArray, count: int) -> FloatArray:
    """Values of the first ``count`` harmonics of angles, shape ``(..., count)``."""
    angle = np.asarray(angle_rad, dtype=np.float64)
    turns = [np.ones_like(angle)]
    for order in (2, 4)[: count // 2]:
        turns += [np.cos(order * angle), np.sin(order * angle)]
    return np.stack(turns, axis=-1)
