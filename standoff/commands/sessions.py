"""``standoff verify`` and ``standoff session``: check and manage capture sessions."""

from __future__ import annotations

import getpass
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from standoff.errors import ApplicationError
from standoff.terminal import Command, Json, note, print_json, print_table, say

if TYPE_CHECKING:
    from acquisition.session import SessionCapture, SessionNotes


Directory = Annotated[Path, typer.Argument(help="Session folder.", show_default=False)]
Index = Annotated[int, typer.Argument(help="Index of the capture.", show_default=False, min=0)]
Reason = Annotated[str, typer.Option(help="Reason, recorded in the session.")]
Who = Annotated[
    str | None, typer.Option("--operator", help="Name of the operator; the login name by default.")
]

session = typer.Typer(
    name="session", help="Manage capture sessions: list, show, exclude, include, set-height, note."
)


def verify(
    directory: Directory,
    repair: Annotated[
        bool,
        typer.Option(
            "--repair",
            help="Make a new journal of what a damaged one and the captures themselves still say; "
            "the old one is kept.",
        ),
    ] = False,
    json: Json = False,
) -> None:
    """Check every file of a session against its journal."""
    from standoff.library import verify_session

    checked = verify_session(directory, repair=repair)
    report = checked.report
    superseded = [c for c in report.files if c.is_superseded and c.state in ("missing", "changed")]
    for text in checked.notes[: len(checked.notes) - json * len(report.remarks)]:
        note(text)
    if json:
        print_json(checked.to_json())
    else:
        for fault in report.faults:
            say(fault)
        for check in report.files:
            if check.state != "ok":
                say(f"{check.state:12} {check.file}{' (superseded)' * check.is_superseded}")
        good = sum(check.state == "ok" for check in report.files)
        say(f"{good} of {len(report.files)} files match the journal")
        if superseded:
            say(
                f"{len(superseded)} of the others belong to captures that were retaken later: "
                "nothing uses them, so they do not count"
            )
    if report.faults:
        raise ApplicationError(f"{directory}: {report.faults[0]}")
    if not report.is_ok:
        raise ApplicationError(
            f"{directory}: files are missing or changed; restore them from a copy, "
            "or run the capture command again to retake them"
        )


@session.command("list")
def list_sessions(
    folder: Annotated[
        Path, typer.Argument(help="Folder of sessions, or one session.", show_default=False)
    ],
    json: Json = False,
) -> None:
    """List the sessions in a folder: plan, captures, creation time and operator."""
    from standoff.library import list_sessions as listed_sessions

    rows = listed_sessions(folder)
    for row in rows:
        if "error" in row:
            note(row["error"])
    if json:
        print_json(rows)
        return
    print_table(
        f"{len(rows)} sessions in {folder}",
        ["session", "plan", "captured", "excluded", "created (UTC)", "operator"],
        [
            [Path(row["session"]).name, "cannot be read", "", "", "", ""]
            if "error" in row
            else [
                Path(row["session"]).name,
                row["plan"],
                f"{row['captured']} of {row['planned']}",
                str(row["excluded"]),
                row["created_utc"][:16],
                row["operator"],
            ]
            for row in rows
        ],
    )


@session.command("show")
def show(directory: Directory, json: Json = False) -> None:
    """Show a session's captures, whether they are used, and its notes."""
    from acquisition.session import Session
    from standoff.library import show_session

    opened = Session(directory)
    facts = show_session(opened)
    if json:
        print_json(facts)
        return
    captures = sorted(opened.captures, key=lambda capture: capture.record.index)
    for remark in opened.remarks:
        note(remark)
    print_table(
        f"{directory}: {facts['plan']}, {facts['captured']} of {facts['planned']} captured",
        ["index", "target", "orientation / deg", "height / mm", "exposure / us", "focus", "state"],
        [_cells(capture) for capture in captures],
    )
    for written in facts["notes"]:
        index = written.get("index")
        about = "" if index is None else f"capture {index}: "
        say(f"{written['utc'][:16]}  {about}{written.get('text', '')}")


@session.command("exclude")
def exclude(
    index: Index,
    directory: Directory,
    reason: Reason,
    who: Who = None,
) -> None:
    """Exclude a capture from calibration and analysis."""
    _notes(directory, who).exclude(index, reason)
    say(f"{directory}: capture {index} is excluded: {reason}")


@session.command("include")
def include(
    index: Index,
    directory: Directory,
    reason: Reason = "",
    who: Who = None,
) -> None:
    """Use an excluded capture again."""
    _notes(directory, who).include(index, reason)
    say(f"{directory}: capture {index} is used again")


@session.command("set-height", cls=Command)
def set_height(
    indices: Annotated[
        list[int],
        typer.Argument(help="Indices of the captures.", show_default=False, min=0, metavar="I"),
    ],
    directory: Directory,
    height_mm: Annotated[float, typer.Option(help="The right height of the camera in mm.")],
    reason: Reason,
    who: Who = None,
) -> None:
    """Correct the height of imported photographs; what was recorded before is kept."""
    if not math.isfinite(height_mm):
        raise typer.BadParameter(f"a height must be a finite number, got {height_mm}")
    for event in _notes(directory, who).correct_height(indices, height_mm, reason):
        say(
            f"{directory}: capture {event.facts['index']} is at {height_mm:g} mm "
            f"(was {event.facts['was_mm']:g} mm): {reason}"
        )


@session.command("note")
def write_note(
    text: Annotated[str, typer.Argument(help="Text of the note.", show_default=False)],
    directory: Directory,
    who: Who = None,
) -> None:
    """Add a note to the session's journal."""
    _notes(directory, who).note(text)
    say(f"{directory}: noted")


def _notes(directory: Path, who: str | None) -> SessionNotes:
    from acquisition.session import SessionNotes

    return SessionNotes(directory, operator=who or getpass.getuser())


def _cells(capture: SessionCapture) -> list[str]:
    record = capture.record
    state = "used"
    if capture.is_superseded:
        state = "superseded"
    elif capture.excluded_because is not None:
        state = f"excluded: {capture.excluded_because}"
    if capture.uncorrected_height_mm is not None:
        state += f", recorded at {capture.uncorrected_height_mm:.3f} mm"
    return [
        str(record.index),
        f"{record.kind} {record.target}",
        f"{record.orientation_deg:g}",
        f"{record.height_mm:.3f}",
        "" if record.exposure_us is None else f"{record.exposure_us:g}",
        "" if record.focus_value is None else f"{record.focus_value:.3g}",
        state,
    ]
