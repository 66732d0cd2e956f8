"""The measured two-dimensional transfer function, as psf.json stores it."""

from collections.abc import Sequence
from typing import Self

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, model_validator

from calibration.edges import BinnedEdge
from calibration.psf.covariance import USUAL_RHO
from calibration.psf.otf_choice import OtfChoice, choose_otf, distinct_directions_deg
from calibration.psf.otf_forms import FormName, OtfForm, form_of
from simulation.arrays import FloatArray
from simulation.psf import GaussianPsf, LensOtf, MeasuredPsf

_ANGLES_DEG = tuple(range(0, 181, 15))
_FREQ_CY_PER_PX = tuple(round(0.02 * k, 2) for k in range(51))
_MTF50_FREQ = np.linspace(0.0, 2.0, 801)
_SOME_WAVES = 0.005  # less is none in two decimals
_AXES = ((0.0, "x"), (90.0, "y"))
_DECIMALS = 6  # of the table, which is there to be read
_DIGITS = 6  # of the covariance: with 8, bands are right to 1e-5 of themselves, with 6 to 1e-3


class OtfTable(BaseModel):
    """Samples of a transfer function of lens and pixel, and their standard errors.

    ``otf`` and ``otf_err`` have a row for each ``angle_deg`` of the frequency from +x, y down, and
    a column for each ``freq_cy_per_px``.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    angle_deg: tuple[float, ...]
    freq_cy_per_px: tuple[float, ...]
    otf: tuple[tuple[float, ...], ...]
    otf_err: tuple[tuple[float, ...], ...]

    @model_validator(mode="after")
    def _check(self) -> Self:
        shape = [len(self.freq_cy_per_px)] * len(self.angle_deg)
        for name, rows in (("otf", self.otf), ("otf_err", self.otf_err)):
            if [len(row) for row in rows] != shape:
                raise ValueError(
                    f"{name} must have {len(shape)} rows of {len(self.freq_cy_per_px)} numbers, "
                    "as there are angles and frequencies"
                )
        return self


class Transfer2d(BaseModel):
    """Transfer function of lens and pixel over both axes, from the pixels of all edges at once.

    ``form`` and ``parameters`` say it whole; ``table`` is for programs that read no formula.

    Attributes
    ----------
    form
        ``gaussian``: a Gaussian lens. ``total-gaussian``: a Gaussian for lens and pixel in one, as
        rendered edges have. ``round``: a circular pupil out of focus, and a Gaussian. ``elliptic``:
        the same with the pupil's cut-off stretched to an ellipse. ``free``: with a correction by
        radial splines and angular harmonics.
    reason
        Why this form: by how much the Bayesian information criterion of others is larger.
    parameters
        By name, the unit in it; ``defocus_waves2`` is the square of the defocus in waves.
    covariance
        Covariance matrix of the parameters, in their order: its lower triangle, row by row. It
        holds the scatter from edge to edge and that of the focus between captures, whose part is
        widened by Student's quantile over the normal one: 1.96 standard errors are 95 %.
    angles_deg
        Directions of the frequencies that edges measured: their normals, modulo 180 degrees.
    edges, chi2_reduced
        Number of edges, and chi-squared over its degrees of freedom for the noise within them.
    scatter
        Factor on the noise's covariance for what the edges scatter beyond it, at least 1.
    rho_err_assumed
        Standard error of the correlation that ``otf_err`` holds where the directions of the edges
        leave it open and it is taken as 0; null where they tell it, and in files of before.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    form: FormName
    reason: str
    parameters: dict[str, float]
    covariance: tuple[tuple[float, ...], ...] = Field(repr=False)
    angles_deg: tuple[float, ...] = Field(repr=False)
    edges: int
    chi2_reduced: float
    scatter: float
    rho_err_assumed: float | None = None
    table: OtfTable | None = Field(default=None, repr=False)

    @model_validator(mode="after")
    def _check(self) -> Self:
        count = len(self.parameters)
        if [len(row) for row in self.covariance] != list(range(1, count + 1)):
            raise ValueError(
                f"covariance must have {count} rows of 1 to {count} numbers, as the parameters"
            )
        self._form.lens(self._values)
        return self

    @classmethod
    def of(
        cls, choice: OtfChoice, normal_rad: Sequence[float], shared_err_px2: float = 0.0
    ) -> Self:
        """Return the document of a fit to edges with these normals.

        ``shared_err_px2`` is the error of the variance, of both axes alike, that edges of one
        capture share.
        """
        fit = choice.fit
        by_variance = fit.form.by_variance
        shared = shared_err_px2**2 * np.outer(by_variance, by_variance)
        covariance = choice.scale * fit.inverse + shared
        bare = cls(
            form=fit.form.name,
            reason=choice.reason,
            parameters=dict(zip(fit.form.names, fit.parameters.tolist(), strict=True)),
            covariance=_lower_triangle(covariance),
            angles_deg=tuple(np.round(distinct_directions_deg(normal_rad), 2).tolist()),
            edges=len(normal_rad),
            chi2_reduced=choice.chi2_reduced,
            scatter=choice.scale,
            rho_err_assumed=None if choice.knows_turn else USUAL_RHO,
        )
        return bare.model_copy(update={"table": bare._table()})

    @property
    def lens(self) -> LensOtf:
        """Transfer function without the pixel: of the lens, or all of a total Gaussian."""
        return self._form.lens(self._values)

    @property
    def covariance_matrix(self) -> FloatArray:
        """Covariance matrix of the parameters, whole."""
        count = len(self.parameters)
        lower = np.zeros((count, count))
        lower[np.tril_indices(count)] = [value for row in self.covariance for value in row]
        return np.asarray(lower + np.tril(lower, -1).T)

    def psf(self, gaussian: GaussianPsf) -> GaussianPsf | MeasuredPsf:
        """Return the total PSF; ``gaussian`` is the Gaussian nearest to it."""
        if self._form.has_pixel:
            return MeasuredPsf(lens=self.lens, gaussian=gaussian)
        xx, xy, yy = self.lens.gaussian_px2
        return GaussianPsf.from_covariance(np.array([[xx, xy], [xy, yy]]))

    def otf(self, fx_cy_per_px: FloatArray, fy_cy_per_px: FloatArray) -> FloatArray:
        """Return the transfer of lens and pixel at frequencies; the two broadcast."""
        fx, fy = np.asarray(fx_cy_per_px), np.asarray(fy_cy_per_px)
        return np.asarray(self.lens(fx, fy) * self._pixel(fx, fy))

    def otf_err(self, fx_cy_per_px: FloatArray, fy_cy_per_px: FloatArray) -> FloatArray:
        """Return the standard error of the transfer at frequencies; the two broadcast.

        1.96 of them to either side are the pointwise 95 % band.
        """
        fx, fy = np.broadcast_arrays(fx_cy_per_px, fy_cy_per_px)
        slopes = self._form.otf_slopes(self._values, fx.ravel(), fy.ravel())
        variance = np.sum((slopes @ self.covariance_matrix) * slopes, axis=1)
        pixel = np.abs(self._pixel(fx, fy))
        measured = pixel * np.sqrt(np.maximum(variance, 0.0)).reshape(fx.shape)
        return np.asarray(np.hypot(measured, self._unknown_turn(fx, fy)))

    def _unknown_turn(self, fx: FloatArray, fy: FloatArray) -> FloatArray | float:
        """Change of the transfer if the correlation had the standard error that is assumed."""
        if self.rho_err_assumed is None:
            return 0.0
        halves = [self.mtf50_cy_per_px(angle) or _MTF50_FREQ[-1] for angle, _ in _AXES]
        widths = [np.sqrt(np.log(2) / 2) / np.pi / half for half in halves]
        xy_px2 = self.rho_err_assumed * widths[0] * widths[1]
        return np.asarray(4 * np.pi**2 * fx * fy * xy_px2 * self.otf(fx, fy))

    def mtf50_cy_per_px(self, angle_deg: float) -> float | None:
        """Return the frequency at which the contrast falls to a half; None for none up to 2 cy/px.

        ``angle_deg`` is the direction of the frequency from +x, y down.
        """
        angle = np.deg2rad(angle_deg)
        values = np.abs(self.otf(_MTF50_FREQ * np.cos(angle), _MTF50_FREQ * np.sin(angle)))
        below = np.flatnonzero(values < 0.5)
        if below.size == 0:
            return None
        pair = slice(below[0] - 1, below[0] + 1)
        return float(np.interp(-0.5, -values[pair], _MTF50_FREQ[pair]))

    @property
    def defocus_waves(self) -> float:
        """Defocus of the pupil in wavelengths, its mean square over directions; 0 without one."""
        xx, _, yy = self.lens.defocus_waves2
        return float(np.sqrt(0.5 * (xx + yy)))

    def _pixel(self, fx: FloatArray, fy: FloatArray) -> FloatArray:
        """What the square pixel passes; 1 where the form contains it."""
        return np.asarray(np.sinc(fx) * np.sinc(fy)) if self._form.has_pixel else np.ones_like(fx)

    def _table(self) -> OtfTable:
        angle = np.deg2rad(_ANGLES_DEG)[:, None]
        freq = np.array(_FREQ_CY_PER_PX)
        fx, fy = freq * np.cos(angle), freq * np.sin(angle)
        return OtfTable(
            angle_deg=tuple(float(angle) for angle in _ANGLES_DEG),
            freq_cy_per_px=_FREQ_CY_PER_PX,
            otf=_rows(np.round(self.otf(fx, fy), _DECIMALS)),
            otf_err=_rows(np.round(self.otf_err(fx, fy), _DECIMALS)),
        )

    @property
    def _form(self) -> OtfForm:
        return form_of(self.form, tuple(self.parameters))

    @property
    def _values(self) -> FloatArray:
        return np.array(list(self.parameters.values()))

    def __str__(self) -> str:
        focus = f" (defocus {self.defocus_waves:.2f} waves)" * (self.defocus_waves >= _SOME_WAVES)
        between = "" if self.rho_err_assumed is None else "; between the axes not measured"
        halves = [f"{_brief(self.mtf50_cy_per_px(angle))} along {axis}" for angle, axis in _AXES]
        return (
            f"{self.form}{focus}, from {self.edges} edges at {len(self.angles_deg)} angles; "
            f"MTF50 in cy/px: {', '.join(halves)}{between}"
        )


