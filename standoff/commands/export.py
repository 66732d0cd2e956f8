"""``standoff export``: a capture session in the formats of other programs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from acquisition.session_export import EXPORT_ENDINGS, ExportFormat
from standoff.errors import ApplicationError
from standoff.terminal import (
    Force,
    Json,
    ShownProgress,
    print_json,
    refuse_overwriting,
    say,
)


def export(
    directory: Annotated[Path, typer.Argument(help="Session folder.", show_default=False)],
    *,
    format_: Annotated[
        ExportFormat,
        typer.Option("--format", help="OME-Zarr 0.5, OME-TIFF (schema 2016-06) or NeXus."),
    ],
    out: Annotated[
        Path,
        typer.Option(help="File to write, .ome.tif or .nxs; for OME-Zarr a folder, .ome.zarr."),
    ],
    geometry: Annotated[
        Path | None,
        typer.Option(help="geometry.json that gives the scale of captures without their own."),
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a session's captures, with heights, exposures, variance and provenance, for others.

    Captures that are excluded, or were taken again, are left out. The session stays as it is.
    """
    _refuse_name(format_, out)
    _refuse_within(out, directory)
    is_replaced = format_ == "ome-zarr" and out.is_dir()
    if is_replaced:
        _refuse_folder(out, force=force)
    refuse_overwriting([None if is_replaced else out], [geometry], force=force)
    from standoff.library import export_session

    done = export_session(
        directory, out, format=format_, geometry=geometry, progress=ShownProgress()
    )
    if json:
        print_json(done.to_json())
        return
    say(f"wrote {out}: {done.captures} captures")


def _refuse_name(format_: ExportFormat, out: Path) -> None:
    endings = EXPORT_ENDINGS[format_]
    if not out.name.lower().endswith(endings):
        raise typer.BadParameter(f"{out} must end in {' or '.join(endings)}", param_hint="--out")


def _refuse_within(out: Path, directory: Path) -> None:
    """Refuse a result among the files of the session, apart from its results."""
    inside = out.resolve().is_relative_to(directory.resolve())
    if inside and not out.resolve().is_relative_to(directory.resolve() / "results"):
        raise typer.BadParameter(
            f"{out} is inside the session; name a place outside it, or in its results/",
            param_hint="--out",
        )


def _refuse_folder(out: Path, *, force: bool) -> None:
    """Refuse to replace a folder that is no Zarr group, or without ``--force``."""
    if not (out / "zarr.json").is_file():
        raise ApplicationError(f"cannot write {out}: it is a folder, and no OME-Zarr")
    if not force:
        raise ApplicationError(f"{out} exists already; --force replaces it, or name another one")
