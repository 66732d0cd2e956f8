"""The calibrated PSF of a camera, as psf.json stores it."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, fields
from datetime import UTC, datetime, timedelta
from html import escape
from typing import TYPE_CHECKING, Annotated, Final, Literal, Self

import numpy as np
from pydantic import AfterValidator, Field

from acquisition.dataframe import dataframe
from acquisition.files import Provenance, StoredModel
from calibration.edges import EdgeMeasurement, MeasuredTransfer
from calibration.errors import PsfFileError
from calibration.estimate import Estimate
from calibration.psf._consistency import CrossValidation, HeightTrend
from calibration.psf._covariance import PsfEstimates
from calibration.psf._field import FieldFit
from calibration.psf._repeatability import FocusScatter
from calibration.psf._softness import TargetSoftness
from calibration.psf._transfer_2d import Transfer2d
from calibration.sharpness import (
    Picture,
    SharpnessLimits,
    SharpnessVerdict,
    edge_row,
    judge_sharpness,
)
from simulation.by_value import ByValue
from simulation.psf import GaussianPsf, MeasuredPsf, Psf, PsfField, SampledTransfer, SeparablePsf

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from pandas import DataFrame

PSF_SCHEMA: Final = "standoff.psf/1"

_NAMES = ("sigma_x_px", "sigma_y_px", "rho")
_NO_ESTIMATES = PsfEstimates(sigma_x_px=None, sigma_y_px=None, rho=None, covariance_px2=None)

Covariance = tuple[tuple[float, float], tuple[float, float]]
Matrix = tuple[tuple[float, ...], ...]


def _in_utc(text: str | None) -> str | None:
    """A time in UTC; one with another offset is converted, one without is taken as UTC."""
    if text is None:
        return None
    try:
        moment = datetime.fromisoformat(text)
    except ValueError as error:
        raise ValueError(f"expected a time in ISO 8601, got {text!r}") from error
    if moment.utcoffset() == timedelta(0):
        return text
    moment = moment.replace(tzinfo=UTC) if moment.tzinfo is None else moment.astimezone(UTC)
    return moment.isoformat().removesuffix("+00:00") + "Z"


class _PsfDocument(StoredModel):
    """The schema; a separate base class, so that it comes first in the file."""

    schema_name: Literal["standoff.psf/1"] = Field(default=PSF_SCHEMA, alias="schema", repr=False)


class CameraIdentity(StoredModel):
    """Identity of a camera, as far as it is known."""

    serial: str | None = None
    model: str | None = None
    vendor: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class PsfOrigin:
    """The camera, time and part of the frame of a calibration; None if not known.

    ``captured_utc`` is the time of the first capture in ISO 8601, ``region`` the part of the frame
    that was used, ``channel`` the channel of colour photographs. ``photograph`` holds the facts on
    camera and exposure on which the files agree. ``pixel_pitch_from`` names the source of
    ``pixel_pitch_um``. ``labels`` are names of the lens, the camera, the target and the customer.
    """

    camera: CameraIdentity = field(default_factory=CameraIdentity)
    captured_utc: str | None = None
    region: str | None = None
    channel: str | None = None
    photograph: dict[str, str | float] | None = None
    provenance: Provenance | None = None
    pixel_pitch_um: float | None = None
    pixel_pitch_from: str | None = None
    labels: dict[str, str] | None = None


class PairWidths(StoredModel):
    """Total PSF from one pair of photographs at two distances."""

    near: str
    far: str
    zoom: float
    sigma_x_px: float
    sigma_x_err_px: float
    sigma_y_px: float
    sigma_y_err_px: float


class PsfWidths(ByValue, StoredModel):
    """A PSF, total and of the lens alone, with standard errors; null means not determined.

    Total means optics and pixel together; its covariance is Sigma in equation (1) of the paper.
    ``estimate_covariance`` is the covariance matrix of the estimates of sigma_x_px, sigma_y_px and
    rho, in this order and without those that are null.
    """

    sigma_x_px: float | None = None
    sigma_x_err_px: float | None = None
    sigma_y_px: float | None = None
    sigma_y_err_px: float | None = None
    rho: float | None = None
    rho_err: float | None = None
    optical_sigma_x_px: float | None = None
    optical_sigma_x_err_px: float | None = None
    optical_sigma_y_px: float | None = None
    optical_sigma_y_err_px: float | None = None
    optical_rho: float | None = None
    optical_rho_err: float | None = None
    covariance_px2: Covariance | None = None
    optical_covariance_px2: Covariance | None = None
    estimate_covariance: Matrix | None = None
    optical_estimate_covariance: Matrix | None = None
    intervals_95: dict[str, tuple[float, float]] = {}  # noqa: RUF012 - pydantic copies it

    @classmethod
    def of(cls, total: PsfEstimates, optical: PsfEstimates | None, **others: object) -> Self:
        """Return the PSF with these estimates; ``others`` are further fields by name."""
        values: dict[str, object] = {}
        intervals: dict[str, tuple[float, float]] = {}
        for prefix, known in (("", total), ("optical_", optical or _NO_ESTIMATES)):
            for name in _NAMES:
                estimate: Estimate | None = getattr(known, name)
                if estimate is not None:
                    values[prefix + name] = estimate.value
                    values[_err_name(prefix + name)] = estimate.err
                    intervals[prefix + name] = estimate.interval_95
            if known.covariance_px2 is not None:
                values[f"{prefix}covariance_px2"] = known.covariance_px2.tolist()
            if known.estimate_covariance is not None:
                values[f"{prefix}estimate_covariance"] = known.estimate_covariance.tolist()
        return cls.model_validate({**values, "intervals_95": intervals, **others})

    @property
    def total(self) -> PsfEstimates:
        """The total PSF with errors and 95 % intervals."""
        return self._estimates("")

    @property
    def optical(self) -> PsfEstimates:
        """The PSF of the lens alone with errors and 95 % intervals."""
        return self._estimates("optical_")

    def estimate(self, name: str) -> Estimate | None:
        """Return a width or correlation by its name in the file, None if it has no error."""
        value: float | None = getattr(self, name)
        err: float | None = getattr(self, _err_name(name))
        if value is None or err is None:
            return None
        if name not in self.intervals_95:
            return Estimate(value=value, err=err)
        return Estimate(value=value, err=err, interval_95=self.intervals_95[name])

    def _estimates(self, prefix: str) -> PsfEstimates:
        covariance: Covariance | None = getattr(self, f"{prefix}covariance_px2")
        joint: Matrix | None = getattr(self, f"{prefix}estimate_covariance")
        return PsfEstimates(
            sigma_x_px=self.estimate(f"{prefix}sigma_x_px"),
            sigma_y_px=self.estimate(f"{prefix}sigma_y_px"),
            rho=self.estimate(f"{prefix}rho"),
            covariance_px2=None if covariance is None else np.array(covariance),
            estimate_covariance=None if joint is None else np.array(joint),
        )

    def __repr__(self) -> str:
        widths = ", ".join(
            f"{name.removesuffix('_px')} {self._text(name)}{' px' if name.endswith('_px') else ''}"
            for name in _NAMES
            if getattr(self, name) is not None
        )
        facts = ", ".join(self._facts())
        return f"{type(self).__name__}({'; '.join(filter(None, (widths, facts)))})"

    def __str__(self) -> str:
        return repr(self)

    def _repr_html_(self) -> str:
        rows = "".join(
            f"<tr><th>{name}</th><td>{self._text(name)}</td>"
            f"<td>{self._text(f'optical_{name}')}</td></tr>"
            for name in _NAMES
        )
        return (
            f"<table><caption>{escape(', '.join(self._facts()))}</caption>"
            f"<tr><th></th><th>total</th><th>optical</th></tr>{rows}</table>"
        )

    def _text(self, name: str) -> str:
        value: float | None = getattr(self, name)
        return str(self.estimate(name) or ("not determined" if value is None else f"{value:.4f}"))

    def _facts(self) -> Iterator[str]:
        """What the PSF was measured from, in a few words."""
        yield from ()


class ColourPsf(PsfWidths):
    """The PSF of one colour of a mosaic.

    ``edge_count`` is the number of edges used; it is not stored in the file.
    """

    edge_count: int | None = Field(default=None, exclude=True)


class PsfCalibration(PsfWidths, _PsfDocument):
    """The PSF of a camera, and the edges or pairs of photographs that it was measured from.

    None, or null in a file, means not determined. Files with only the total values are accepted.

    Parameters
    ----------
    field, no_field_because
        The PSF as it varies over the frame. None if one PSF holds for the whole frame as far as the
        edges show, or if edges or their directions are too few; ``no_field_because`` says which.
    focus
        Scatter of the PSF's variance between captures; None with one capture.
    cross_validation
        Test whether the edges agree with one PSF, which names what does not fit.
    target_softness
        Blur of the target itself; None with fewer than three scales.
    transfer_2d
        The measured form of the PSF; None if all edges have one direction, and for methods that
        measure only Gaussians.
    channels
        The PSF of each colour of a raw mosaic.
    pairs
        The pairs of photographs of a two-distance calibration.
    softness_px2
        Mean variance that the scene itself adds, of a single-image calibration.
    photograph
        Facts about camera and exposure on which the files of all photographs agree.
    picture_width_px, picture_height_px
        Size of the photographs; None if they differ in size.
    labels
        Names of the lens, the camera, the target and the customer.
    verdict
        Comparison of the edges with a limits file.
    notes
        Remarks on the calibration; not stored in a file.
    """

    field: FieldFit | None = None
    no_field_because: str | None = Field(default=None, repr=False)
    method: str | None = None
    height_trend: HeightTrend | None = None
    focus: FocusScatter | None = Field(default=None, repr=False)
    cross_validation: CrossValidation | None = Field(default=None, repr=False)
    target_softness: TargetSoftness | None = Field(default=None, repr=False)
    transfer: MeasuredTransfer | None = None
    transfer_2d: Transfer2d | None = Field(default=None, repr=False)
    camera: CameraIdentity | None = CameraIdentity()
    captured_utc: Annotated[str | None, AfterValidator(_in_utc)] = None
    region: str | None = None
    channel: str | None = None
    channels: dict[str, ColourPsf] | None = None
    pairs: tuple[PairWidths, ...] = ()
    softness_px2: float | None = None
    edges: tuple[EdgeMeasurement, ...] = ()
    photograph: dict[str, str | float] | None = None
    picture_width_px: int | None = None
    picture_height_px: int | None = None
    pixel_pitch_um: float | None = None
    pixel_pitch_from: str | None = None
    labels: dict[str, str] | None = None
    verdict: SharpnessVerdict | None = None
    provenance: Provenance | None = None
    notes: tuple[str, ...] = Field(default=(), exclude=True, repr=False)

    @property
    def edges_used(self) -> tuple[EdgeMeasurement, ...]:
        """The edges that were not rejected."""
        return tuple(edge for edge in self.edges if edge.is_used)

    def to_dataframe(self) -> "DataFrame":
        """Return the edges as a pandas table, one row per edge: those of psf.json, and ``is_used``.

        The columns ``mtf50_...`` hold the measured MTF50, as in reports and on the terminal;
        ``gaussian_mtf50_...`` that of the fitted Gaussian, which psf.json calls ``mtf50_...``.
        ``mtf50_from`` says which of the two a row has in ``mtf50_...``.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.

        Examples
        --------
        >>> psf = standoff.read_psf("psf.json")
        >>> psf.to_dataframe().groupby("orientation").sigma_px.median().round(2).to_dict()
        {'diagonal': 0.72, 'horizontal': 0.67, 'vertical': 0.76}
        """
        return dataframe({**edge_row(edge), "is_used": edge.is_used} for edge in self.edges)

    def with_origin(self, origin: PsfOrigin) -> "PsfCalibration":
        """Return the calibration with its camera, time, part of the frame and provenance."""
        focal_mm, soft = (origin.photograph or {}).get("focal_length_mm"), self.target_softness
        if soft is not None and isinstance(focal_mm, int | float) and origin.pixel_pitch_um:
            soft = soft.in_mm(focal_mm, origin.pixel_pitch_um)
        known = {one.name: getattr(origin, one.name) for one in fields(origin)}
        return self.model_copy(update={**known, "target_softness": soft})

    def judged(
        self,
        limits: SharpnessLimits,
        limits_file: str,
        camera: Mapping[str, Estimate] | None = None,
    ) -> "PsfCalibration":
        """Return the calibration with its verdict by the limits of the file ``limits_file``.

        ``camera`` are further figures that were measured, see `judge_sharpness`.
        """
        picture = Picture(
            width_px=self.picture_width_px,
            height_px=self.picture_height_px,
            pixel_pitch_um=self.pixel_pitch_um,
        )
        verdict = judge_sharpness(limits, self.edges, picture, limits_file, camera)
        return self.model_copy(update={"verdict": verdict})

    def total_psf(self, source: str) -> GaussianPsf:
        """Return the total PSF; a missing correlation is taken as zero.

        Raises
        ------
        PsfFileError
            If a width is null; the message names ``source`` and the width.
        """
        for name, edges in (("sigma_x_px", "vertical"), ("sigma_y_px", "horizontal")):
            if getattr(self, name) is None:
                raise PsfFileError(
                    f"{source}: {name} is null: its edges do not determine it; "
                    f"calibrate with {edges} edges as well",
                    source=source,
                    key=name,
                )
        try:
            return GaussianPsf(
                sigma_x_px=float(self.sigma_x_px or 0.0),
                sigma_y_px=float(self.sigma_y_px or 0.0),
                rho=self.rho or 0.0,
            )
        except ValueError as error:
            raise PsfFileError(f"{source}: {error}", source=source) from error

    def best_psf(self, source: str) -> Psf:
        """Return the PSF measured in all directions, or the Gaussian if the file has no such PSF.

        Raises
        ------
        PsfFileError
            If a width is null; the message names ``source`` and the width.
        """
        gaussian = self.total_psf(source)
        return gaussian if self.transfer_2d is None else self.transfer_2d.psf(gaussian)

    def measured_psf(self, source: str) -> Psf:
        """Return the measured PSF: in all directions, or, in older files, along either axis.

        Raises
        ------
        PsfFileError
            If the file has none, or a width is null; the message names ``source``.
        """
        best = self.best_psf(source)
        return self.measured_transfer(source) if self.transfer_2d is None else best

    def total_field(self, source: str, *, is_measured: bool = True) -> PsfField | None:
        """Return the total PSF as it varies over the frame, None if the file has no field.

        With ``is_measured`` it has the measured form, if the file has one; otherwise Gaussians.

        Raises
        ------
        PsfFileError
            If its coefficients do not give a valid PSF, or a width of its shape is null; the
            message names ``source``.
        """
        if self.field is None:
            return None
        shape = None
        if is_measured and self.transfer_2d is not None:
            best = self.best_psf(source)
            shape = best if isinstance(best, MeasuredPsf) else None
        try:
            return self.field.total_of(shape)
        except ValueError as error:
            raise PsfFileError(f"{source}: field: {error}", source=source, key="field") from error

    def measured_transfer(self, source: str) -> SeparablePsf:
        """Return the PSF of the transfer functions measured on the edges, no Gaussian assumed.

        Raises
        ------
        PsfFileError
            If an axis has no transfer function, or its samples are not a valid one.
        """
        known = self.transfer or MeasuredTransfer()
        curves = []
        for axis, curve, edges in (("y", known.y, "horizontal"), ("x", known.x, "vertical")):
            key = f"transfer.{axis}"
            if curve is None:
                raise PsfFileError(
                    f"{source}: there is no transfer function along {axis}; "
                    f"calibrate with {edges} edges",
                    source=source,
                    key=key,
                )
            try:
                curves.append(SampledTransfer(curve.freq_cy_per_px, curve.mtf))
            except ValueError as error:
                raise PsfFileError(f"{source}: {key}: {error}", source=source, key=key) from error
        return SeparablePsf(along_y=curves[0], along_x=curves[1], gaussian=self.total_psf(source))

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return a figure of the widths by angle and of the contrast by frequency."""
        from calibration.psf._plot import psf_figure  # loads matplotlib, only when plotting

        return psf_figure(self, ax)

    def _facts(self) -> Iterator[str]:
        if self.pairs:
            yield f"{len(self.pairs)} pair{'s' * (len(self.pairs) > 1)}"
        elif self.edges:
            yield f"{len(self.edges_used)} of {len(self.edges)} edges"
        if self.method is not None:
            yield self.method
        if self.field is not None:
            yield "with a field"


def _err_name(name: str) -> str:
    """Name of the standard error that belongs to a value."""
    return name.replace("_px", "_err_px") if name.endswith("_px") else f"{name}_err"
