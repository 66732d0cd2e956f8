"""The board, chart and texture captures of a session as input to the geometry calibration."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from acquisition.session import CaptureRecord, Session
from calibration.errors import GeometryError
from calibration.geometry.series import GeometryCapture

GEOMETRY_KINDS = ("board", "chart", "texture")


def geometry_records(session: Session) -> list[CaptureRecord]:
    """Return the captures with features in two dimensions.

    Raises
    ------
    GeometryError
        If the session has none.
    """
    records = [record for record in session.records if record.kind in GEOMETRY_KINDS]
    if not records:
        raise GeometryError(
            f"{session.path}: the session has no capture of kind {', '.join(GEOMETRY_KINDS)}; "
            "edges alone do not determine the geometry",
            reason="no_captures",
        )
    return records


def geometry_captures(session: Session) -> Iterator[GeometryCapture]:
    """Load these captures one by one, at the heights that were read back.

    Raises
    ------
    GeometryError
        If the session has none.
    SessionError
        If a capture file is missing or changed.
    """
    for record in geometry_records(session):
        yield GeometryCapture(
            name=record.file,
            kind=record.kind,
            target=record.target,
            orientation_deg=record.orientation_deg,
            height_mm=record.height_mm,
            image=session.load(record).mean_dn,
            index=record.index,
        )


def nominal_focal_px(session: Session) -> float | None:
    """Focal length divided by pixel pitch, from the bench file; None if it lacks one of them."""
    optics: Any = session.bench.get("optics")
    if not isinstance(optics, dict):
        return None
    focal_mm, pitch_um = optics.get("focal_length_mm"), optics.get("pixel_pitch_um")
    if not (isinstance(focal_mm, int | float) and isinstance(pitch_um, int | float)):
        return None
    if not (focal_mm > 0 and pitch_um > 0):
        return None
    with np.errstate(over="ignore", divide="ignore"):
        focal_px = float(np.float64(focal_mm) / (np.float64(pitch_um) * 1e-3))
    return focal_px if np.isfinite(focal_px) else None
