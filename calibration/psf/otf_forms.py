"""The forms of a transfer function that edges are fitted with: their parameters, and derivatives.

All are ``OTF(|B f|, w) exp(-2 pi^2 f^T S f)`` with a symmetric matrix B of cut-off periods, a
defocus w and the covariance S of a Gaussian, and their parameters are linear in the elements of B,
the square of w and the elements of S. The square pixel comes on top, except over a total Gaussian.
"""

from dataclasses import dataclass, field, replace
from typing import Final, Literal

import numpy as np

from calibration.psf.otf_slices import Slices
from simulation.arrays import FloatArray
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

FormName = Literal["total-gaussian", "gaussian", "round", "elliptic", "free"]

_B, _DEFOCUS, _S = slice(0, 3), 3, slice(4, 7)
_ELEMENTS = 7
_LEAST_PERIOD_PX = 1e-4  # at 0 an ellipse would have no direction to grow in
_LEAST = {"cut_off_period_px": _LEAST_PERIOD_PX, "defocus_waves2": 0.0, "gaussian_px2": 0.0}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class OtfForm:
    """One form: which elements of B, w^2 and S its parameters set.

    ``elements`` has shape ``(7, parameters)``: B xx, xy, yy, w^2, S xx, xy, yy from the parameters.
    After the parameters named, there are those of ``harmonics`` angular terms of a correction.
    """

    name: FormName
    parameter_names: tuple[str, ...]
    elements: FloatArray = field(repr=False)
    harmonics: int = 0

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
        elements[[4, 6]] = 1.0
        shape = np.linalg.lstsq(self.elements, elements, rcond=None)[0]
        return np.concatenate([shape, np.zeros(self.corrections)])

    @property
    def least(self) -> FloatArray:
        """Least value of each parameter; minus infinity where it has no bound of its own."""
        known = [_LEAST.get(name, -np.inf) for name in self.parameter_names]
        return np.array(known + [-np.inf] * self.corrections)

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

    def slices(self, parameters: FloatArray, normal_rad: FloatArray) -> Slices:
        """What a lens passes along normals."""
        shape, coefficients = self._split(parameters)
        elements = self.elements @ shape
        along, square = _directions(normal_rad)
        correction = None
        if self.harmonics:
            correction = correction_harmonics(normal_rad, self.harmonics) @ coefficients
        return Slices(
            period_px=np.hypot(*_stretched(elements[_B], along)),
            defocus_waves2=float(elements[_DEFOCUS]),
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
        by_element[:, 1, _DEFOCUS] = 1.0
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
            defocus_waves=float(np.sqrt(elements[_DEFOCUS])),
            gaussian_px2=_matrix(elements[_S]),
            correction=correction,
        )

    def otf_slopes(self, parameters: FloatArray, fx: FloatArray, fy: FloatArray) -> FloatArray:
        """Derivatives of the lens's transfer by the parameters; shape ``(n, parameters)``.

        Parameters
        ----------
        parameters
            Of this form.
        fx, fy
            Frequencies in cy/px, shape ``(n,)`` each.
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
            elements[_B] = _positive(elements[_B], _LEAST_PERIOD_PX)
        elements[_DEFOCUS] = np.clip(elements[_DEFOCUS], 0.0, DEFOCUS_MAX_WAVES**2)
        elements[_S] = _positive(elements[_S], 0.0)
        nearest = np.linalg.lstsq(self.elements, elements, rcond=None)[0]
        return np.concatenate([nearest, coefficients.ravel()])

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


GAUSSIAN: Final = _form(
    "gaussian", gaussian_xx_px2=(4,), gaussian_xy_px2=(5,), gaussian_yy_px2=(6,)
)
AXIAL_GAUSSIAN: Final = _form("gaussian", gaussian_xx_px2=(4,), gaussian_yy_px2=(6,))
TOTAL_GAUSSIAN: Final = replace(GAUSSIAN, name="total-gaussian")
AXIAL_TOTAL_GAUSSIAN: Final = replace(AXIAL_GAUSSIAN, name="total-gaussian")
ROUND: Final = _form("round", cut_off_period_px=(0, 2), defocus_waves2=(3,), gaussian_px2=(4, 6))
ELLIPTIC: Final = _form(
    "elliptic",
    cut_off_period_xx_px=(0,),
    cut_off_period_xy_px=(1,),
    cut_off_period_yy_px=(2,),
    defocus_waves2=(3,),
    gaussian_px2=(4, 6),
)
TWO_ELLIPSES: Final = _form(
    "elliptic",
    cut_off_period_xx_px=(0,),
    cut_off_period_xy_px=(1,),
    cut_off_period_yy_px=(2,),
    defocus_waves2=(3,),
    gaussian_xx_px2=(4,),
    gaussian_xy_px2=(5,),
    gaussian_yy_px2=(6,),
)


def form_of(name: str, names: tuple[str, ...]) -> OtfForm:
    """Return the form with these parameters.

    Raises
    ------
    ValueError
        If there is none.
    """
    corrected = [
        base.with_correction(harmonics)
        for base in (ELLIPTIC, TWO_ELLIPSES)
        for harmonics in CORRECTION_HARMONICS
    ]
    gaussians = (GAUSSIAN, AXIAL_GAUSSIAN, TOTAL_GAUSSIAN, AXIAL_TOTAL_GAUSSIAN)
    for form in (*gaussians, ROUND, ELLIPTIC, TWO_ELLIPSES, *corrected):
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


def _positive(elements: FloatArray, least: float) -> FloatArray:
    """The nearest symmetric matrix with eigenvalues of at least ``least``."""
    values, vectors = np.linalg.eigh([[elements[0], elements[1]], [elements[1], elements[2]]])
    if values[0] >= least:
        return elements
    (xx, xy), (_, yy) = ((vectors * np.maximum(values, least)) @ vectors.T).tolist()
    return np.array([xx, xy, yy])
