"""How far JPEG compression moves an edge's MTF50: it is compressed again and again.

A parametric bootstrap (Efron and Tibshirani, "An introduction to the bootstrap", 1993, chapter 6):
the edge is put where it lies in its blocks, with fresh noise as before compression, and measured
both before and after compression with the photograph's own steps. What the two differ by, its mean
as well as its scatter, is what compression does there. Of two profiles, each of which is the edge
but for one thing: the measured one has lost detail already, and the fitted one, which is that
before compression, is a Gaussian.
"""

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from math import ceil, cos, floor, log, sin, sqrt
from typing import NamedTuple

import numpy as np

from calibration.edges._esfr import EdgeSfr, esfr_half_width_px, measure_esfr
from calibration.edges._fit import EVEN_CODE, EdgeFit, JpegCompression
from calibration.edges._model import edge_shape
from calibration.edges._rounded import BLOCK, cosine_transform
from calibration.edges._samples import bin_edge, edge_samples, shape_values
from calibration.edges._segments import EdgeSegment
from simulation.arrays import FloatArray

_DRAWS = 8
_LONGEST_PX = 64.0  # of the edge: what is lost in blocks further along scatters alike
_LEAST_NOISE = sqrt(1 / 12)  # of codes, before compression: their own rounding
_PROFILE_STEP_PX = 0.05
_UNKNOWN = 1.0  # relative error of MTF50 where compression often leaves none
_SEED = 1
_TRANSFORM = cosine_transform()


def compressed_codes(codes: FloatArray, compression: JpegCompression) -> FloatArray:
    """Codes as the file gives them back, shape ``(8 m, 8 n)``; blocks begin at the first one.

    ITU-T T.81 (1992), A.3.3 and A.3.4.
    """
    rows, cols = codes.shape
    blocks = codes.reshape(rows // BLOCK, BLOCK, cols // BLOCK, BLOCK).swapaxes(1, 2)
    cosines = _TRANSFORM @ (blocks - EVEN_CODE) @ _TRANSFORM.T
    kept = np.rint(cosines / compression.steps) * compression.steps
    decoded = _TRANSFORM.T @ kept @ _TRANSFORM + EVEN_CODE
    return np.clip(np.rint(decoded), 0, 255).swapaxes(1, 2).reshape(rows, cols)


def mtf50_error_behind(
    compression: JpegCompression, segment: EdgeSegment, fit: EdgeFit, esfr: EdgeSfr
) -> float:
    """Relative error of an edge's MTF50, with what noise and its shape leave open."""
    length_px = min(segment.length_px, _LONGEST_PX)
    shorter = length_px / segment.length_px
    piece = replace(segment, length_px=length_px)
    shape = edge_shape(fit.sigma_px, fit.optical_sigma_px, fit.normal_rad)
    rng = np.random.default_rng(_SEED)
    measured, fitted = (
        _changes(_ProfiledEdge(compression, piece, fit, profile), compression, rng)
        for profile in (esfr.esf, partial(shape_values, shape))
    )
    if measured is None or fitted is None:
        return _UNKNOWN
    mean = max(abs(measured.mean), abs(fitted.mean))
    return sqrt(mean**2 + shorter * 0.5 * (measured.variance + fitted.variance))


class _Changes(NamedTuple):
    """What compression changes log MTF50 by, and its variance with that of noise and shape."""

    mean: float
    variance: float


def _changes(
    edge: "_ProfiledEdge", compression: JpegCompression, rng: np.random.Generator
) -> _Changes | None:
    changes, variances = [], []
    for _ in range(_DRAWS):
        codes = edge.noisy(rng)
        before = edge.mtf50(codes)
        after = edge.mtf50(compressed_codes(codes, compression))
        if before is not None and after is not None:
            changes.append(log(after[0] / before[0]))
            variances.append((before[1] / before[0]) ** 2)
    several = len(changes)
    if several <= _DRAWS // 2:
        return None
    # Of so few draws the scatter itself is uncertain, as Student's t is wider than a Gaussian.
    scatter = np.var(changes, ddof=1) * (several - 1) / (several - 3)
    return _Changes(float(np.mean(changes)), float(np.mean(variances) + scatter))


class _ProfiledEdge:
    """The whole blocks about a piece of an edge, with a profile of it and its noise."""

    def __init__(
        self,
        compression: JpegCompression,
        piece: EdgeSegment,
        fit: EdgeFit,
        profile: Callable[[FloatArray], FloatArray],
    ) -> None:
        self._half_width_px = min(esfr_half_width_px(fit.sigma_px), piece.clearance_px)
        c, s = cos(fit.normal_rad), sin(fit.normal_rad)
        across, along = self._half_width_px, 0.5 * piece.length_px
        left, right = _whole_blocks(
            fit.x_px, across * abs(c) + along * abs(s), compression.first_col
        )
        top, bottom = _whole_blocks(
            fit.y_px, across * abs(s) + along * abs(c), compression.first_row
        )
        y, x = np.mgrid[top:bottom, left:right]
        dx, dy = x - fit.x_px, y - fit.y_px
        # The fit knows its normal modulo pi, the segment which side is bright.
        side = np.sign(cos(fit.normal_rad - piece.normal_rad))
        away = side * (c * dx + s * dy) - 0.5 * fit.curvature_per_px * (c * dy - s * dx) ** 2
        reach = self._half_width_px
        distance = np.arange(-reach, reach, _PROFILE_STEP_PX)
        bright = np.interp(away, distance, profile(distance))
        self._levels_dn, every = compression.code_levels_dn, np.arange(256.0)
        levels_dn = fit.low_dn + (fit.high_dn - fit.low_dn) * bright
        self._codes = np.interp(levels_dn, self._levels_dn, every)
        noise = fit.noise_codes
        if noise is None:
            low, high = np.interp((fit.low_dn, fit.high_dn), self._levels_dn, every)
            noise = fit.noise_dn * abs((high - low) / (fit.high_dn - fit.low_dn))
        self._noise = max(noise, _LEAST_NOISE)
        self._fit = fit.moved(-left, -top)
        self._piece = replace(piece, x_px=piece.x_px - left, y_px=piece.y_px - top)

    def noisy(self, rng: np.random.Generator) -> FloatArray:
        """Codes with fresh noise, rounded."""
        noise = self._noise * rng.standard_normal(self._codes.shape)
        return np.asarray(np.clip(np.rint(self._codes + noise), 0, 255))

    def mtf50(self, codes: FloatArray) -> tuple[float, float] | None:
        """MTF50 of these codes and its error, measured as the photograph's; None without one."""
        image_dn = self._levels_dn[codes.astype(np.intp)]
        samples = edge_samples(image_dn, self._piece, self._fit, self._half_width_px)
        binned = bin_edge(samples, self._fit)
        esfr = None if binned is None else measure_esfr(binned)
        if esfr is None or esfr.mtf50_cy_per_px is None or esfr.mtf50_err_cy_per_px is None:
            return None
        return esfr.mtf50_cy_per_px, esfr.mtf50_err_cy_per_px


def _whole_blocks(middle_px: float, reach_px: float, first: int) -> tuple[int, int]:
    """First pixel, and the one after the last, of the whole blocks that hold a stretch."""
    low = floor((middle_px - reach_px + first) / BLOCK) * BLOCK - first
    return low, ceil((middle_px + reach_px + 1 + first) / BLOCK) * BLOCK - first
