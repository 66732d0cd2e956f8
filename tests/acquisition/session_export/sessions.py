"""A session worth exporting: two placements, a retake, an exclusion, a photograph with a scale."""

from pathlib import Path

import numpy as np

from acquisition.choices import ExportFormat
from acquisition.files import InputFile, Provenance
from acquisition.plan import plan_entries
from acquisition.session import Photograph, Session, SessionNotes
from acquisition.session_export import ExportRequest
from calibration.geometry import GeometryCalibration
from tests.acquisition.session_fixtures import add, plan_of, whole_session, writer

PROVENANCE = Provenance(
    version="9.9",
    created="2025-03-04T05:06:07Z",
    command="standoff export session",
    inputs=(InputFile(path="session/journal.jsonl", sha256="ab" * 32),),
)

SCALE_PX_PER_MM = (8.0, 10.0)
"""At 110 and 100 mm; the heights read back are 2 um higher."""


def exported_session(path: Path) -> Session:
    """Two heights of an edge at 5 and 95 degrees and of a flat; of one, the second take counts.

    One of the six captures is excluded.
    """
    whole_session(path)
    with writer(path) as session:
        session.retake(1, "again", "Zoë")
        add(session, session.entries[1], 1500.0)
    SessionNotes(path, operator="Zoë").exclude(2, "a hair & a <smear>")
    return Session(path)


def photographed_session(path: Path) -> Session:
    """Two photographs of different sizes, the first with a scale, neither with a variance."""
    plan = plan_of(heights_mm=[100.0], targets=[{"kind": "edge", "target": "Kante <1> & 2"}])
    larger = plan_of(heights_mm=[100.0, 110.0], targets=plan.to_json()["targets"])
    with writer(path, plan=larger) as session:
        for entry, shape, scale in zip(
            plan_entries(larger), ((4, 6), (5, 7)), (12.5, None), strict=True
        ):
            session.add_photograph(
                entry,
                Photograph(
                    image_dn=np.full(shape, 100.0, np.float32),
                    pixel_format="JPEG",
                    max_level_dn=255.0,
                    scale_px_per_mm=scale,
                ),
            )
    return Session(path)


def geometry() -> GeometryCalibration:
    """Scales of 10 px/mm at 100 mm and 8 px/mm at 110 mm."""
    return GeometryCalibration(
        heights_mm=(100.0, 110.0),
        scale_px_per_mm=SCALE_PX_PER_MM[::-1],
        pupil_offset_mm=-60.0,
        k1=None,
        k2=None,
        tilt_deg=None,
        axis_drift_px_per_mm=None,
    )


def request_of(format_: ExportFormat, out: Path, *, with_scale: bool = True) -> ExportRequest:
    return ExportRequest(
        format=format_,
        out=out,
        provenance=PROVENANCE.model_dump(mode="json"),
        scale_at=geometry().scale_at if with_scale else lambda _: None,
    )


def scale_at(height_mm: float) -> float:
    """The inverse of the scale is linear in height: from 0.1 mm/px at 100 to 0.125 at 110 mm."""
    return 1 / (0.1 + 0.0025 * (height_mm - 100.0))
