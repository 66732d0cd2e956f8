"""The forms of a transfer function that edges are fitted with, and edges seen through them.

Edges through a transfer function: levels by distance, with their derivatives. By the
projection-slice theorem the profile across an edge with unit normal n is ``E(d) = 1/2 +
integral_0^inf H(f n) sin(2 pi f d) / (pi f) df``, H real and signed. The integral is a sum over
Gauss-Legendre nodes, the same for all edges, and all edges share their bins: the sines are one
matrix, and one product of matrices compares a transfer function with every pixel. From the centre
of a bin to the mean distance of its pixels, at most 1/32 px at the edge, the profile is continued
by its first two derivatives.

The forms of a transfer function that edges are fitted with: their parameters, and derivatives. All
are ``OTF(|B f|, w) exp(-2 pi^2 f^T S f)`` with symmetric matrices: B of cut-off periods, W of
squared defocus, of which ``w^2 = n^T W n`` counts along n, and the covariance S of a Gaussian.
Their parameters are linear in the elements of all three. The square pixel comes on top, except over
a total Gaussian.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import ceil, pi
from typing import Final, Literal, Self

import numpy as np

from calibration.edges import BinnedEdge, bin_centres_px
from simulation.arrays import FloatArray, IntArray
from simulation.psf import (
    CORRECTION_HARMONICS,
    CORRECTION_SPLINES,
    DEFOCUS_MAX_WAVES,
    LensOtf,
    OtfCorrection,
    SymmetricMatrix,
    correction_harmonics,
    correction_splines,
    pupil_slopes,
)

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
class _Slices:
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

    def some(self, part: slice) -> "_Slices":
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

    def left_by(self, slices: _Slices) -> Residuals:
        """Compare the levels with those of a lens, without derivatives."""
        return self.residuals(slices, with_slopes=False)

    def residuals(
        self, slices: _Slices, *, with_slopes: bool = True, with_splines: bool = False
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
        self, part: slice, slices: _Slices, *, with_slopes: bool, with_splines: bool
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

    def profiles(self, slices: _Slices) -> FloatArray:
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

    def _columns(self, part: slice, slices: _Slices, *, with_slopes: bool) -> FloatArray:
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


FormName = Literal["total-gaussian", "gaussian", "round", "elliptic", "free"]

_MATRICES = _B, _W, _S = slice(0, 3), slice(3, 6), slice(6, 9)
_ELEMENTS = 9
_LEAST_PERIOD_PX = 1e-4  # at 0 an ellipse would have no direction to grow in


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OtfForm:
    """One form: which elements of B, w^2 and S its parameters set.

    ``elements`` has shape ``(9, parameters)``: xx, xy and yy of B, W and S from the parameters.
    After the parameters named, there are those of ``harmonics`` angular terms of a correction.
    """

    name: FormName
    parameter_names: tuple[str, ...]
    elements: FloatArray = field(repr=False)
    harmonics: int = 0

    @property
    def label(self) -> str:
        """Its name, and of an elliptic form what is not round."""
        parts = zip(("cut-off", "defocus", "Gaussian"), _MATRICES, strict=True)
        uneven = [
            name
            for name, part in parts
            if not np.array_equal(self.elements[part][0], self.elements[part][2])
        ]
        return f"elliptic in {' and '.join(uneven)}" if self.name == "elliptic" else self.name

    @property
    def has_pixel(self) -> bool:
        """Whether the square pixel comes on top."""
        return self.name != "total-gaussian"

    @property
    def corrections(self) -> int:
        """Number of coefficients of the correction."""
        return self.harmonics * CORRECTION_SPLINES

    @property
    def by_variance(self) -> FloatArray:
        """What all parameters change by per unit of a variance that is added along both axes."""
        elements = np.zeros(_ELEMENTS)
        elements[_S] = 1.0, 0.0, 1.0
        return np.concatenate([self.nearest(elements), np.zeros(self.corrections)])

    @property
    def least(self) -> FloatArray:
        """Least value of each parameter; minus infinity where it has no bound of its own.

        A matrix that may be turned is bounded as a whole, by ``bounded``.
        """
        least = np.full(len(self.names), -np.inf)
        for part in _MATRICES:
            sets = self.elements[part].any(axis=0)
            if not self.elements[part][1].any():
                least[: sets.size][sets] = _LEAST_PERIOD_PX if part is _B else 0.0
        return least

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all parameters, those of the correction last."""
        return self.parameter_names + tuple(
            f"correction_{row}_{spline}"
            for row in range(self.harmonics)
            for spline in range(CORRECTION_SPLINES)
        )

    def with_correction(self, harmonics: int) -> "OtfForm":
        """Return the form ``free``: this one with a correction."""
        return OtfForm(
            name="free",
            parameter_names=self.parameter_names,
            elements=self.elements,
            harmonics=harmonics,
        )

    def slices(self, parameters: FloatArray, normal_rad: FloatArray) -> _Slices:
        """What a lens passes along normals."""
        shape, coefficients = self._split(parameters)
        elements = self.elements @ shape
        along, square = _directions(normal_rad)
        correction = None
        if self.harmonics:
            correction = correction_harmonics(normal_rad, self.harmonics) @ coefficients
        return _Slices(
            period_px=np.hypot(*_stretched(elements[_B], along)),
            defocus_waves2=np.maximum(square @ elements[_W], 0.0),
            variance_px2=square @ elements[_S],
            correction=correction,
            has_pixel=self.has_pixel,
        )

    def slice_slopes(self, parameters: FloatArray, normal_rad: FloatArray) -> FloatArray:
        """Derivatives of the slices by the parameters, shape ``(edges, terms, parameters)``.

        The terms are those of ``Residuals.slopes``: three, then the splines of a correction.
        """
        shape, _ = self._split(parameters)
        (nx, ny), square = _directions(normal_rad)
        vx, vy = _stretched((self.elements @ shape)[_B], (nx, ny))
        period = np.maximum(np.hypot(vx, vy), 1e-300)
        by_element = np.zeros((nx.size, 3, _ELEMENTS))
        by_element[:, 0, _B] = np.stack([vx * nx, vx * ny + vy * nx, vy * ny], -1) / period[:, None]
        by_element[:, 1, _W] = square
        by_element[:, 2, _S] = square
        shaped = by_element @ self.elements
        if not self.harmonics:
            return shaped
        count, edges = shape.size, nx.size
        slopes = np.zeros((edges, 3 + CORRECTION_SPLINES, count + self.corrections))
        slopes[:, :3, :count] = shaped
        turns = correction_harmonics(normal_rad, self.harmonics)
        eye = np.eye(CORRECTION_SPLINES)
        rows = turns[:, None, :, None] * eye[None, :, None, :]
        slopes[:, 3:, count:] = rows.reshape(edges, CORRECTION_SPLINES, self.corrections)
        return slopes

    def lens(self, parameters: FloatArray) -> LensOtf:
        """Return the transfer function without the pixel that may come on top."""
        shape, coefficients = self._split(parameters)
        elements = self.elements @ shape
        correction = None
        if self.harmonics:
            correction = OtfCorrection(
                coefficients=tuple(tuple(row) for row in coefficients.tolist())
            )
        return LensOtf(
            cut_off_period_px=_matrix(elements[_B]),
            defocus_waves2=_matrix(elements[_W]),
            gaussian_px2=_matrix(elements[_S]),
            correction=correction,
        )

    def otf_slopes(self, parameters: FloatArray, fx: FloatArray, fy: FloatArray) -> FloatArray:
        """Derivatives of the lens's transfer by the parameters; shape ``(n, parameters)``.

        Frequencies are in cy/px.
        """
        freq, angle = np.hypot(fx, fy), np.arctan2(fy, fx)
        slices = self.slices(parameters, angle)
        gauss = np.exp(-2 * np.pi**2 * freq**2 * slices.variance_px2)
        pupil = pupil_slopes(freq * slices.period_px, slices.defocus_waves2)
        terms = [
            gauss * pupil.by_freq * freq,
            gauss * pupil.by_defocus_waves2,
            -2 * np.pi**2 * freq**2 * gauss * pupil.otf,
        ]
        columns = np.stack(terms, axis=-1)
        if self.harmonics:
            columns = np.concatenate([columns, correction_splines(freq)], axis=-1)
        by_parameter = self.slice_slopes(parameters, angle)
        return np.asarray(np.einsum("nt,ntp->np", columns, by_parameter))

    def bounded(self, parameters: FloatArray) -> FloatArray:
        """Return the nearest parameters of a lens that can be: no negative square or variance."""
        shape, coefficients = self._split(parameters)
        elements = self.elements @ shape
        if self.elements[_B].any():
            elements[_B] = _within(elements[_B], _LEAST_PERIOD_PX)
        elements[_W] = _within(elements[_W], 0.0, DEFOCUS_MAX_WAVES**2)
        elements[_S] = _within(elements[_S], 0.0)
        return np.concatenate([self.nearest(elements), coefficients.ravel()])

    def nearest(self, elements: FloatArray) -> FloatArray:
        """Return the parameters, without those of a correction, that set about these elements."""
        return np.asarray(np.linalg.lstsq(self.elements, elements, rcond=None)[0])

    def _split(self, parameters: FloatArray) -> tuple[FloatArray, FloatArray]:
        count = self.elements.shape[1]
        coefficients = parameters[count:].reshape(self.harmonics, CORRECTION_SPLINES)
        return parameters[:count], coefficients