def measure_transfer_2d(
    edges: Sequence[BinnedEdge], shared_err_px2: float = 0.0, *, knows_correlation: bool = True
) -> Transfer2d | None:
    """Fit the two-dimensional transfer function.

    Parameters
    ----------
    edges
        The edges, each with what it is blurred beyond the camera.
    shared_err_px2
        Error of the variance, of both axes alike, that edges share and so do not show by their
        scatter: the focus of a capture, what JPEG takes from all; 1.96 of it are 95 %.
    knows_correlation
        False where the widths of the edges have left rho undetermined: every form is upright then.

    Returns
    -------
    Transfer2d or None
        None where the edges have one direction alone, or two that are not those of vertical and
        horizontal edges.
    """
    choice = choose_otf(edges, knows_correlation=knows_correlation)
    if choice is None:
        return None
    return Transfer2d.of(choice, [edge.normal_rad for edge in edges], shared_err_px2)


def _brief(freq_cy_per_px: float | None) -> str:
    return "beyond 2" if freq_cy_per_px is None else f"{freq_cy_per_px:.3f}"


def _lower_triangle(matrix: FloatArray) -> tuple[tuple[float, ...], ...]:
    """Rows up to the diagonal, with the digits that a band needs."""
    return tuple(
        tuple(float(f"{value:.{_DIGITS}g}") for value in row[: k + 1])
        for k, row in enumerate(matrix.tolist())
    )


def _rows(matrix: FloatArray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in matrix.tolist())
