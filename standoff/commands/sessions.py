"""``standoff verify`` and ``standoff session``: check and manage capture sessions."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, BadParameter, Option, Typer

from standoff import library, terminal
from standoff.errors import ApplicationError

if TYPE_CHECKING:
    from acquisition.session import SessionCapture

Index = Annotated[int, Argument(help="Index of the capture.", show_default=False, min=0)]
Reason = Annotated[str, Option(help="Reason, recorded in the session.")]

session = Typer(
    name="session",
    help="Manage capture sessions: list, show, exclude, include, set-height, set-aside, note.",
)


def verify(
    directory: terminal.SessionFolder,
    repair: Annotated[
        bool,
        Option(
            "--repair",
            help="Make a new journal of what a damaged one and the captures themselves still say; "
            "the old one is kept.",
        ),
    ] = False,
    json: terminal.Json = False,
) -> None:
    """Check every file of a session against its journal."""
    checked = library.verify_session(directory, repair=repair)
    report = checked.report
    superseded = [c for c in report.files if c.is_superseded and c.state in ("missing", "changed")]
    terminal.note(*checked.notes[: len(checked.notes) - json * len(report.remarks)])
    if json:
        terminal.print_json(checked.to_json())
    else:
        terminal.say(*report.faults)
        wrong = [check for check in report.files if check.state != "ok"]
        for check in wrong:
            remark = " (superseded)" if check.is_superseded else ""
            terminal.say(f"{check.state:12} {check.file}{remark}")
        good = len(report.files) - len(wrong)
        terminal.say(f"{good} of {len(report.files)} files match the journal")
        if superseded:
            terminal.say(
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
        Path, Argument(help="Folder of sessions, or one session.", show_default=False)
    ],
    json: terminal.Json = False,
) -> None:
    """List the sessions in a folder: plan, captures, creation time and operator."""
    rows = library.list_sessions(folder)
    terminal.note(*(row["error"] for row in rows if "error" in row))
    if json:
        terminal.print_json(rows)
        return
    terminal.print_table(
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
def show(directory: terminal.SessionFolder, json: terminal.Json = False) -> None:
    """Show a session's captures, whether they are used, and its notes."""
    from acquisition.session import Session

    opened = Session(directory)
    facts = library.show_session(opened)
    if json:
        terminal.print_json(facts)
        return
    captures = sorted(opened.captures, key=lambda capture: capture.record.index)
    terminal.note(*opened.remarks)
    terminal.print_table(
        f"{directory}: {facts['plan']}, {facts['captured']} of {facts['planned']} captured",
        ["index", "target", "orientation / deg", "height / mm", "exposure / us", "focus", "state"],
        [_cells(capture) for capture in captures],
    )
    for written in facts["notes"]:
        index = written.get("index")
        about = "" if index is None else f"capture {index}: "
        terminal.say(f"{written['utc'][:16]}  {about}{written.get('text', '')}")


@session.command("exclude")
def exclude(
    index: Index,
    directory: terminal.SessionFolder,
    reason: Reason,
    operator: terminal.OperatorName = None,
) -> None:
    """Exclude a capture from calibration and analysis."""
    library.exclude_capture(directory, index, reason, operator=operator)
    terminal.say(f"{directory}: capture {index} is excluded: {reason}")


@session.command("include")
def include(
    index: Index,
    directory: terminal.SessionFolder,
    reason: Reason = "",
    operator: terminal.OperatorName = None,
) -> None:
    """Use an excluded capture again."""
    library.include_capture(directory, index, reason, operator=operator)
    terminal.say(f"{directory}: capture {index} is used again")


@session.command("set-height", cls=terminal.Command)
def set_height(
    indices: Annotated[
        list[int], Argument(help="Indices of the captures.", show_default=False, min=0, metavar="I")
    ],
    directory: terminal.SessionFolder,
    height_mm: Annotated[float, Option(help="The right height of the camera in mm.")],
    reason: Reason,
    operator: terminal.OperatorName = None,
) -> None:
    """Correct the height of imported photographs; what was recorded before is kept."""
    if not math.isfinite(height_mm):
        raise BadParameter(f"a height must be a finite number, got {height_mm}")
    for event in library.correct_height(directory, indices, height_mm, reason, operator=operator):
        terminal.say(
            f"{directory}: capture {event.facts['index']} is at {height_mm:g} mm "
            f"(was {event.facts['was_mm']:g} mm): {reason}"
        )


@session.command("set-aside")
def set_aside(
    directory: terminal.SessionFolder,
    reason: Reason,
    operator: terminal.OperatorName = None,
) -> None:
    """Move files that the journal does not name out of the folders of captures."""
    moved = library.set_aside_files(directory, reason, operator=operator)
    terminal.say(*(f"{one['file']} is now {one['to']}" for one in moved))
    terminal.say(f"{directory}: {len(moved)} files set aside: {reason}")


@session.command("note")
def write_note(
    text: Annotated[str, Argument(help="Text of the note.", show_default=False)],
    directory: terminal.SessionFolder,
    operator: terminal.OperatorName = None,
) -> None:
    """Add a note to the session's journal."""
    library.add_note(directory, text, operator=operator)
    terminal.say(f"{directory}: noted")


def _cells(capture: SessionCapture) -> list[str]:
    record = capture.record
    because = capture.excluded_because
    state = "used" if because is None else f"excluded: {because}"
    if capture.is_superseded:
        state = "superseded"
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
