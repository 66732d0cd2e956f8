"""``standoff import``: photographs from elsewhere as a capture session."""

import getpass
import math
from collections import Counter
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from acquisition.plan import CaptureKind, CapturePlan, parse_plan
from acquisition.session import Photograph, SessionWriter
from calibration.psf import luma_plane, srgb_to_linear
from standoff.errors import ApplicationError, ImageFileError
from standoff.terminal import Json, note, print_json, progress_bar, say
from standoff.workflows import ImageFile, read_image

__all__ = ["import_photographs"]


def import_photographs(
    images: Annotated[
        list[Path], typer.Argument(help="Photographs of one kind.", show_default=False)
    ],
    *,
    kind: Annotated[CaptureKind, typer.Option(help="What they show.")],
    out: Annotated[Path, typer.Option(help="Session directory, new or to be resumed.")],
    height_mm: Annotated[
        float | None, typer.Option(help="Height of the camera; 0 if it is not known.")
    ] = None,
    scale: Annotated[
        float | None, typer.Option(help="Scale in the plane of the target, in px/mm.")
    ] = None,
    srgb: Annotated[
        bool, typer.Option("--srgb/--linear", help="Undo the sRGB curve, or take as linear.")
    ] = False,
    operator: Annotated[str | None, typer.Option(help="Who imports; the login name.")] = None,
    json: Json = False,
) -> None:
    """Make a session of photographs that another program took: grey, linear, one frame each.

    Each photograph is a target of its own, named by its file.
    """
    if height_mm is not None and not math.isfinite(height_mm):
        raise typer.BadParameter(f"a height is a finite number, got {height_mm}")
    if scale is not None and not (math.isfinite(scale) and scale > 0):
        raise typer.BadParameter(f"a scale is a positive number of px/mm, got {scale}")
    plan = _plan_of(images, kind, height_mm or 0.0)
    for path in images:
        _plane(read_image(path), is_srgb=srgb)  # a bad file is named before anything is written
    if height_mm is None:
        note("the height is not given and is recorded as 0 mm; geometry and validate need it")
    with (
        SessionWriter(
            out, plan=plan, bench=None, devices={}, operator=operator or getpass.getuser()
        ) as session,
        progress_bar("importing", len(images)) as bar,
    ):
        pending = session.pending_entries()
        for done, entry in enumerate(pending, start=len(images) - len(pending) + 1):
            file = read_image(images[entry.index])
            if file.is_colour:
                note(f"{file.path}: colour stored as Rec. 601 luma")
            plane = _plane(file, is_srgb=srgb)
            session.add_photograph(
                entry,
                Photograph(
                    image_dn=plane.astype(np.float32),
                    pixel_format=f"Mono{8 * file.pixels.dtype.itemsize}",
                    max_level_dn=_top_dn(file, plane, is_srgb=srgb),
                    scale_px_per_mm=scale,
                ),
            )
            bar.advance_to(done)
    if json:
        print_json({"session": str(out), "imported": len(pending), "photographs": len(images)})
        return
    say(f"{out}: {len(pending)} of {len(images)} photographs imported")


def _plan_of(images: list[Path], kind: CaptureKind, height_mm: float) -> CapturePlan:
    twice = [name for name, count in Counter(p.name for p in images).items() if count > 1]
    if twice:
        raise ApplicationError(f"two photographs are called {twice[0]}; rename one of them")
    return parse_plan(
        {
            "schema": "standoff.plan/1",
            "name": "imported photographs",
            "targets": [
                {"kind": kind, "target": path.name, "heights_mm": [height_mm]} for path in images
            ],
        },
        source="import",
    )


def _plane(file: ImageFile, *, is_srgb: bool) -> NDArray[np.float64]:
    pixels = file.pixels
    if is_srgb:
        pixels = srgb_to_linear(pixels, file.full_scale_dn or 1.0)
    try:
        return luma_plane(pixels)
    except ValueError as error:
        raise ImageFileError(f"{file.path}: {error}") from error


def _top_dn(file: ImageFile, plane: NDArray[np.float64], *, is_srgb: bool) -> float:
    """Level at which the file clips; a float file tells nothing, and counts none as clipped."""
    if file.saturation_dn is None:
        return float(np.nextafter(np.float32(plane.max()), np.float32(np.inf)))
    if is_srgb:
        return float(srgb_to_linear(np.array(file.saturation_dn), file.full_scale_dn or 1.0))
    return file.saturation_dn
