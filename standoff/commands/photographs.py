"""``standoff import``: photographs from elsewhere as a capture session."""

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
    ShownProgress,
    note_once,
    print_json,
    reading_options,
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
    from standoff.library import import_photographs as imported_photographs

    found = imported_photographs(
        images,
        out,
        kind=kind,
        height_mm=height_mm,
        scale_px_per_mm=scale,
        operator=operator,
        reading=reading_options(encoding, page, mean, srgb),
        progress=ShownProgress(),
    )
    note_once(found.notes)
    if json:
        print_json(found.to_json())
        return
    say(f"{out}: {found.imported} of {len(images)} photographs imported")
