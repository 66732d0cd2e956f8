"""``standoff report``: a one-page report on a capture session, as HTML or PDF."""

from pathlib import Path
from typing import Annotated

from typer import Option

from standoff import library, terminal


def report(
    directory: terminal.SessionFolder,
    out: Annotated[
        Path | None,
        Option(help="Report to write (HTML or PDF); DIRECTORY/results/report.html by default."),
    ] = None,
    force: terminal.Force = False,
    json: terminal.Json = False,
) -> None:
    """Write a report on a session and the results obtained from it so far."""
    terminal.refuse_suffix(out, "--out", terminal.REPORTS)
    terminal.refuse_overwriting([out], force=force)
    written = library.write_report(directory, out, progress=terminal.ShownProgress())
    if json:
        terminal.print_json(written.to_json())
    else:
        terminal.say(f"wrote {written.report}")
