"""``standoff report``: one HTML page about a capture session."""

from pathlib import Path
from typing import Annotated

import typer

from acquisition.session import Session
from standoff.options import Json
from standoff.output import note, print_json, say
from standoff.reports import RESULTS_FOLDER, make_folder, write_session_report

__all__ = ["report"]


def report(
    directory: Annotated[Path, typer.Argument(help="Session directory.", show_default=False)],
    out: Annotated[
        Path | None, typer.Option(help="HTML file; DIRECTORY/results/report.html by default.")
    ] = None,
    json: Json = False,
) -> None:
    """Write an HTML report of a session and of what was worked out from it so far."""
    session = Session.open(directory)
    results = make_folder(directory / RESULTS_FOLDER)
    page = out or results / "report.html"
    if not (results / "psf.json").is_file():
        note(
            f"{results / 'psf.json'} is not there: the report shows the captures alone; "
            f"standoff calibrate --session {directory} --out {results / 'psf.json'} makes it"
        )
    write_session_report(session, page)
    if json:
        print_json({"session": str(directory), "report": str(page)})
        return
    say(f"wrote {page}")
