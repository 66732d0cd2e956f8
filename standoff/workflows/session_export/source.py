"""What an export is made of: the captures of a session, one at a time, and what goes with them."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

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
        if record.scale_px_per_mm is not None:
            return record.scale_px_per_mm
        if self.geometry is None or self.geometry.scale_px_per_mm is None:
            return None
        heights_mm = np.array(self.geometry.heights_mm)
        low_mm, high_mm = heights_mm.min() - _BEYOND_MM, heights_mm.max() + _BEYOND_MM
        if not low_mm <= record.height_mm <= high_mm:
            return None
        nearest = int(np.argmin(np.abs(heights_mm - record.height_mm)))
        pupil_mm = self.geometry.pupil_offset_mm
        ratio = (heights_mm[nearest] + pupil_mm) / (record.height_mm + pupil_mm)
        return float(self.geometry.scale_px_per_mm[nearest] * ratio)


_BEYOND_MM = 0.1
"""Heights read back scatter by the tolerance of the stage, which is less."""
