"""Makes a capture session from photographs taken by another program."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from acquisition.choices import CaptureKind
from acquisition.plan import CapturePlan, parse_plan
from acquisition.printable import on_one_line
from acquisition.session import Photograph, SessionWriter
from standoff.errors import ApplicationError
from standoff.photographs import Inputs, Photograph as ReadPhotograph, PhotographFacts, shared_facts
from standoff.terminal import note, progress_bar


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportSettings:
    """Settings common to all photographs."""

    kind: CaptureKind
    height_mm: float
    scale_px_per_mm: float | None
    operator: str


def import_into_session(
    out: Path, images: Sequence[Path], settings: ImportSettings, inputs: Inputs
) -> int:
    """Write the photographs that the session at ``out`` does not hold yet; return how many.

    Raises
    ------
    ApplicationError
        If two photographs have one name, or one cannot be read.
    SessionError
        If ``out`` is another session, or cannot be written.
    """
    plan = _plan_of(images, settings)
    # A bad file is named before anything is written.
    facts = []
    for path in images:
        read = inputs.photograph(path)
        read.refuse_mosaic()
        facts.append(read.facts)
    with (
        SessionWriter(
            out, plan=plan, bench=None, devices=_devices(facts), operator=settings.operator
        ) as session,
        progress_bar("importing", len(images)) as bar,
    ):
        pending = session.pending_entries()
        for done, entry in enumerate(pending, start=len(images) - len(pending) + 1):
            read = inputs.photograph(images[entry.index])
            if read.is_colour:
                note(f"{read.name}: colour stored as Rec. 601 luma")
            session.add_photograph(entry, _stored(read, settings.scale_px_per_mm))
            bar.advance_to(done)
    return len(pending)


def _plan_of(images: Sequence[Path], settings: ImportSettings) -> CapturePlan:
    twice = [name for name, count in Counter(p.name for p in images).items() if count > 1]
    if twice:
        raise ApplicationError(f"two photographs are named {twice[0]}; rename one of them")
    return parse_plan(
        {
            "schema": "standoff.plan/1",
            "name": "imported photographs",
            "targets": [
                {
                    "kind": settings.kind,
                    "target": on_one_line(path.name),
                    "heights_mm": [settings.height_mm],
                }
                for path in images
            ],
        },
        source="import",
    )


def _devices(facts: Sequence[PhotographFacts]) -> dict[str, dict[str, object]]:
    """What all photographs say alike of their camera and lens."""
    camera: dict[str, object] = shared_facts(facts)
    keys = ("lens", "focal_length_mm", "f_number")
    lens = {key: camera.pop(key) for key in keys if key in camera}
    if "camera" in camera:
        camera["DeviceModelName"] = camera.pop("camera")
    return {name: values for name, values in (("camera", camera), ("lens", lens)) if values}


def _stored(read: ReadPhotograph, scale_px_per_mm: float | None) -> Photograph:
    grey = read.grey_dn.astype(np.float32)
    variance = read.grey_variance_dn2
    exposure_s = read.facts.exposure_s
    top_dn = read.saturation_dn
    if top_dn is None:  # a float file tells nothing, and counts none as clipped
        top_dn = float(np.nextafter(grey.max(), np.float32(np.inf)))
    return Photograph(
        image_dn=grey,
        pixel_format=f"Mono{8 * read.stored.dtype.itemsize}",
        max_level_dn=top_dn,
        exposure_us=None if exposure_s is None else 1e6 * exposure_s,
        scale_px_per_mm=scale_px_per_mm,
        variance_dn2=None if variance is None else variance.astype(np.float32),
        frames=read.frames if variance is not None else 1,
    )
