"""``standoff report``: a one-page report on a capture session, as HTML or PDF."""

from pathlib import Path
from typing import Annotated

import typer

from standoff.terminal import (
    Force,
    Json,
    ShownProgress,
    print_json,
    refuse_overwriting,
    refuse_suffix,
    say,
)


def report(
    directory: Annotated[Path, typer.Argument(help="Session folder.", show_default=False)],
    out: Annotated[
        Path | None,
        typer.Option(
            help="Report to write (HTML or PDF); DIRECTORY/results/report.html by default."
        ),
    ] = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Write a report on a session and the results obtained from it so far."""
    from standoff.library import write_report

    refuse_suffix(out, "--out", {".html", ".htm", ".pdf"})
    refuse_overwriting([out], force=force)
    written = write_report(directory, out, progress=ShownProgress())
    if json:
        print_json(written.to_json())
        return
    say(f"wrote {written.report}")
