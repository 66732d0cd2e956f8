"""``standoff import``: photographs from elsewhere as a capture session."""

import getpass
import math
from pathlib import Path
from typing import Annotated

import typer

from acquisition.choices import CaptureKind
from standoff.terminal import (
    EncodingName,
    Json,
    Mean,
    Page,
    ShortEncoding,
    photograph_inputs,
    print_json,
    say,
)


def import_photographs(
    images: Annotated[
        list[Path], typer.Argument(help="Photographs of one kind.", show_default=False)
    ],
    *,
    kind: Annotated[CaptureKind, typer.Option(help="What the photographs show.")],
    out: Annotated[Path, typer.Option(help="Session folder; an existing session is resumed.")],
    height_mm: Annotated[
        float,
        typer.Option(
            help="Height of the camera in mm, corrected by session set-height. 0 if nobody knows "
            "it: a PSF needs no height, geometry and validate do."
        ),
    ],
    scale: Annotated[
        float | None, typer.Option(help="Scale in the plane of the target in px/mm.")
    ] = None,
    encoding: EncodingName = "auto",
    srgb: ShortEncoding = None,
    page: Page = None,
    mean: Mean = False,
    operator: Annotated[
        str | None, typer.Option(help="Name of the operator; the login name by default.")
    ] = None,
    json: Json = False,
) -> None:
    """Make a session from photographs taken by another program: grey, linear, one frame each.

    Each photograph is a target of its own, named after its file.
    """
    if not math.isfinite(height_mm):
        raise typer.BadParameter(f"a height must be a finite number, got {height_mm}")
    if scale is not None and not (math.isfinite(scale) and scale > 0):
        raise typer.BadParameter(f"a scale must be above 0 px/mm, got {scale}")
    from standoff.workflows import ImportSettings, import_into_session

    settings = ImportSettings(
        kind=kind,
        height_mm=height_mm,
        scale_px_per_mm=scale,
        operator=operator or getpass.getuser(),
    )
    inputs = photograph_inputs(encoding, page, mean, srgb)
    imported = import_into_session(out, images, settings, inputs)
    if json:
        print_json({"session": str(out), "imported": imported, "photographs": len(images)})
        return
    say(f"{out}: {imported} of {len(images)} photographs imported")
