"""``standoff import``: photographs from elsewhere as a capture session."""

import getpass
import math
from pathlib import Path
from typing import Annotated

import typer

from acquisition.choices import CaptureKind
from standoff.terminal import Json, print_json, say


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
    from standoff.workflows import ImportSettings, import_into_session

    settings = ImportSettings(
        kind=kind,
        height_mm=height_mm,
        scale_px_per_mm=scale,
        is_srgb=srgb,
        operator=operator or getpass.getuser(),
    )
    imported = import_into_session(out, images, settings)
    if json:
        print_json({"session": str(out), "imported": imported, "photographs": len(images)})
        return
    say(f"{out}: {imported} of {len(images)} photographs imported")