def _form(name: FormName, **columns: tuple[int, ...]) -> OtfForm:
    """A form from the elements that each of its parameters sets."""
    elements = np.zeros((_ELEMENTS, len(columns)))
    for column, rows in enumerate(columns.values()):
        elements[list(rows), column] = 1.0
    return OtfForm(name=name, parameter_names=tuple(columns), elements=elements)


_EVEN_B = {"cut_off_period_px": (0, 2)}
_AXIAL_B = {"cut_off_period_xx_px": (0,), "cut_off_period_yy_px": (2,)}
_TURNED_B = {
    "cut_off_period_xx_px": (0,),
    "cut_off_period_xy_px": (1,),
    "cut_off_period_yy_px": (2,),
}
_EVEN_W = {"defocus_waves2": (3, 5)}
_TURNED_W = {"defocus_xx_waves2": (3,), "defocus_xy_waves2": (4,), "defocus_yy_waves2": (5,)}
_AXIAL_W = {"defocus_xx_waves2": (3,), "defocus_yy_waves2": (5,)}
_EVEN_S = {"gaussian_px2": (6, 8)}
_AXIAL_S = {"gaussian_xx_px2": (6,), "gaussian_yy_px2": (8,)}
_TURNED_S = {"gaussian_xx_px2": (6,), "gaussian_xy_px2": (7,), "gaussian_yy_px2": (8,)}

