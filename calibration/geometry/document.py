"""The content of geometry.json, and what a reader needs of it."""

from itertools import combinations
from math import atan, degrees
from typing import Any

from pydantic import BaseModel, ConfigDict

from calibration.geometry.results import GeometryCalibration, Measured, ScaleSource

__all__ = [
    "GEOMETRY_SCHEMA",
    "StoredExclusion",
    "StoredGeometry",
    "StoredGeometryCapture",
    "StoredZoom",
    "geometry_document",
]

GEOMETRY_SCHEMA = "standoff.geometry/1"


class StoredZoom(BaseModel):
    """True zoom-out of a pair of heights, in a geometry.json."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    near_height_mm: float
    far_height_mm: float
    zoom: float
    zoom_err: float


class StoredGeometryCapture(BaseModel):
    """One capture that was used, in a geometry.json."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    image: str
    kind: str
    target: str
    height_mm: float
    scale_px_per_mm: float | None
    scale_err_px_per_mm: float | None
    height_residual_mm: float
    sideways_mm: tuple[float, float]
    matches: int
    rms_px: float


class StoredExclusion(BaseModel):
    """A capture that was not used, and why, in a geometry.json."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    image: str
    reason: str


class StoredGeometry(BaseModel):
    """What a geometry.json holds; null is what the captures did not determine.

    A reader needs the keys without a default alone.
    """

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)

    heights_mm: list[float]
    scale_px_per_mm: list[float] | None
    pupil_offset_mm: float
    k1: float | None
    k2: float | None
    tilt_deg: float | None
    axis_drift_px_per_mm: float | None
    scale_err_px_per_mm: list[float] | None = None
    scale_source: ScaleSource | None = None
    pupil_offset_err_mm: float | None = None
    pupil_offset_interval_95_mm: tuple[float, float] | None = None
    height_scatter_mm: float | None = None
    focal_length_px: float | None = None
    focal_length_err_px: float | None = None
    k1_err: float | None = None
    k2_err: float | None = None
    k1_opencv: float | None = None
    k2_opencv: float | None = None
    tilt_err_deg: float | None = None
    tilt_x_deg: float | None = None
    tilt_y_deg: float | None = None
    tilt_x_err_deg: float | None = None
    tilt_y_err_deg: float | None = None
    axis_drift_err_px_per_mm: float | None = None
    stage_angle_deg: float | None = None
    stage_angle_err_deg: float | None = None
    pierce_px: tuple[float, float] | None = None
    width_px: int | None = None
    height_px: int | None = None
    zooms: list[StoredZoom] = []
    captures: list[StoredGeometryCapture] = []
    excluded: list[StoredExclusion] = []
    undetermined: dict[str, str] = {}
    notes: list[str] = []

    def zoom(self, near_mm: float, far_mm: float) -> float:
        """True zoom-out of two heights: the ratio of the distances from the entrance pupil."""
        return (far_mm + self.pupil_offset_mm) / (near_mm + self.pupil_offset_mm)


def geometry_document(geometry: GeometryCalibration) -> dict[str, Any]:
    """Return the content of geometry.json as plain lists and numbers."""
    pupil = geometry.pupil
    scales = geometry.scales
    reach_mm = pupil.interval_factor * pupil.pupil_offset_err_mm
    document: dict[str, Any] = {
        "schema": GEOMETRY_SCHEMA,
        "heights_mm": list(geometry.heights_mm),
        "scale_px_per_mm": None if scales is None else [s.value for s in scales],
        "scale_err_px_per_mm": None if scales is None else [s.err for s in scales],
        "scale_source": geometry.scale_source,
        "pupil_offset_mm": pupil.pupil_offset_mm,
        "pupil_offset_err_mm": pupil.pupil_offset_err_mm,
        "pupil_offset_interval_95_mm": [
            pupil.pupil_offset_mm - reach_mm,
            pupil.pupil_offset_mm + reach_mm,
        ],
        "height_scatter_mm": pupil.scatter_mm,
        **_pair("focal_length_px", geometry.focal_length_px, "focal_length_err_px"),
        **_pair("k1", geometry.k1),
        **_pair("k2", geometry.k2),
        **_opencv(geometry),
    }
    principal = geometry.principal_px or (None, None)
    for axis, value in zip("xy", principal, strict=True):
        document |= _pair(f"principal_{axis}_px", value, f"principal_{axis}_err_px")
    for name in ("tilt_deg", "tilt_x_deg", "tilt_y_deg"):
        document |= _pair(name, getattr(geometry, name), name.replace("_deg", "_err_deg"))
    document |= _pair(
        "axis_drift_px_per_mm", geometry.axis_drift_px_per_mm, "axis_drift_err_px_per_mm"
    )
    for axis, value in zip("xy", geometry.axis_drift, strict=True):
        document |= _pair(f"axis_drift_{axis}_px_per_mm", value, f"axis_drift_{axis}_err_px_per_mm")
    document["axis_drift_height_mm"] = geometry.heights_mm[0]
    document |= _stage_angle(geometry)
    document["pierce_px"] = list(geometry.pierce_px)
    document["width_px"], document["height_px"] = geometry.width_px, geometry.height_px
    document["zooms"] = _zooms(geometry)
    document["captures"] = _captures(geometry)
    document["excluded"] = [{"image": n, "reason": r} for n, r in geometry.excluded]
    document["undetermined"] = geometry.undetermined
    document["notes"] = list(geometry.notes)
    return document


def _pair(name: str, measured: Measured | None, err_name: str | None = None) -> dict[str, Any]:
    """A value and its error, null where it is not determined."""
    return {
        name: None if measured is None else measured.value,
        err_name or f"{name}_err": None if measured is None else measured.err,
    }


def _opencv(geometry: GeometryCalibration) -> dict[str, Any]:
    """The distortion in OpenCV's coordinates, normalised by the focal length."""
    values: dict[str, Any] = {}
    for name, measured, power in (("k1", geometry.k1, 2), ("k2", geometry.k2, 4)):
        if geometry.focal_length_px is None or measured is None:
            values[f"{name}_opencv"] = values[f"{name}_opencv_err"] = None
            continue
        factor = (geometry.focal_length_px.value / geometry.corner_radius_px) ** power
        values[f"{name}_opencv"] = measured.value * factor
        values[f"{name}_opencv_err"] = measured.err * factor
    return values


