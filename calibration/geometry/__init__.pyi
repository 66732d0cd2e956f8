from .board import DEFAULT_BOARD as DEFAULT_BOARD, CharucoBoard as CharucoBoard
from .calibration import calibrate_geometry as calibrate_geometry
from .captures import (
    geometry_captures as geometry_captures,
    geometry_records as geometry_records,
    nominal_focal_px as nominal_focal_px,
)
from .document import (
    GEOMETRY_SCHEMA as GEOMETRY_SCHEMA,
    StoredGeometry as StoredGeometry,
    StoredGeometryCapture as StoredGeometryCapture,
    StoredZoom as StoredZoom,
    geometry_document as geometry_document,
)
from .results import (
    GeometryCalibration as GeometryCalibration,
    GeometryOptions as GeometryOptions,
    Measured as Measured,
)
from .series import GeometryCapture as GeometryCapture

__all__ = [
    "DEFAULT_BOARD",
    "GEOMETRY_SCHEMA",
    "CharucoBoard",
    "GeometryCalibration",
    "GeometryCapture",
    "GeometryOptions",
    "Measured",
    "StoredGeometry",
    "StoredGeometryCapture",
    "StoredZoom",
    "calibrate_geometry",
    "geometry_captures",
    "geometry_document",
    "geometry_records",
    "nominal_focal_px",
]
