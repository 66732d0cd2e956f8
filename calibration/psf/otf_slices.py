"""Edges through a transfer function: levels by distance, with their derivatives.

By the projection-slice theorem the profile across an edge with unit normal n is
``E(d) = 1/2 + integral_0^inf H(f n) sin(2 pi f d) / (pi f) df``, H real and signed. The integral is
a sum over Gauss-Legendre nodes, the same for all edges, and all edges share their bins: the sines
are one matrix, and one product of matrices compares a transfer function with every pixel.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, pi

import numpy as np

from calibration.edges import BinnedEdge, bin_centres_px
from simulation.arrays import FloatArray
from simulation.psf import correction_splines, pupil_slopes

_PANEL_NODES = 32
_PANEL_TURN_RAD = 34.0  # of the fastest sine, half a panel: the rule is then right to 1e-8
_SHARPEST_CY_PER_PX = 8.0
_LEAST_CY_PER_PX = 1.6  # a correction reaches to 1.3
_CY_OVER_SIGMA = 2.5  # a Gaussian of that width is 1e-53 there, a lens has passed its cut-off
SLICE_TERMS = 3
"""Derivatives of a slice: by the period of cut-off, the squared defocus, the Gaussian variance."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Slices:
    """What a lens passes along each edge's normal; shape ``(edges,)`` each.

    ``period_px`` is ``|B n|``, ``variance_px2`` is ``n^T S n``; ``defocus_waves2`` is the square of
    the defocus. ``correction`` has shape ``(edges, CORRECTION_SPLINES)``, None for none.
    """

    period_px: FloatArray
    defocus_waves2: float
    variance_px2: FloatArray
    correction: FloatArray | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Residuals:
    """What a transfer function leaves of the levels, each edge's own levels and place fitted.

    ``values`` has shape ``(edges, bins)``, in standard deviations; ``slopes``, shape ``(edges,
    bins, SLICE_TERMS)`` or with the splines of the correction after them, are minus their
    derivatives, empty where not asked for.
    """

    values: FloatArray
    slopes: FloatArray

    @property
    def squares(self) -> float:
        """Sum of the squares: chi-squared."""
        return float(np.sum(self.values**2))


class EdgeStack:
    """Binned edges that are fitted together, with the matrix that all their profiles share."""

    def __init__(self, edges: Sequence[BinnedEdge]) -> None:
        first = min(int(edge.bin_index[0]) for edge in edges)
        last = max(int(edge.bin_index[-1]) for edge in edges)
        distance = bin_centres_px(np.arange(first, last + 1))
        sharpest = min(edge.sigma_px for edge in edges)
        # The pixel alone has a width of 0.29 px.
        lens = np.sqrt(max(sharpest**2 - 1 / 12, 0.01))
        freq_end = float(np.clip(_CY_OVER_SIGMA / lens, _LEAST_CY_PER_PX, _SHARPEST_CY_PER_PX))
        self.freq, weight = _quadrature(freq_end, float(np.max(np.abs(distance))))
        self.normal_rad = np.array([edge.normal_rad for edge in edges])
        self.shape = (len(edges), distance.size)
        self._sines = np.sin(2 * pi * np.outer(distance, self.freq))
        cosine, sine = np.cos(self.normal_rad), np.sin(self.normal_rad)
        square = np.sinc(np.outer(self.freq, cosine)) * np.sinc(np.outer(self.freq, sine))
        self._pixel = square * (weight / (pi * self.freq))[:, None]
        self._splines: FloatArray | None = None
        self.root_weight = np.zeros(self.shape)
        self._level = np.zeros(self.shape)
        shift = np.zeros(self.shape)
        for k, edge in enumerate(edges):
            at = edge.bin_index - first
            self.root_weight[k, at] = np.sqrt(edge.weights)
            self._level[k, at] = edge.levels
            shift[k] = np.exp(-0.5 * (distance / edge.sigma_px) ** 2)
        self._level *= self.root_weight
        self._shift = shift * self.root_weight
        self.bins = int(np.count_nonzero(self.root_weight))

    def residuals(
        self, slices: Slices, *, with_slopes: bool = True, with_splines: bool = False
    ) -> Residuals:
        """Compare the levels with those of a lens."""
        columns = self._columns(slices, with_slopes=with_slopes)
        edges, bins = self.shape
        products = (self._sines @ columns.reshape(self.freq.size, -1)).reshape(bins, edges, -1)
        terms = products.transpose(1, 0, 2) * self.root_weight[:, :, None]
        rise = terms[:, :, 0] + 0.5 * self.root_weight
        own = np.stack([self.root_weight, rise, self._shift], axis=-1)
        # The levels and the place of each edge are fitted by a projection.
        basis, triangle = np.linalg.qr(own)
        along = basis.transpose(0, 2, 1) @ self._level[:, :, None]
        contrast = np.linalg.solve(triangle, along)[:, 1]
        values = self._level - (basis @ along)[:, :, 0]
        if not with_slopes:
            return Residuals(values=values, slopes=np.empty((edges, bins, 0)))
        slopes = terms[:, :, 1:]
        if with_splines:
            splines = self._spline_profiles() * self.root_weight[:, :, None]
            slopes = np.concatenate([slopes, splines], axis=2)
        slopes = slopes * contrast[:, None]
        slopes = slopes - basis @ (basis.transpose(0, 2, 1) @ slopes)
        return Residuals(values=values, slopes=slopes)

    def _columns(self, slices: Slices, *, with_slopes: bool) -> FloatArray:
        """Amplitudes of the sines: of the profiles, then of their derivatives."""
        freq = self.freq[:, None]
        gauss = self._pixel * np.exp(-2 * pi**2 * freq**2 * slices.variance_px2)
        pupil = pupil_slopes(freq * slices.period_px, slices.defocus_waves2)
        profile = gauss * pupil.otf
        by_variance = -2 * pi**2 * freq**2 * profile
        if slices.correction is not None:
            profile = profile + self._pixel * (correction_splines(self.freq) @ slices.correction.T)
        if not with_slopes:
            return profile[:, :, None]
        by_period = gauss * pupil.by_freq * freq
        by_defocus = gauss * pupil.by_defocus_waves2
        return np.stack([profile, by_period, by_defocus, by_variance], axis=-1)

    def _spline_profiles(self) -> FloatArray:
        """Profile of each spline of the correction on each edge, shape (edges, bins, splines)."""
        if self._splines is None:
            radial = correction_splines(self.freq)
            edges, bins = self.shape
            columns = self._pixel[:, :, None] * radial[:, None, :]
            products = self._sines @ columns.reshape(self.freq.size, -1)
            self._splines = products.reshape(bins, edges, -1).transpose(1, 0, 2)
        return self._splines


def _quadrature(freq_end: float, reach_px: float) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights from 0 to a frequency for sines of up to ``reach_px``."""
    panels = max(ceil(pi * reach_px * freq_end / _PANEL_TURN_RAD), 2)
    node, weight = np.polynomial.legendre.leggauss(_PANEL_NODES)
    width = freq_end / panels
    start = width * np.arange(panels)
    freq = start[:, None] + width * (node + 1) / 2
    return freq.ravel(), np.tile(weight * width / 2, panels)
