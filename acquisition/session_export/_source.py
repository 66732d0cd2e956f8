"""What an export is made of: the captures of a session, one at a time, and what goes with them."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Any

from acquisition.session import CaptureImages, CaptureRecord, Session


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportSource:
    """A session to export, read capture by capture.

    ``scale_at`` returns the scale in px/mm at a height, for captures that have none of their own.
    """

    session: Session
    provenance: Mapping[str, Any]
    scale_at: Callable[[float], float | None]
    progress: Callable[[int], None]

    @property
    def records(self) -> tuple[CaptureRecord, ...]:
        """The captures that are exported: neither superseded nor excluded."""
        return self.session.records

    def captures(self) -> Iterator[CaptureImages]:
        """Every capture with its pixels, checked against the journal; one is held at a time."""
        for done, record in enumerate(self.records, start=1):
            yield self.session.load(record)
            self.progress(done)

    def scale_px_per_mm(self, record: CaptureRecord) -> float | None:
        """Scale on the target: the capture's own, or that at its height."""
        found = record.scale_px_per_mm
        if found is None:
            found = self.scale_at(record.height_mm)
        return found if found is not None and isfinite(found) and found > 0 else None
