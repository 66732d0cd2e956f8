"""``standoff report``: a one-page report on a capture session, as HTML or PDF."""

from os.path import lexists
from pathlib import Path
from typing import Annotated

import typer

from standoff.terminal import Force, Json, note, print_json, refuse_overwriting, refuse_suffix, say


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
    from acquisition.session import Session, verify
    from standoff.workflows import (
        make_results_folder,
        require_writable,
        write_session_report,
    )

    refuse_suffix(out, "--out", {".html", ".htm", ".pdf"})
    refuse_overwriting([out], force=force)
    session = Session(directory)
    results = make_results_folder(directory)
    page = out or results / "report.html"
    require_writable([page])
    if not lexists(results / "psf.json"):
        note(
            f"{results / 'psf.json'} is missing: the report shows no PSF; "
            f"standoff calibrate --session {directory} --out {results / 'psf.json'} writes it"
        )
    spoilt = [
        check
        for check in verify(directory).files
        if check.state in ("missing", "changed") and not check.is_superseded
    ]
    if spoilt:
        note(
            f"{len(spoilt)} files of the session are missing or changed, the first "
            f"{spoilt[0].file}; standoff verify {directory} lists them"
        )
    write_session_report(session, page)
    if json:
        print_json({"session": str(directory), "report": str(page)})
        return
    say(f"wrote {page}")
