"""What a psf.json holds, as it is read: every value checked for its type."""

import math
from dataclasses import asdict, dataclass
from typing import Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict

from calibration.edges import AxisTransfer, MeasuredTransfer
from calibration.errors import PsfFileError
from calibration.psf.calibration import EdgeMeasurement, PsfCalibration
from calibration.psf.covariance import Estimate, median_width
from calibration.psf.field import FieldFit
from calibration.psf.height_trend import HeightTrend
from simulation.psf import CameraTransfer, GaussianPsf, PsfField, SampledTransfer

__all__ = [
    "PSF_SCHEMA",
    "PsfOrigin",
    "StoredCamera",
    "StoredCurve",
    "StoredEdge",
    "StoredField",
    "StoredHeight",
    "StoredHeightTrend",
    "StoredPsf",
    "StoredTransfer",
    "edge_document",
    "psf_document",
]

PSF_SCHEMA = "standoff.psf/1"

_ESTIMATES = (
    "sigma_x_px",
    "sigma_y_px",
    "rho",
    "optical_sigma_x_px",
    "optical_sigma_y_px",
    "optical_rho",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class PsfOrigin:
    """Which camera a calibration belongs to, when and from what part; None is not known.

    ``captured_utc`` is the ISO 8601 text of the first capture, ``region`` the part of the
    frame that was used, ``channel`` the plane of colour photographs.
    """

    camera_serial: str | None = None
    camera_model: str | None = None
    camera_vendor: str | None = None
    captured_utc: str | None = None
    region: str | None = None
    channel: str | None = None


def psf_document(calibration: PsfCalibration, origin: PsfOrigin | None = None) -> dict[str, Any]:
    """Return the content of psf.json as plain lists and numbers."""
    known = origin or PsfOrigin()
    return {
        "schema": PSF_SCHEMA,
        **_values(calibration),
        "field": _field(calibration),
        "method": calibration.method,
        "height_trend": _height_trend(calibration),
        "transfer": _transfer(calibration.transfer),
        "camera": {
            "serial": known.camera_serial,
            "model": known.camera_model,
            "vendor": known.camera_vendor,
        },
        "captured_utc": known.captured_utc,
        "region": known.region,
        "channel": known.channel,
        "channels": (
            None
            if calibration.channels is None
            else {name: _values(one) for name, one in calibration.channels.items()}
        ),
        "pairs": [asdict(pair) for pair in calibration.pairs],
        "softness_px2": calibration.softness_px2,
        "edges": [edge_document(edge) for edge in calibration.edges],
    }


def edge_document(edge: EdgeMeasurement) -> dict[str, Any]:
    """Return what psf.json holds about one edge."""
    fit, esfr = edge.fit, edge.esfr
    return {
        "image": edge.image,
        "capture": edge.capture,
        "height_mm": edge.height_mm,
        "x_px": fit.x_px,
        "y_px": fit.y_px,
        "angle_deg": fit.angle_deg,
        "orientation": edge.orientation,
        "length_px": fit.length_px,
        "snr": fit.snr if math.isfinite(fit.snr) else None,
        "sigma_px": fit.sigma_px,
        "sigma_err_px": fit.sigma_err_px,
        "optical_sigma_px": fit.optical_sigma_px,
        "optical_sigma_err_px": fit.optical_sigma_err_px,
        "mtf50_cy_per_px": edge.mtf50_cy_per_px,
        "esfr_mtf50_cy_per_px": esfr.mtf50_cy_per_px if esfr else None,
        "esfr_mtf50_err_cy_per_px": esfr.mtf50_err_cy_per_px if esfr else None,
        "esfr_mtf20_cy_per_px": esfr.mtf20_cy_per_px if esfr else None,
        "contrast": edge.contrast,
        "roughness_px": edge.roughness_px,
        "clipped_fraction": edge.clipped_fraction,
        "chi2_reduced": fit.chi2_reduced,
        "flags": list(edge.flags),
    }


def _values(calibration: PsfCalibration) -> dict[str, Any]:
    widths: dict[str, Estimate | None] = {n: getattr(calibration, n) for n in _ESTIMATES}
    document: dict[str, Any] = {}
    for name, estimate in widths.items():
        document[name] = estimate.value if estimate else None
        error_name = name.replace("_px", "_err_px") if name.endswith("_px") else f"{name}_err"
        document[error_name] = estimate.err if estimate else None
    for name in ("covariance_px2", "optical_covariance_px2"):
        matrix = getattr(calibration, name)
        document[name] = None if matrix is None else np.asarray(matrix).tolist()
    document["intervals_95"] = {n: [e.low, e.high] for n, e in widths.items() if e is not None}
    return document


def _field(calibration: PsfCalibration) -> dict[str, Any] | None:
    whole, lens = calibration.field, calibration.optical_field
    if whole is None:
        return None
    return {
        "width_px": whole.field.width_px,
        "height_px": whole.field.height_px,
        "coefficients_px2": whole.field.coefficients_px2.tolist(),
        "optical_coefficients_px2": _coefficients(lens),
        "coefficients_err_px2": whole.coefficients_err_px2.tolist(),
        "optical_coefficients_err_px2": lens.coefficients_err_px2.tolist() if lens else None,
        "p_value": whole.p_value,
        "worst_err": whole.worst_err,
        "edges": whole.edges,
    }


def _coefficients(fit: FieldFit | None) -> list[list[float]] | None:
    return None if fit is None else fit.field.coefficients_px2.tolist()


def _height_trend(calibration: PsfCalibration) -> dict[str, Any] | None:
    trend: HeightTrend | None = calibration.height_trend
    if trend is None:
        return None
    groups = []
    for group in trend.heights:
        at_height = [e for e in calibration.edges_used if e.height_mm == group.height_mm]
        row: dict[str, Any] = {
            "height_mm": group.height_mm,
            "edges": group.edges,
            "relative_width": group.relative_width,
            "relative_width_err": group.relative_width_err,
        }
        for axis, orientation in (("x", "vertical"), ("y", "horizontal")):
            fits = [e.fit for e in at_height if e.orientation == orientation]
            median = None
            if fits:
                median = median_width(
                    np.array([f.sigma_px for f in fits]), np.array([f.sigma_err_px for f in fits])
                )
            row[f"sigma_{axis}_px"] = median.value if median else None
            row[f"sigma_{axis}_err_px"] = median.err if median else None
        groups.append(row)
    return {
        "slope_per_mm": trend.slope_per_mm,
        "slope_err_per_mm": trend.slope_err_per_mm,
        "p_value": trend.p_value,
        "p_value_between": trend.p_value_between,
        "is_drift": trend.is_drift,
        "heights": groups,
    }


def _transfer(transfer: MeasuredTransfer | None) -> dict[str, Any] | None:
    if transfer is None:
        return None
    return {"x": _curve(transfer.x), "y": _curve(transfer.y)}


def _curve(curve: AxisTransfer | None) -> dict[str, Any] | None:
    if curve is None:
        return None
    return {
        "freq_cy_per_px": [round(f, 6) for f in curve.freq_cy_per_px.tolist()],
        "mtf": curve.mtf.tolist(),
        "edges": curve.edges,
    }


_Matrix = list[list[float]]


class StoredEdge(BaseModel):
    """One edge of a psf.json."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    image: str
    capture: int | None
    height_mm: float | None
    x_px: float
    y_px: float
    angle_deg: float
    orientation: Literal["vertical", "horizontal", "diagonal"]
    length_px: float
    snr: float | None
    sigma_px: float
    sigma_err_px: float
    optical_sigma_px: float | None
    optical_sigma_err_px: float | None
    mtf50_cy_per_px: float
    chi2_reduced: float | None
    flags: list[str]
    esfr_mtf50_cy_per_px: float | None = None
    esfr_mtf50_err_cy_per_px: float | None = None
    esfr_mtf20_cy_per_px: float | None = None
    contrast: float | None = None
    roughness_px: float | None = None
    clipped_fraction: float | None = None


class StoredField(BaseModel):
    """The PSF over the frame, in a psf.json: what ``PsfField`` takes, rows xx, xy and yy.

    The coefficients without prefix are those of the total covariance.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    width_px: int
    height_px: int
    coefficients_px2: _Matrix
    optical_coefficients_px2: _Matrix | None = None
    coefficients_err_px2: _Matrix | None = None
    optical_coefficients_err_px2: _Matrix | None = None
    p_value: float | None = None
    worst_err: float | None = None
    edges: int | None = None


class StoredHeight(BaseModel):
    """Width at one height over that of the whole calibration, in a psf.json."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    height_mm: float
    edges: int
    relative_width: float
    relative_width_err: float
    sigma_x_px: float | None = None
    sigma_x_err_px: float | None = None
    sigma_y_px: float | None = None
    sigma_y_err_px: float | None = None


class StoredHeightTrend(BaseModel):
    """Whether the width changes with the camera's height, in a psf.json."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    slope_per_mm: float
    slope_err_per_mm: float
    p_value: float
    p_value_between: float
    is_drift: bool
    heights: list[StoredHeight]


class StoredCurve(BaseModel):
    """A transfer function along one axis, in a psf.json."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    freq_cy_per_px: list[float]
    mtf: list[float]
    edges: int | None = None


class StoredTransfer(BaseModel):
    """Measured transfer functions along both axes, in a psf.json."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    x: StoredCurve | None = None
    y: StoredCurve | None = None


class StoredCamera(BaseModel):
    """The camera that a psf.json belongs to, as far as it is known."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    serial: str | None = None
    model: str | None = None
    vendor: str | None = None


class StoredPsf(BaseModel):
    """What a psf.json holds; None for what its edges did not determine.

    sigma without prefix is the total PSF. Only the total values need to be there.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    sigma_x_px: float | None = None
    sigma_y_px: float | None = None
    rho: float | None = None
    covariance_px2: _Matrix | None = None
    sigma_x_err_px: float | None = None
    sigma_y_err_px: float | None = None
    rho_err: float | None = None
    optical_sigma_x_px: float | None = None
    optical_sigma_y_px: float | None = None
    optical_sigma_x_err_px: float | None = None
    optical_sigma_y_err_px: float | None = None
    optical_rho: float | None = None
    optical_rho_err: float | None = None
    optical_covariance_px2: _Matrix | None = None
    intervals_95: dict[str, tuple[float, float]] = {}
    field: StoredField | None = None
    method: str | None = None
    edges: list[StoredEdge] = []
    height_trend: StoredHeightTrend | None = None
    transfer: StoredTransfer | None = None
    camera: StoredCamera | None = None
    captured_utc: str | None = None
    region: str | None = None
    channel: str | None = None
    channels: "dict[str, StoredPsf] | None" = None

    def total_psf(self, source: str) -> GaussianPsf:
        """Return the total PSF; a correlation that is not given is taken as none.

        Raises
        ------
        PsfFileError
            If a width is null; the message names ``source`` and the width.
        """
        for name, edges in (("sigma_x_px", "vertical"), ("sigma_y_px", "horizontal")):
            if getattr(self, name) is None:
                raise PsfFileError(
                    f"{source}: {name} is null: its edges do not determine it; "
                    f"calibrate with {edges} edges as well"
                )
        try:
            return GaussianPsf(
                sigma_x_px=float(self.sigma_x_px or 0.0),
                sigma_y_px=float(self.sigma_y_px or 0.0),
                rho=self.rho or 0.0,
            )
        except ValueError as error:
            raise PsfFileError(f"{source}: {error}") from error

    def total_field(self, source: str) -> PsfField | None:
        """Return the total PSF over the frame, None where the file has none.

        Raises
        ------
        PsfFileError
            If its coefficients make no PSF; the message names ``source``.
        """
        if self.field is None:
            return None
        try:
            return PsfField(
                width_px=self.field.width_px,
                height_px=self.field.height_px,
                coefficients_px2=np.array(self.field.coefficients_px2, dtype=np.float64),
            )
        except ValueError as error:
            raise PsfFileError(f"{source}: field: {error}") from error

    def measured_transfer(self, source: str) -> CameraTransfer:
        """Return the transfer functions that the edges show, with no Gaussian assumed.

        Raises
        ------
        PsfFileError
            If an axis has none, or its samples are no transfer function.
        """
        curves = []
        for axis, edges in (("y", "horizontal"), ("x", "vertical")):
            stored: StoredCurve | None = getattr(self.transfer, axis, None)
            if stored is None:
                raise PsfFileError(
                    f"{source}: it holds no transfer function along {axis}; "
                    f"calibrate with {edges} edges"
                )
            try:
                curves.append(SampledTransfer(stored.freq_cy_per_px, stored.mtf))
            except ValueError as error:
                raise PsfFileError(f"{source}: transfer.{axis}: {error}") from error
        return CameraTransfer(along_y=curves[0], along_x=curves[1])
