"""Makes a capture session from photographs taken by another program."""

import os
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import Any

import numpy as np

from acquisition.choices import CaptureKind
from acquisition.photographs import (
    Photograph as ReadPhotograph,
    PhotographFacts,
    ReadOptions,
    shared_facts,
)
from acquisition.plan import CapturePlan, parse_plan
from acquisition.printable import on_one_line
from acquisition.session import Photograph, SessionWriter
from simulation.arguments import checked
from simulation.notebook import Shown
from standoff.errors import ApplicationError
from standoff.library.call import Call, Progress
from standoff.library.caller import login_name
from standoff.library.inputs import FilePath, path_of

_LONGEST_TARGET = 200
"""Letters that a plan accepts."""


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class ImportedPhotographs(Shown):
    """A session made of photographs: how many were given, and how many it did not hold yet."""

    session: Path
    photographs: int
    imported: int
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the counts as ``standoff import --json`` prints them."""
        return {
            "session": str(self.session),
            "imported": self.imported,
            "photographs": self.photographs,
        }


@checked
def import_photographs(
    images: Iterable[FilePath],
    out: FilePath,
    *,
    kind: CaptureKind,
    height_mm: float,
    scale_px_per_mm: float | None = None,
    operator: str | None = None,
    white_level: float | None = None,
    reading: ReadOptions | None = None,
    progress: Progress | None = None,
) -> ImportedPhotographs:
    """Make a session from photographs taken by another program: grey, linear, one frame each.

    Each photograph is a target of its own, named after its file. The same call resumes.

    Parameters
    ----------
    images
        Files, of one kind.
    out
        Folder of the session.
    kind
        What the photographs show.
    height_mm
        Of the camera; 0 if nobody knows it: a PSF needs no height, geometry and validation do.
    scale_px_per_mm
        In the plane of the target.
    operator
        The login name by default.
    white_level
        Level, as it is stored, at which they are clipped; the files' own by default.
    reading
        How files are read; see ``standoff.reading``.
    progress
        Who watches.

    Returns
    -------
    ImportedPhotographs
        How many were imported now.

    Raises
    ------
    ArgumentError
        If a height or scale cannot be.
    ApplicationError
        If two photographs have one name, or one cannot be read.
    SessionError
        If ``out`` is another session, or cannot be written.

    Examples
    --------
    >>> paths = ["before.tif", "after.tif"]
    >>> standoff.import_photographs(paths, "imported", kind="texture", height_mm=0).imported
    2
    """
    call = Call("import_photographs", progress, reading, white_level=white_level)
    paths, folder = [path_of(image, "images") for image in images], path_of(out, "out")
    plan = _plan_of(paths, kind, height_mm)
    # A bad file is named before anything is written.
    facts = []
    for path in paths:
        read = call.inputs.photograph(path)
        read.refuse_mosaic()
        facts.append(read.facts)
    with (
        SessionWriter(
            folder,
            plan=plan,
            bench=None,
            devices=_devices(facts),
            operator=operator or login_name(),
        ) as session,
        call.bar("importing", len(paths)) as advance_to,
    ):
        pending = session.pending_entries()
        for done, entry in enumerate(pending, start=len(paths) - len(pending) + 1):
            read = call.inputs.photograph(paths[entry.index])
            if read.is_colour:
                call.note(f"{read.name}: colour stored as Rec. 601 luma")
            session.add_photograph(entry, _stored(read, scale_px_per_mm))
            advance_to(done)
    return ImportedPhotographs(
        session=folder, photographs=len(paths), imported=len(pending), notes=call.notes
    )


def _plan_of(images: Sequence[Path], kind: CaptureKind, height_mm: float) -> CapturePlan:
    twice = [name for name, count in Counter(p.name for p in images).items() if count > 1]
    if twice:
        raise ApplicationError(f"two photographs are named {twice[0]}; rename one of them")
    return parse_plan(
        {
            "schema": "standoff.plan/1",
            "name": "imported photographs",
            "targets": [
                {
                    "kind": kind,
                    "target": _target_of(path),
                    "heights_mm": [height_mm],
                }
                for path in images
            ],
        },
        source="import",
    )


def _target_of(path: Path) -> str:
    """The name of a photograph, shortened where it is longer than that of a target may be."""
    shown = on_one_line(path.name)
    if len(shown) <= _LONGEST_TARGET:
        return shown
    digest = sha256(os.fsencode(path.name)).hexdigest()[:8]
    return f"{shown[: _LONGEST_TARGET - 9]}~{digest}"


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
