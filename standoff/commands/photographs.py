"""``standoff import``: photographs from elsewhere as a capture session."""

from pathlib import Path
from typing import Annotated

from typer import Argument, Option

from acquisition.choices import CaptureKind
from acquisition.files import require_folder
from standoff import library, terminal


def import_photographs(
    images: Annotated[list[Path], Argument(help="Photographs of one kind.", show_default=False)],
    *,
    kind: Annotated[CaptureKind, Option(help="What the photographs show.")],
    out: Annotated[Path, Option(help="Session folder; an existing session is resumed.")],
    height_mm: Annotated[
        float,
        Option(
            help="Height of the camera in mm, corrected by session set-height. 0 if nobody knows "
            "it: a PSF needs no height, geometry and validate do."
        ),
    ],
    scale: Annotated[
        float | None, Option(help="Scale in the plane of the target in px/mm.")
    ] = None,
    encoding: terminal.EncodingName = "auto",
    srgb: terminal.ShortEncoding = None,
    page: terminal.Page = None,
    mean: terminal.Mean = False,
    operator: terminal.OperatorName = None,
    json: terminal.Json = False,
) -> None:
    """Make a session from photographs taken by another program: grey, linear, one frame each.

    Each photograph is a target of its own, named after its file.
    """
    require_folder(out, is_written=True)
    found = library.import_photographs(
        images,
        out,
        kind=kind,
        height_mm=height_mm,
        scale_px_per_mm=scale,
        operator=operator,
        reading=terminal.reading_options(encoding, page, mean, srgb),
        progress=terminal.ShownProgress(),
    )
    terminal.note_once(found.notes)
    if json:
        terminal.print_json(found.to_json())
    else:
        terminal.say(f"{out}: {found.imported} of {len(images)} photographs imported")
