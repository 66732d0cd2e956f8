"""Edges through a transfer function: levels by distance, with their derivatives.

By the projection-slice theorem the profile across an edge with unit normal n is
``E(d) = 1/2 + integral_0^inf H(f n) sin(2 pi f d) / (pi f) df``, H real and signed. The integral is
a sum over Gauss-Legendre nodes, the same for all edges, and all edges share their bins: the sines
are one matrix, and one product of matrices compares a transfer function with every pixel. From the
centre of a bin to the mean distance of its pixels, at most 1/32 px at the edge, the profile is
continued by its first two derivatives.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, pi
from typing import Self

import numpy as np

from calibration.edges import BinnedEdge, bin_centres_px
from simulation.arrays import FloatArray, IntArray
from simulation.psf import correction_splines, pupil_slopes

_PANEL_NODES = 32
_PANEL_TURN_RAD = 34.0  # of the fastest sine, half a panel: the rule is then right to 1e-8
_SHARPEST_CY_PER_PX = 8.0
_LEAST_CY_PER_PX = 1.6  # a correction reaches to 1.3
_CY_OVER_SIGMA = 2.5  # a Gaussian of that width is 1e-53 there, a lens has passed its cut-off
_ABSENT = 1e-9
# An edge sharper than the others has its slices raised: by this at most, beyond what a lens passes.
_MOST_RAISED = 3.0
_BLOCK_EDGES = 128  # with 1000 edges in one go a comparison took a fifth longer
# A place 0.02 px off bends a profile by up to 5e-4 of the contrast; one of 0.3 px is no edge.
_LEAST_MOVE_PX, _MOST_MOVE_PX = 0.02, 0.3
SLICE_TERMS = 3
"""Derivatives of a slice: by the period of cut-off, the squared defocus, the Gaussian variance."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Slices:
    """What a lens passes along each edge's normal; shape ``(edges,)`` each.

    ``period_px`` is ``|B n|``, ``variance_px2`` is ``n^T S n``; ``defocus_waves2`` is the square of
    the defocus that counts along n. ``correction`` has shape ``(edges, CORRECTION_SPLINES)``, None
    for none. Without ``has_pixel`` they are of the total transfer, and no pixel comes on top.
    """

    period_px: FloatArray
    defocus_waves2: FloatArray
    variance_px2: FloatArray
    correction: FloatArray | None = None
    has_pixel: bool = True

    def some(self, part: slice) -> "Slices":
        """Return those of some edges."""
        correction = self.correction
        return replace(
            self,
            period_px=self.period_px[part],
            defocus_waves2=self.defocus_waves2[part],
            variance_px2=self.variance_px2[part],
            correction=None if correction is None else correction[part],
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Residuals:
    """What a transfer function leaves of the levels, each edge's own levels and place fitted.

    ``values`` has shape ``(edges, bins)``, in standard deviations; ``slopes``, shape ``(edges,
    bins, SLICE_TERMS)`` or with the splines of the correction after them, are minus their
    derivatives, empty where not asked for. ``contrast`` is that of each edge, shape ``(edges,)``;
    ``shift_px``, shape ``(edges, 3)``, is how much nearer the edge is than its bins say: in the
    middle, and with the place along it and its square, which are 1 at the end; of pooled edges
    the first alone. ``pooled_squares``
    are those within pooled edges, which no lens changes.
    """

    values: FloatArray
    slopes: FloatArray
    contrast: FloatArray
    shift_px: FloatArray
    pooled_squares: float = 0.0

    @property
    def squares(self) -> float:
        """Sum of the squares: chi-squared."""
        return float(np.sum(self.values**2)) + self.pooled_squares


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StackedBins:
    """Levels of edges in common bins, shape ``(edges, bins)``; the weight is 0 where there is none.

    ``centre_px`` are the bins' centres, shape ``(bins,)``; ``along`` is the place along each edge,
    1 at its end. ``normal_rad`` and ``blur_px2`` have shape ``(edges,)``: the latter is an edge's
    variance beyond that of the lens. ``sharpest_px`` is the least width of the Gaussians. Where
    edges are pooled, ``count`` levels were and ``pooled_squares`` is their chi-squared about the
    levels here.
    """

    centre_px: FloatArray
    levels: FloatArray
    weights: FloatArray
    away_px: FloatArray
    along: FloatArray
    normal_rad: FloatArray
    blur_px2: FloatArray
    sharpest_px: float
    count: int
    pooled_squares: float = 0.0

    @classmethod
    def of(cls, edges: Sequence[BinnedEdge]) -> Self:
        """Stack edges as they are."""
        sizes = [edge.bin_index.size for edge in edges]
        number = np.concatenate([edge.bin_index for edge in edges])
        first = int(number.min())
        shape = (len(edges), int(number.max()) - first + 1)
        at = np.repeat(np.arange(len(edges)) * shape[1], sizes) + number - first

        def stacked(values: list[FloatArray]) -> FloatArray:
            out = np.zeros(shape)
            out.ravel()[at] = np.concatenate(values)
            return out

        along = stacked([edge.along_px for edge in edges])
        return cls(
            centre_px=bin_centres_px(np.arange(first, first + shape[1])),
            levels=stacked([edge.levels for edge in edges]),
            weights=stacked([edge.weights for edge in edges]),
            away_px=stacked([edge.away_px for edge in edges]),
            along=along / np.maximum(np.abs(along).max(axis=1, keepdims=True), 1.0),
            normal_rad=np.array([edge.normal_rad for edge in edges]),
            blur_px2=np.array([edge.blur_px2 for edge in edges]),
            sharpest_px=min(_lens_width(edge) for edge in edges),
            count=number.size,
        )

    def some(self, chosen: slice | IntArray) -> Self:
        """Return some of the edges."""
        return replace(
            self,
            levels=self.levels[chosen],
            weights=self.weights[chosen],
            away_px=self.away_px[chosen],
            along=self.along[chosen],
            normal_rad=self.normal_rad[chosen],
            blur_px2=self.blur_px2[chosen],
            count=int(np.count_nonzero(self.weights[chosen])),
        )


class EdgeStack:
    """Binned edges that are fitted together, with the matrix that all their profiles share."""

    def __init__(self, bins: StackedBins) -> None:
        distance = bins.centre_px
        # The pixel alone has a width of 0.29 px.
        lens = np.sqrt(max(bins.sharpest_px**2 - 1 / 12, 0.01))
        freq_end = float(np.clip(_CY_OVER_SIGMA / lens, _LEAST_CY_PER_PX, _SHARPEST_CY_PER_PX))
        self.freq, weight = _quadrature(freq_end, float(np.max(np.abs(distance))))
        self.normal_rad = bins.normal_rad
        self.shape = bins.levels.shape
        self.binned = bins
        self.bins = bins.count
        self._turn = 2 * pi * self.freq[:, None]
        self._sines = np.sin(distance[:, None] * self._turn.T)
        self._cosines = np.cos(distance[:, None] * self._turn.T)
        cosine, sine = np.cos(self.normal_rad), np.sin(self.normal_rad)
        square = np.sinc(np.outer(self.freq, cosine)) * np.sinc(np.outer(self.freq, sine))
        raised = np.minimum(-2 * pi**2 * np.outer(self.freq**2, bins.blur_px2), _MOST_RAISED)
        self._weight = (weight / (pi * self.freq))[:, None] * np.exp(raised)
        self._pixel = square * self._weight
        self._splines: FloatArray | None = None
        self.root_weight = np.sqrt(bins.weights)
        self._level = bins.levels * self.root_weight
        self.away_px = bins.away_px

    def left_by(self, slices: Slices) -> Residuals:
        """Compare the levels with those of a lens, without derivatives."""
        return self.residuals(slices, with_slopes=False)

    def residuals(
        self, slices: Slices, *, with_slopes: bool = True, with_splines: bool = False
    ) -> Residuals:
        """Compare the levels with those of a lens."""
        blocks = [
            self._block(
                slice(first, first + _BLOCK_EDGES),
                slices.some(slice(first, first + _BLOCK_EDGES)),
                with_slopes=with_slopes,
                with_splines=with_splines,
            )
            for first in range(0, self.shape[0], _BLOCK_EDGES)
        ]
        if len(blocks) == 1:
            return blocks[0]
        return Residuals(
            values=np.concatenate([block.values for block in blocks]),
            slopes=np.concatenate([block.slopes for block in blocks]),
            contrast=np.concatenate([block.contrast for block in blocks]),
            shift_px=np.concatenate([block.shift_px for block in blocks]),
            pooled_squares=self.binned.pooled_squares,
        )

    def _block(
        self, part: slice, slices: Slices, *, with_slopes: bool, with_splines: bool
    ) -> Residuals:
        """Residuals of some edges, so few that their profiles stay in the processor's cache."""
        columns = self._columns(part, slices, with_slopes=with_slopes)
        root_weight, level = self.root_weight[part], self._level[part]
        edges, bins = level.shape
        products = (self._sines @ columns.reshape(self.freq.size, -1)).reshape(bins, edges, -1)
        terms = products.transpose(1, 0, 2) * root_weight[:, :, None]
        more, slope = self._continued(part, columns[:, :, 0])
        rise = terms[:, :, 0] + (0.5 + more) * root_weight
        slope = slope * root_weight
        places = [slope]
        if self.binned.along.any():
            along = self.binned.along[part]
            places += [slope * along, slope * along**2]
        # The levels, the place, the angle and the bend of each edge are fitted by a projection.
        own = np.stack([root_weight, rise, *places], axis=-1)
        basis, triangle = _orthonormal(own)
        projected = basis.transpose(0, 2, 1) @ level[:, :, None]
        fitted = np.linalg.solve(triangle, projected)
        contrast = fitted[:, 1]
        bare = Residuals(
            values=level - (basis @ projected)[:, :, 0],
            slopes=np.empty((edges, bins, 0)),
            contrast=np.asarray(contrast[:, 0]),
            # Levels that a trial lens leaves even tell no place.
            shift_px=fitted[:, 2:, 0] / np.where(contrast == 0, np.inf, contrast),
            pooled_squares=self.binned.pooled_squares,
        )
        if not with_slopes:
            return bare
        slopes = terms[:, :, 1:]
        if with_splines:
            splines = self._spline_profiles()[part] * root_weight[:, :, None]
            slopes = np.concatenate([slopes, splines], axis=2)
        slopes = slopes * contrast[:, None]
        slopes = slopes - basis @ (basis.transpose(0, 2, 1) @ slopes)
        return replace(bare, slopes=slopes)

    def profiles(self, slices: Slices) -> FloatArray:
        """Levels from 0 to 1 of a lens at the mean distances of the bins, (edges, bins)."""
        every = slice(None)
        columns = self._columns(every, slices, with_slopes=False)[:, :, 0]
        return 0.5 + (self._sines @ columns).T + self._continued(every, columns)[0]

    def aligned(self, shift_px: FloatArray) -> bool:
        """Move the bins by what residuals say; whether that was worth it.

        The Gaussian that found an edge gives it a wrong angle where the lens is sharp and the edge
        nearly along the rows: its misfit at a few distances looks like a slope.
        """
        along = self.binned.along
        powers = np.stack([np.ones(self.shape), along, along**2], axis=-1)
        moved = (powers @ shift_px[:, :, None])[:, :, 0] * (self.root_weight > 0)
        if not _LEAST_MOVE_PX < np.abs(moved).max() < _MOST_MOVE_PX:
            return False
        self.away_px = self.away_px + moved
        self._splines = None
        return True

    def _columns(self, part: slice, slices: Slices, *, with_slopes: bool) -> FloatArray:
        """Amplitudes of the sines: of the profiles, then of their derivatives."""
        freq = self.freq[:, None]
        pixel = self._pixel[:, part]
        aperture = pixel if slices.has_pixel else self._weight[:, part]
        gauss = aperture * np.exp(-2 * pi**2 * freq**2 * slices.variance_px2)
        # Without a pupil all frequencies are 0 of its cut-off.
        has_pupil = bool(slices.period_px.any())
        relative = freq * slices.period_px if has_pupil else np.zeros((1, 1))
        pupil = pupil_slopes(relative, slices.defocus_waves2 if has_pupil else np.zeros(1))
        profile = gauss * pupil.otf
        by_variance = -2 * pi**2 * freq**2 * profile
        if slices.correction is not None:
            profile = profile + pixel * (correction_splines(self.freq) @ slices.correction.T)
        if not with_slopes:
            return profile[:, :, None]
        by_period = gauss * pupil.by_freq * freq
        by_defocus = gauss * pupil.by_defocus_waves2
        return np.stack([profile, by_period, by_defocus, by_variance], axis=-1)

    def _continued(self, part: slice, profile: FloatArray) -> tuple[FloatArray, FloatArray]:
        """What profiles rise by from the bins' centres to the means, and their slope there."""
        slope = (self._cosines @ (self._turn * profile)).T
        bend = -(self._sines @ (self._turn**2 * profile)).T
        away = self.away_px[part]
        return away * slope + 0.5 * away**2 * bend, slope + away * bend

    def _spline_profiles(self) -> FloatArray:
        """Profile of each spline of the correction on each edge, shape (edges, bins, splines)."""
        if self._splines is None:
            radial = correction_splines(self.freq)
            edges, bins = self.shape
            columns = self._pixel[:, :, None] * radial[:, None, :]
            products = self._sines @ columns.reshape(self.freq.size, -1)
            self._splines = products.reshape(bins, edges, -1).transpose(1, 0, 2)
        return self._splines


def _lens_width(edge: BinnedEdge) -> float:
    """Width of an edge without what its target adds; at least a hundredth of its variance."""
    square = edge.sigma_px**2
    return float(np.sqrt(max(square - max(edge.blur_px2, 0.0), 0.01 * square)))


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
