"""Makes a capture session from photographs taken by another program."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from acquisition.choices import CaptureKind
from acquisition.plan import CapturePlan, parse_plan
from acquisition.session import Photograph, SessionWriter
from calibration.psf import luma_plane, srgb_to_linear
from simulation.arrays import FloatArray
from standoff.errors import ApplicationError, ImageFileError
from standoff.terminal import note, progress_bar
from standoff.workflows.image_files import ImageFile, read_image


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportSettings:
    """Settings common to all photographs; a ``height_mm`` of None is recorded as 0."""

    kind: CaptureKind
    height_mm: float | None
    scale_px_per_mm: float | None
    is_srgb: bool
    operator: str


def import_into_session(out: Path, images: Sequence[Path], settings: ImportSettings) -> int:
    """Write the photographs that the session at ``out`` does not have yet; return how many.

    Raises
    ------
    ApplicationError
        If two photographs have the same name, or one cannot be read.
    SessionError
        If ``out`` is another session, or cannot be written.
    """
    plan = _plan_of(images, settings)
    for path in images:  # a bad file is named before anything is written
        _plane(read_image(path), is_srgb=settings.is_srgb)
    if settings.height_mm is None:
        note(
            "no --height-mm given, so 0 mm is recorded; geometry and validate need the true height"
        )
    with (
        SessionWriter(
            out, plan=plan, bench=None, devices={}, operator=settings.operator
        ) as session,
        progress_bar("importing", len(images)) as bar,
    ):
        pending = session.pending_entries()
        for done, entry in enumerate(pending, start=len(images) - len(pending) + 1):
            file = read_image(images[entry.index])
            if file.is_colour:
                note(f"{file.path}: colour stored as Rec. 601 luma")
            plane = _plane(file, is_srgb=settings.is_srgb)
            session.add_photograph(
                entry,
                Photograph(
                    image_dn=plane.astype(np.float32),
                    pixel_format=f"Mono{8 * file.pixels.dtype.itemsize}",
                    max_level_dn=_top_dn(file, plane, is_srgb=settings.is_srgb),
                    scale_px_per_mm=settings.scale_px_per_mm,
                ),
            )
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
                    "target": path.name,
                    "heights_mm": [settings.height_mm or 0.0],
                }
                for path in images
            ],
        },
        source="import",
    )


def _plane(file: ImageFile, *, is_srgb: bool) -> FloatArray:
    pixels = file.pixels
    if is_srgb:
        pixels = srgb_to_linear(pixels, file.full_scale_dn or 1.0)
    try:
        return luma_plane(pixels)
    except ValueError as error:
        raise ImageFileError(f"{file.path}: {error}") from error


def _top_dn(file: ImageFile, plane: FloatArray, *, is_srgb: bool) -> float:
    """Level at which the file clips; a float file gives none, and nothing counts as clipped."""
    if file.saturation_dn is None:
        return float(np.nextafter(np.float32(plane.max()), np.float32(np.inf)))
    if is_srgb:
        return float(srgb_to_linear(np.array(file.saturation_dn), file.full_scale_dn or 1.0))
    return file.saturation_dn
