"""The PSF over the frame: a quadratic polynomial for each element of the covariance.

Each edge measures ``n' Sigma(x, y) n`` at its position, which is linear in the 18 coefficients, so
the least-squares fit of one PSF serves for the field too. The field is kept only if an F-test
supports it and the edges determine it everywhere in the frame.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from pydantic import Field
from scipy.special import fdtrc

from acquisition.files import StoredModel
from calibration.psf._covariance import VarianceFit, fit_variances
from simulation.arrays import FloatArray
from simulation.psf import MeasuredPsf, PsfField, field_monomials

FIELD_DEGREE = 2
_TERMS = (FIELD_DEGREE + 1) * (FIELD_DEGREE + 2) // 2
_UNKNOWNS = 3 * _TERMS
FEWEST_FIELD_EDGES: Final = 2 * _UNKNOWNS
"""Edges that a field takes at least."""

_LEAST_SINGULAR = 1e-3
_ASKED_P = 1e-3
_WORST_ERR = 0.05  # of the width, anywhere in the frame and in any direction
_CHECKED_PLACES = 9
_CHECKED_NORMALS_RAD = np.deg2rad([0.0, 45.0, 90.0, 135.0])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FieldEdges:
    """Widths across edges, with their positions and angles; shape ``(n,)`` each."""

    x_px: FloatArray
    y_px: FloatArray
    angle_deg: FloatArray
    sigma_px: FloatArray
    sigma_err_px: FloatArray


Coefficients = tuple[tuple[float, ...], ...]


class FieldFit(StoredModel):
    """A PSF field, the standard errors of its coefficients, and the evidence for it.

    Coefficients are those that ``PsfField`` takes, rows xx, xy and yy; those without a prefix
    belong to the total covariance. ``p_value`` is from the F-test against one PSF for the whole
    frame, ``worst_err`` is the largest relative standard error of a width anywhere in the frame.
    """

    width_px: int
    height_px: int
    coefficients_px2: Coefficients = Field(repr=False)
    optical_coefficients_px2: Coefficients | None = Field(default=None, repr=False)
    coefficients_err_px2: Coefficients | None = Field(default=None, repr=False)
    optical_coefficients_err_px2: Coefficients | None = Field(default=None, repr=False)
    p_value: float | None = None
    worst_err: float | None = None
    edges: int | None = None

    @property
    def total(self) -> PsfField:
        """The total PSF over the frame; a ValueError for coefficients of a damaged file."""
        return self.total_of(None)

    def total_of(self, shape: MeasuredPsf | None) -> PsfField:
        """Return the total PSF over the frame as a measured shape that is stretched to it."""
        return self._field(self.coefficients_px2, shape)

    @property
    def optical(self) -> PsfField | None:
        """The PSF of the lens alone over the frame; None if the edges do not determine it."""
        if self.optical_coefficients_px2 is None:
            return None
        return self._field(self.optical_coefficients_px2)

    def with_optical(self, lens: "FieldFit") -> "FieldFit":
        """Return the field together with that of the lens alone, which was fitted separately."""
        return self.model_copy(
            update={
                "optical_coefficients_px2": lens.coefficients_px2,
                "optical_coefficients_err_px2": lens.coefficients_err_px2,
            }
        )

    def _field(self, coefficients_px2: Coefficients, shape: MeasuredPsf | None = None) -> PsfField:
        return PsfField(
            width_px=self.width_px,
            height_px=self.height_px,
            coefficients_px2=np.array(coefficients_px2, dtype=np.float64),
            shape=shape,
        )


def fit_psf_field(
    edges: FieldEdges, width_px: int, height_px: int, *, is_asked: bool = True
) -> FieldFit | None:
    """Fit the covariance over the frame.

    It takes 36 edges, at several angles and all over the frame. None with fewer edges or
    directions, if a width anywhere in the frame has an error above 5 %, if the PSF does not change
    over the frame (an F-test with p below 0.001, if it is asked), or if the fit is not a valid
    covariance.
    """
    fit = field_or_reason(edges, width_px, height_px, is_asked=is_asked)
    return fit if isinstance(fit, FieldFit) else None


def field_or_reason(
    edges: FieldEdges, width_px: int, height_px: int, *, is_asked: bool = True
) -> FieldFit | str:
    """Fit the covariance over the frame, or say in a clause why there is no field."""
    count = edges.sigma_px.size
    if count < FEWEST_FIELD_EDGES:
        return f"too few edges: {count} of at least {FEWEST_FIELD_EDGES}"
    terms = field_monomials(width_px, height_px, FIELD_DEGREE, edges.x_px, edges.y_px)
    if np.linalg.matrix_rank(terms, tol=_LEAST_SINGULAR) < _TERMS:
        return "the edges lie in too few places: spread them over the frame"
    elements = _elements(np.deg2rad(edges.angle_deg + 90.0))
    design = _design(elements, terms)
    if np.linalg.matrix_rank(design, tol=_LEAST_SINGULAR) < design.shape[1]:
        return _too_few_directions(elements, terms, edges)
    fit = fit_variances(design, edges.sigma_px, edges.sigma_err_px, is_resampled=False)
    coefficients = fit.values.reshape(3, _TERMS)
    try:
        field = PsfField(width_px=width_px, height_px=height_px, coefficients_px2=coefficients)
    except ValueError:  # not positive definite somewhere in the frame
        return "the edges do not determine a positive width everywhere in the frame: add edges"
    worst = _worst_err(field, fit.covariance)
    p_value = _p_value(elements, design, fit, edges)
    if is_asked and p_value > _ASKED_P:
        return f"the edges show no change over the frame (p = {p_value:.2g})"
    if worst > _WORST_ERR:
        return (
            f"a width somewhere in the frame would be known to {100 * worst:.0f} % only, but "
            f"{100 * _WORST_ERR:.0f} % is needed: add edges in several directions everywhere"
        )
    return FieldFit(
        width_px=width_px,
        height_px=height_px,
        coefficients_px2=_rows(coefficients),
        coefficients_err_px2=_rows(np.sqrt(np.diag(fit.covariance)).reshape(3, _TERMS)),
        p_value=p_value,
        worst_err=worst,
        edges=count,
    )


def _design(elements: FloatArray, terms: FloatArray) -> FloatArray:
    """What each coefficient adds to the squared widths; shape ``(n, coefficients)``."""
    return np.asarray(np.einsum("ne,nt->net", elements, terms)).reshape(len(terms), -1)


def _too_few_directions(elements: FloatArray, terms: FloatArray, edges: FieldEdges) -> str:
    """Say that directions are missing, and whether widths along the axes change over the frame."""
    needed = "too few directions: three are needed all over the frame; add diagonal edges"
    upright = elements[:, [0, 2]]
    design = _design(upright, terms)
    if np.linalg.matrix_rank(design, tol=_LEAST_SINGULAR) < design.shape[1]:
        return needed
    fit = fit_variances(design, edges.sigma_px, edges.sigma_err_px, is_resampled=False)
    p_value = _p_value(upright, design, fit, edges)
    changes = "change" if p_value <= _ASKED_P else "do not change significantly"
    return f"{needed}; the widths along the axes {changes} over the frame (p = {p_value:.2g})"


def _rows(matrix: FloatArray) -> Coefficients:
    return tuple(tuple(row) for row in matrix.tolist())


def _elements(normal_rad: FloatArray) -> FloatArray:
    """Weights of the elements xx, xy, yy in the variance along normals; shape ``(n, 3)``."""
    nx, ny = np.cos(normal_rad), np.sin(normal_rad)
    return np.stack([nx**2, 2 * nx * ny, ny**2], axis=-1)


def _worst_err(field: PsfField, covariance: FloatArray) -> float:
    x = np.linspace(0, field.width_px - 1, _CHECKED_PLACES)[None, :]
    y = np.linspace(0, field.height_px - 1, _CHECKED_PLACES)[:, None]
    terms = field_monomials(field.width_px, field.height_px, FIELD_DEGREE, x, y)
    rows = np.einsum("ke,ijt->kijet", _elements(_CHECKED_NORMALS_RAD), terms)
    rows = rows.reshape(-1, _UNKNOWNS)
    variance = rows @ field.coefficients_px2.ravel()
    err = np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", rows, covariance, rows), 0.0))
    # A narrow width along a normal between the four is still positive: the field was checked.
    return float(np.max(err / (2 * np.maximum(variance, 1e-12))))


def _p_value(
    elements: FloatArray, design: FloatArray, fit: VarianceFit, edges: FieldEdges
) -> float:
    """Probability of so much better a fit if one PSF held for the whole frame."""
    squares = edges.sigma_px**2
    spread2 = 4 * squares * (edges.sigma_err_px**2 + fit.scatter_px**2)
    weight = fit.weights / spread2
    root = np.sqrt(weight)
    constant = np.linalg.lstsq(root[:, None] * elements, root * squares, rcond=None)[0]
    without = float(np.sum(weight * (squares - elements @ constant) ** 2))
    left = float(np.sum(weight * (squares - design @ fit.values) ** 2))
    unknowns = design.shape[1]
    freedom = float(fit.weights.sum()) - unknowns
    if freedom < 1 or left <= 0:
        return 0.0 if without > left else 1.0
    extra = unknowns - elements.shape[1]
    return float(fdtrc(extra, freedom, (without - left) / extra / (left / freedom)))
