"""The content of psf.json as plain lists and numbers."""

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from calibration.covariance_fit import Estimate, median_width
from calibration.height_trend import HeightTrend
from calibration.measured_transfer import AxisTransfer, MeasuredTransfer
from calibration.psf_calibration import EdgeMeasurement, PsfCalibration
from calibration.psf_field import FieldFit

__all__ = ["PSF_SCHEMA", "PsfOrigin", "edge_document", "psf_document"]

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
