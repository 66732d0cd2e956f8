"""Edges through a transfer function: levels by distance, with their derivatives.

By the projection-slice theorem the profile across an edge with unit normal n is
``E(d) = 1/2 + integral_0^inf H(f n) sin(2 pi f d) / (pi f) df``, H real and signed. The integral is
a sum over Gauss-Legendre nodes, the same for all edges, and all edges share their bins: the sines
are one matrix, and one product of matrices compares a transfer function with every pixel. From the
centre of a bin to the mean distance of its pixels, at most 1/32 px at the edge, the profile is
continued by its first two derivatives.
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
_ABSENT = 1e-9
# A place 0.02 px off bends a profile by up to 5e-4 of the contrast; one of 0.3 px is no edge.
_LEAST_MOVE_PX, _MOST_MOVE_PX = 0.02, 0.3
SLICE_TERMS = 3
"""Derivatives of a slice: by the period of cut-off, the squared defocus, the Gaussian variance."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Slices:
    """What a lens passes along each edge's normal; shape ``(edges,)`` each.

    ``period_px`` is ``|B n|``, ``variance_px2`` is ``n^T S n``; ``defocus_waves2`` is the square of
    the defocus. ``correction`` has shape ``(edges, CORRECTION_SPLINES)``, None for none. Without
    ``has_pixel`` they are of the total transfer, and no pixel comes on top.
    """

    period_px: FloatArray
    defocus_waves2: float
    variance_px2: FloatArray
    correction: FloatArray | None = None
    has_pixel: bool = True


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Residuals:
    """What a transfer function leaves of the levels, each edge's own levels and place fitted.

    ``values`` has shape ``(edges, bins)``, in standard deviations; ``slopes``, shape ``(edges,
    bins, SLICE_TERMS)`` or with the splines of the correction after them, are minus their
    derivatives, empty where not asked for. ``shift_px``, shape ``(edges, 3)``, is how much nearer
    the edge is than its bins say: in the middle, and with the place along it and its square, which
    are 1 at the end.
    """

    values: FloatArray
    slopes: FloatArray
    shift_px: FloatArray

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
        self._turn = 2 * pi * self.freq[:, None]
        self._sines = np.sin(distance[:, None] * self._turn.T)
        self._cosines = np.cos(distance[:, None] * self._turn.T)
        cosine, sine = np.cos(self.normal_rad), np.sin(self.normal_rad)
        square = np.sinc(np.outer(self.freq, cosine)) * np.sinc(np.outer(self.freq, sine))
        self._weight = (weight / (pi * self.freq))[:, None]
        self._pixel = square * self._weight
        self._splines: FloatArray | None = None
        self.root_weight = np.zeros(self.shape)
        self._level = np.zeros(self.shape)
        self._away = np.zeros(self.shape)
        self._along = np.zeros(self.shape)
        for k, edge in enumerate(edges):
            at = edge.bin_index - first
            self.root_weight[k, at] = np.sqrt(edge.weights)
            self._level[k, at] = edge.levels
            self._away[k, at] = edge.away_px
            self._along[k, at] = edge.along_px / max(float(np.abs(edge.along_px).max()), 1.0)
        self._level *= self.root_weight
        self.bins = int(np.count_nonzero(self.root_weight))

    def residuals(
        self, slices: Slices, *, with_slopes: bool = True, with_splines: bool = False
    ) -> Residuals:
        """Compare the levels with those of a lens."""
        columns = self._columns(slices, with_slopes=with_slopes)
        edges, bins = self.shape
        products = (self._sines @ columns.reshape(self.freq.size, -1)).reshape(bins, edges, -1)
        terms = products.transpose(1, 0, 2) * self.root_weight[:, :, None]
        more, slope = self._continued(columns[:, :, 0])
        rise = terms[:, :, 0] + (0.5 + more) * self.root_weight
        slope = slope * self.root_weight
        places = [slope, slope * self._along, slope * self._along**2]
        # The levels, the place, the angle and the bend of each edge are fitted by a projection.
        own = np.stack([self.root_weight, rise, *places], axis=-1)
        basis, triangle = _orthonormal(own)
        along = basis.transpose(0, 2, 1) @ self._level[:, :, None]
        fitted = np.linalg.solve(triangle, along)
        contrast, shift = fitted[:, 1], fitted[:, 2:, 0] / fitted[:, 1]
        values = self._level - (basis @ along)[:, :, 0]
        if not with_slopes:
            return Residuals(values=values, slopes=np.empty((edges, bins, 0)), shift_px=shift)
        slopes = terms[:, :, 1:]
        if with_splines:
            splines = self._spline_profiles() * self.root_weight[:, :, None]
            slopes = np.concatenate([slopes, splines], axis=2)
        slopes = slopes * contrast[:, None]
        slopes = slopes - basis @ (basis.transpose(0, 2, 1) @ slopes)
        return Residuals(values=values, slopes=slopes, shift_px=shift)

    def aligned(self, shift_px: FloatArray) -> bool:
        """Move the bins by what residuals say; whether that was worth it.

        The Gaussian that found an edge gives it a wrong angle where the lens is sharp and the edge
        nearly along the rows: its misfit at a few distances looks like a slope.
        """
        powers = np.stack([np.ones(self.shape), self._along, self._along**2], axis=-1)
        moved = (powers @ shift_px[:, :, None])[:, :, 0] * (self.root_weight > 0)
        if not _LEAST_MOVE_PX < np.abs(moved).max() < _MOST_MOVE_PX:
            return False
        self._away += moved
        self._splines = None
        return True

    def _columns(self, slices: Slices, *, with_slopes: bool) -> FloatArray:
        """Amplitudes of the sines: of the profiles, then of their derivatives."""
        freq = self.freq[:, None]
        aperture = self._pixel if slices.has_pixel else self._weight
        gauss = aperture * np.exp(-2 * pi**2 * freq**2 * slices.variance_px2)
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

    def _continued(self, profile: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What profiles rise by from the bins' centres to the means, and their slope there."""
        slope = (self._cosines @ (self._turn * profile)).T
        bend = -(self._sines @ (self._turn**2 * profile)).T
        return self._away * slope + 0.5 * self._away**2 * bend, slope + self._away * bend

    def _spline_profiles(self) -> FloatArray:
        """Profile of each spline of the correction on each edge, shape (edges, bins, splines)."""
        if self._splines is None:
            radial = correction_splines(self.freq)
            edges, bins = self.shape
            columns = self._pixel[:, :, None] * radial[:, None, :]
            products = self._sines @ columns.reshape(self.freq.size, -1)
            self._splines = products.reshape(bins, edges, -1).transpose(1, 0, 2)
        return self._splines


def _orthonormal(columns: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Q and R of each edge's columns; a column that is not there spans nothing."""
    basis, triangle = np.linalg.qr(columns)
    size = np.abs(np.diagonal(triangle, axis1=1, axis2=2))
    # An edge at 45 degrees has the same pixels to either end in every bin: no bin tells its angle.
    absent = size < _ABSENT * size.max(axis=1, keepdims=True)
    basis = np.where(absent[:, None, :], 0.0, basis)
    return basis, triangle + absent[:, :, None] * np.eye(columns.shape[2])


def _quadrature(freq_end: float, reach_px: float) -> tuple[FloatArray, FloatArray]:
    """Nodes and weights from 0 to a frequency for sines of up to ``reach_px``."""
    panels = max(ceil(pi * reach_px * freq_end / _PANEL_TURN_RAD), 2)
    node, weight = np.polynomial.legendre.leggauss(_PANEL_NODES)
    width = freq_end / panels
    start = width * np.arange(panels)
    freq = start[:, None] + width * (node + 1) / 2
    return freq.ravel(), np.tile(weight * width / 2, panels)