def _stage_angle(geometry: GeometryCalibration) -> dict[str, Any]:
    """Angle between the stage's travel and the line of sight of the middle of the image."""
    drift, focal = geometry.axis_drift_px_per_mm, geometry.focal_length_px
    if focal is None:
        return {"stage_angle_deg": None, "stage_angle_err_deg": None}
    distance_mm = geometry.heights_mm[0] + geometry.pupil.pupil_offset_mm
    return {
        "stage_angle_deg": degrees(atan(drift.value * distance_mm / focal.value)),
        "stage_angle_err_deg": degrees(drift.err * distance_mm / focal.value),
    }


def _zooms(geometry: GeometryCalibration) -> list[dict[str, float]]:
    pairs = []
    for near_mm, far_mm in combinations(geometry.heights_mm, 2):
        zoom, err = geometry.pupil.zoom(near_mm, far_mm)
        pairs.append(
            {"near_height_mm": near_mm, "far_height_mm": far_mm, "zoom": zoom, "zoom_err": err}
        )
    return pairs


def _captures(geometry: GeometryCalibration) -> list[dict[str, Any]]:
    return [
        {
            "image": capture.name,
            "capture": capture.index,
            "kind": capture.kind,
            "target": capture.target,
            "orientation_deg": capture.orientation_deg,
            "height_mm": capture.height_mm,
            **_pair("scale_px_per_mm", capture.scale_px_per_mm, "scale_err_px_per_mm"),
            "height_residual_mm": capture.height_residual_mm,
            "sideways_mm": list(capture.sideways_mm),
            "matches": capture.match_count,
            "rms_px": capture.rms_px,
        }
        for capture in geometry.captures
    ]
