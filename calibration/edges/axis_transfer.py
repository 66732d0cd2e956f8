"""Contrast by frequency along x and y: what the edges of one direction have in common."""

from collections.abc import Sequence
from math import pi, sqrt
from typing import Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from calibration.edges.esfr import EdgeSfr
from calibration.robust import robust_sigma
from simulation.arrays import FloatArray

_MEDIAN_ERR = sqrt(pi / 2)  # standard error of a median over that of a mean, Gaussian scatter
_FEWEST_FOR_SCATTER = 4
_ENOUGH_FOR_NOISE = 64  # edges: their mean square error is that of all within some per cent

TRANSFER_FREQ_CY_PER_PX = np.linspace(0.0, 1.0, 51)
"""Frequencies at which the transfer is stored; beyond Nyquist for the aliased part."""


class AxisTransfer(BaseModel):
    """Contrast by frequency along one axis, lens and pixel together, from ``edges`` edges.

    ``mtf_err`` are standard errors at each frequency; None in files of before.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    freq_cy_per_px: tuple[float, ...] = Field(repr=False)
    mtf: tuple[float, ...] = Field(repr=False)
    edges: int | None = None
    mtf_err: tuple[float, ...] | None = Field(default=None, repr=False)

    @model_validator(mode="after")
    def _check(self) -> Self:
        count = len(self.freq_cy_per_px)
        for name, values in (("mtf", self.mtf), ("mtf_err", self.mtf_err)):
            if values is not None and len(values) != count:
                raise ValueError(f"{name} must have {count} numbers, as freq_cy_per_px")
        return self


class MeasuredTransfer(BaseModel):
    """Transfer along x (from vertical edges) and y (horizontal ones); None without edges."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    x: AxisTransfer | None = None
    y: AxisTransfer | None = None


def mean_transfer(edges: Sequence[EdgeSfr]) -> AxisTransfer | None:
    """Return the median over edges at each frequency; None where there is no edge.

    The part in phase with the edge is taken: noise is positive and negative in it and cancels,
    while a modulus would pile it up where little contrast is left.
    """
    if not edges:
        return None
    curves = np.array([edge.transform(TRANSFER_FREQ_CY_PER_PX).real for edge in edges])
    mtf = np.maximum(np.median(curves, axis=0), 0.0)
    return AxisTransfer(
        freq_cy_per_px=tuple(round(freq, 6) for freq in TRANSFER_FREQ_CY_PER_PX.tolist()),
        mtf=tuple(mtf.tolist()),
        edges=len(edges),
        mtf_err=tuple(_median_err(edges, curves).tolist()),
    )


def _median_err(edges: Sequence[EdgeSfr], curves: FloatArray) -> FloatArray:
    """Standard error of the median: from the pixels' noise, or the edges' scatter if that is more.

    The scatter of few edges is no measure: up to three, noise alone counts.
    """
    count = len(edges)
    some = edges[:: max(count // _ENOUGH_FOR_NOISE, 1)]
    errs = np.array([edge.transform_err(TRANSFER_FREQ_CY_PER_PX) for edge in some])
    share = 1.0 if count < 3 else _MEDIAN_ERR
    noise = share * np.sqrt(np.mean(errs**2, axis=0) / count)
    if count < _FEWEST_FOR_SCATTER:
        return np.asarray(noise)
    away = curves - np.median(curves, axis=0)
    scatter = np.array([robust_sigma(column) for column in away.T])
    return np.asarray(np.maximum(noise, _MEDIAN_ERR * scatter / sqrt(count)))
