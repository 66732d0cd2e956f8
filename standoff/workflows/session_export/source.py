"""What an export is made of: the captures of a session, one at a time, and what goes with them."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import isfinite

from acquisition.session import CaptureImages, CaptureRecord, Session
from calibration.geometry import GeometryCalibration
from calibration.provenance import Provenance


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportSource:
    """A session to export, read capture by capture.

    Parameters
    ----------
    geometry
        Gives the scale of captures that have none of their own; None if it is not known.
    progress
        Called with the number of captures read.
    """

    session: Session
    provenance: Provenance
    geometry: GeometryCalibration | None
    progress: Callable[[int], None]

    @property
    def records(self) -> tuple[CaptureRecord, ...]:
        """The captures that are exported: neither superseded nor excluded."""
        return self.session.records

    def captures(self) -> Iterator[CaptureImages]:
        """Every capture with its pixels, checked against the journal; one is held at a time.

        Raises
        ------
        SessionError
            If a file is missing or is not the one that was captured.
        """
        for done, record in enumerate(self.records, start=1):
            yield self.session.load(record)
            self.progress(done)

    def scale_px_per_mm(self, record: CaptureRecord) -> float | None:
        """Scale on the target: the capture's own, or that of the geometry at its height.

        It is inversely proportional to the distance from the entrance pupil, and taken over from
        the nearest height of the geometry; beyond its heights there is none.
        """
        found = record.scale_px_per_mm
        if found is None and self.geometry is not None:
            found = _scale_at(record.height_mm, self.geometry)
        return found if found is not None and isfinite(found) and found > 0 else None


_BEYOND_MM = 0.1
"""Heights read back scatter by the tolerance of the stage, which is less."""


def _scale_at(height_mm: float, geometry: GeometryCalibration) -> float | None:
    known = list(zip(geometry.heights_mm, geometry.scale_px_per_mm or (), strict=False))
    distance_mm = height_mm + geometry.pupil_offset_mm
    if not known or distance_mm <= 0:
        return None
    if not min(known)[0] - _BEYOND_MM <= height_mm <= max(known)[0] + _BEYOND_MM:
        return None
    at_mm, scale = min(known, key=lambda pair: abs(pair[0] - height_mm))
    return scale * (at_mm + geometry.pupil_offset_mm) / distance_mm
