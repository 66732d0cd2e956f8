"""The PSF over the frame: a quadratic polynomial for each element of the covariance.

Each edge measures ``n' Sigma(x, y) n`` at its position, which is linear in the 18 coefficients, so
the least-squares fit of one PSF serves for the field too. The field is kept only if an F-test
supports it and the edges determine it everywhere in the frame.
"""

from dataclasses import dataclass

import numpy as np
from pydantic import BaseModel, ConfigDict, Field
from scipy.special import fdtrc

from calibration.psf.variance import VarianceFit, fit_variances
from simulation.arrays import FloatArray
from simulation.psf import MeasuredPsf, PsfField, field_monomials

FIELD_DEGREE = 2
_TERMS = (FIELD_DEGREE + 1) * (FIELD_DEGREE + 2) // 2
_UNKNOWNS = 3 * _TERMS
_FEWEST_EDGES = 2 * _UNKNOWNS
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


class FieldFit(BaseModel):
    """A PSF field, the standard errors of its coefficients, and the evidence for it.

    Coefficients are those that ``PsfField`` takes, rows xx, xy and yy; those without a prefix
    belong to the total covariance. ``p_value`` is from the F-test against one PSF for the whole
    frame, ``worst_err`` is the largest relative standard error of a width anywhere in the frame.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

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
        """The total PSF over the frame.

        Raises
        ------
        ValueError
            If the coefficients, in a damaged file, do not give a valid PSF.
        """
        return self.total_of(None)

    def total_of(self, shape: MeasuredPsf | None) -> PsfField:
        """Return the total PSF over the frame as a measured shape that is stretched to it.

        Raises
        ------
        ValueError
            If the coefficients, in a damaged file, do not give a valid PSF.
        """
        return self._field(self.coefficients_px2, shape)

    @property
    def optical(self) -> PsfField | None:
        """The PSF of the lens alone over the frame; None if the edges do not determine it.

        Raises
        ------
        ValueError
            If the coefficients, in a damaged file, do not give a valid PSF.
        """
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

    Parameters
    ----------
    edges
        At least 36 edges, at several angles and all over the frame.
    width_px, height_px
        Size of the frame.
    is_asked
        Whether the F-test against one PSF must support the field (p below 0.001).

    Returns
    -------
    FieldFit or None
        None if there are too few edges, if a width anywhere in the frame has an error above 5 %,
        if the PSF does not change over the frame, or if the fit is not a valid covariance.
    """
    count = edges.sigma_px.size
    if count < _FEWEST_EDGES:
        return None
    terms = field_monomials(width_px, height_px, FIELD_DEGREE, edges.x_px, edges.y_px)
    elements = _elements(np.deg2rad(edges.angle_deg + 90.0))
    design = np.einsum("ne,nt->net", elements, terms).reshape(count, _UNKNOWNS)
    if np.linalg.matrix_rank(design, tol=1e-3) < _UNKNOWNS:
        return None
    fit = fit_variances(design, edges.sigma_px, edges.sigma_err_px, is_resampled=False)
    coefficients = fit.values.reshape(3, _TERMS)
    try:
        field = PsfField(width_px=width_px, height_px=height_px, coefficients_px2=coefficients)
    except ValueError:  # not positive definite somewhere in the frame
        return None
    worst = _worst_err(field, fit.covariance)
    p_value = _p_value(elements, design, fit, edges)
    if worst > _WORST_ERR or (is_asked and p_value > _ASKED_P):
        return None
    return FieldFit(
        width_px=width_px,
        height_px=height_px,
        coefficients_px2=_rows(coefficients),
        coefficients_err_px2=_rows(np.sqrt(np.diag(fit.covariance)).reshape(3, _TERMS)),
        p_value=p_value,
        worst_err=worst,
        edges=count,
    )


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
    freedom = float(fit.weights.sum()) - _UNKNOWNS
    if freedom < 1 or left <= 0:
        return 0.0 if without > left else 1.0
    extra = _UNKNOWNS - elements.shape[1]
    return float(fdtrc(extra, freedom, (without - left) / extra / (left / freedom)))