GAUSSIAN: Final = _form("gaussian", **_TURNED_S)
AXIAL_GAUSSIAN: Final = _form("gaussian", **_AXIAL_S)
TOTAL_GAUSSIAN: Final = replace(GAUSSIAN, name="total-gaussian")
AXIAL_TOTAL_GAUSSIAN: Final = replace(AXIAL_GAUSSIAN, name="total-gaussian")
ROUND: Final = _form("round", **_EVEN_B, **_EVEN_W, **_EVEN_S)
ELLIPTIC: Final = _form("elliptic", **_TURNED_B, **_EVEN_W, **_EVEN_S)
ASTIGMATIC: Final = _form("elliptic", **_EVEN_B, **_TURNED_W, **_EVEN_S)
TWO_ELLIPSES: Final = _form("elliptic", **_TURNED_B, **_EVEN_W, **_TURNED_S)
AXIAL: Final = (
    _form("elliptic", **_AXIAL_B, **_EVEN_W, **_EVEN_S),
    _form("elliptic", **_EVEN_B, **_AXIAL_W, **_EVEN_S),
    _form("elliptic", **_EVEN_B, **_EVEN_W, **_AXIAL_S),
)
"""A lens that is not round along the axes by its cut-off, its defocus or its Gaussian alone."""


def form_of(name: str, names: tuple[str, ...]) -> OtfForm:
    """Return the form with these parameters."""
    corrected = [
        base.with_correction(harmonics)
        for base in (ELLIPTIC, ASTIGMATIC, TWO_ELLIPSES)
        for harmonics in CORRECTION_HARMONICS
    ]
    gaussians = (GAUSSIAN, AXIAL_GAUSSIAN, TOTAL_GAUSSIAN, AXIAL_TOTAL_GAUSSIAN)
    lenses = (ROUND, ELLIPTIC, ASTIGMATIC, TWO_ELLIPSES, *AXIAL)
    for form in (*gaussians, *lenses, *corrected):
        if (form.name, form.names) == (name, names):
            return form
    raise ValueError(f"there is no form {name!r} with the parameters {', '.join(names)}")


def _directions(normal_rad: FloatArray) -> tuple[tuple[FloatArray, FloatArray], FloatArray]:
    """Unit normals, and what the elements xx, xy, yy count for in a square along them."""
    nx, ny = np.cos(normal_rad), np.sin(normal_rad)
    return (nx, ny), np.stack([nx * nx, 2 * nx * ny, ny * ny], axis=-1)


def _stretched(
    elements: FloatArray, along: tuple[FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    xx, xy, yy = elements.tolist()
    nx, ny = along
    return xx * nx + xy * ny, xy * nx + yy * ny


def _matrix(elements: FloatArray) -> SymmetricMatrix:
    xx, xy, yy = elements.tolist()
    return xx, xy, yy


def _within(elements: FloatArray, least: float, most: float = np.inf) -> FloatArray:
    """The nearest symmetric matrix with eigenvalues between the two."""
    values, vectors = np.linalg.eigh([[elements[0], elements[1]], [elements[1], elements[2]]])
    if least <= values[0] and values[1] <= most:
        return elements
    (xx, xy), (_, yy) = ((vectors * np.clip(values, least, most)) @ vectors.T).tolist()
    return np.array([xx, xy, yy])
