"""The forms of a transfer function that edges are fitted with: their parameters, and derivatives.

All are ``OTF(|B f|, w) exp(-2 pi^2 f^T S f)`` with symmetric matrices: B of cut-off periods, W of
squared defocus, of which ``w^2 = n^T W n`` counts along n, and the covariance S of a Gaussian.
Their parameters are linear in the elements of all three. The square pixel comes on top, except over
a total Gaussian.
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
    """Return the form with these parameters.

    Raises
    ------
    ValueError
        If there is none.
    """
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
