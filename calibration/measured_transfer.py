"""The camera's transfer function along both axes as edges show it, no Gaussian assumed."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calibration.esfr import EdgeSfr

__all__ = ["TRANSFER_FREQ_CY_PER_PX", "AxisTransfer", "MeasuredTransfer", "mean_transfer"]

Array = NDArray[np.float64]

TRANSFER_FREQ_CY_PER_PX = np.linspace(0.0, 1.0, 51)
"""Frequencies at which the transfer is kept; beyond Nyquist for the aliased part."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class AxisTransfer:
    """Contrast by frequency along one axis, lens and pixel together, from ``edges`` edges."""

    freq_cy_per_px: Array
    mtf: Array
    edges: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredTransfer:
    """Transfer along x (from vertical edges) and y (horizontal ones); None without edges."""

    x: AxisTransfer | None
    y: AxisTransfer | None


def mean_transfer(edges: Sequence[EdgeSfr]) -> AxisTransfer | None:
    """Return the median over edges at each frequency; None where there is no edge.

    The part in phase with the edge is taken: noise is positive and negative in it and cancels,
    while a modulus would pile it up where little contrast is left.
    """
    if not edges:
        return None
    curves = np.array([edge.transform(TRANSFER_FREQ_CY_PER_PX).real for edge in edges])
    mtf = np.maximum(np.median(curves, axis=0), 0.0)
    return AxisTransfer(freq_cy_per_px=TRANSFER_FREQ_CY_PER_PX, mtf=mtf, edges=len(edges))
