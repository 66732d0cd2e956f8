"""``standoff export``: a capture session in the formats of other programs."""

from pathlib import Path
from typing import Annotated

from typer import BadParameter, Option

from acquisition.choices import EXPORT_ENDINGS, ExportFormat
from standoff import library, terminal
from standoff.errors import ApplicationError


def export(
    directory: terminal.SessionFolder,
    *,
    format_: Annotated[
        ExportFormat, Option("--format", help="OME-Zarr 0.5, OME-TIFF (schema 2016-06) or NeXus.")
    ],
    out: Annotated[
        Path, Option(help="File to write, .ome.tif or .nxs; for OME-Zarr a folder, .ome.zarr.")
    ],
    geometry: Annotated[
        Path | None,
        Option(help="geometry.json that gives the scale of captures without their own."),
    ] = None,
    force: terminal.Force = False,
    json: terminal.Json = False,
) -> None:
    """Write a session's captures, with heights, exposures, variance and provenance, for others.

    Captures that are excluded, or were taken again, are left out. The session stays as it is.
    """
    endings = EXPORT_ENDINGS[format_]
    if not out.name.lower().endswith(endings):
        raise BadParameter(f"{out} must end in {' or '.join(endings)}", param_hint="--out")
    _refuse_within(out, directory)
    is_replaced = format_ == "ome-zarr" and out.is_dir()
    if is_replaced:
        _refuse_folder(out, force=force)
    terminal.refuse_overwriting([None if is_replaced else out], [geometry], force=force)
    done = library.export_session(
        directory, out, format=format_, geometry=geometry, progress=terminal.ShownProgress()
    )
    if json:
        terminal.print_json(done.to_json())
    else:
        terminal.say(f"wrote {out}: {done.captures} captures")


def _refuse_within(out: Path, directory: Path) -> None:
    """Refuse a result among the files of the session, apart from its results."""
    written, session = out.resolve(), directory.resolve()
    if written.is_relative_to(session) and not written.is_relative_to(session / "results"):
        raise BadParameter(
            f"{out} is inside the session; name a place outside it, or in its results/",
            param_hint="--out",
        )


def _refuse_folder(out: Path, *, force: bool) -> None:
    """Refuse to replace a folder that is no Zarr group, or without ``--force``."""
    if not (out / "zarr.json").is_file():
        raise ApplicationError(f"cannot write {out}: it is a folder, and no OME-Zarr")
    if not force:
        raise ApplicationError(f"{out} exists already; --force replaces it, or name another one")
