from .board import DEFAULT_BOARD as DEFAULT_BOARD, CharucoBoard as CharucoBoard
from .calibration import (
    GeometryOptions as GeometryOptions,
    calibrate_geometry as calibrate_geometry,
)
from .captures import (
    geometry_captures as geometry_captures,
    geometry_records as geometry_records,
    nominal_focal_px as nominal_focal_px,
)
from .document import (
    GEOMETRY_SCHEMA as GEOMETRY_SCHEMA,
    CaptureGeometry as CaptureGeometry,
    ExcludedCapture as ExcludedCapture,
    GeometryCalibration as GeometryCalibration,
    HeightZoom as HeightZoom,
)
from .series import GeometryCapture as GeometryCapture

__all__ = [
    "DEFAULT_BOARD",
    "GEOMETRY_SCHEMA",
    "CaptureGeometry",
    "CharucoBoard",
    "ExcludedCapture",
    "GeometryCalibration",
    "GeometryCapture",
    "GeometryOptions",
    "HeightZoom",
    "calibrate_geometry",
    "geometry_captures",
    "geometry_records",
    "nominal_focal_px",
]
