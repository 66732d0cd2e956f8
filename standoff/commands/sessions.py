"""``standoff verify`` and ``standoff session``: check and manage capture sessions."""

from __future__ import annotations

import getpass
import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from acquisition.errors import SessionError
from standoff.errors import ApplicationError
from standoff.terminal import Command, Json, note, print_json, print_table, say

if TYPE_CHECKING:
    from acquisition.session import Session, SessionCapture, SessionNotes


Directory = Annotated[Path, typer.Argument(help="Session folder.", show_default=False)]
Index = Annotated[int, typer.Argument(help="Index of the capture.", show_default=False, min=0)]
Reason = Annotated[str, typer.Option(help="Reason, recorded in the session.")]
Who = Annotated[
    str | None, typer.Option("--operator", help="Name of the operator; the login name by default.")
]

_QUOTED = 300
"""Characters of a lost line that the terminal shows."""

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
    from acquisition.session import verify as verify_session

    repaired = _repair(directory) if repair else None
    report = verify_session(directory)
    superseded = [c for c in report.files if c.is_superseded and c.state in ("missing", "changed")]
    if json:
        print_json(
            {
                "session": str(directory),
                "ok": report.is_ok,
                "files": [
                    {"file": c.file, "state": c.state, "superseded": c.is_superseded}
                    for c in report.files
                ],
                "faults": list(report.faults),
                "remarks": list(report.remarks),
                "repaired": repaired,
            }
        )
    else:
        for remark in report.remarks:
            note(remark)
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


def _repair(directory: Path) -> dict[str, Any]:
    """Repair the journal and say what became of it; the facts for ``--json``."""
    from acquisition.session import repair_session

    done = repair_session(directory)
    if done.kept_as is None:
        note("the journal is sound; nothing was repaired")
    else:
        note(f"the journal was made anew of {done.lines} lines; the old one is {done.kept_as.name}")
        for record in done.recovered:
            note(f"capture {record.index} was brought back from {record.file}")
        for line in done.lost:
            note(f"line {line.number} is lost: {line.text[:_QUOTED] or 'nothing is left of it'}")
        for file in done.unknown_files:
            note(f"{file} is not a capture of this session and was left out")
    return {
        "kept_as": None if done.kept_as is None else str(done.kept_as),
        "lines": done.lines,
        "recovered": [record.index for record in done.recovered],
        "lost": [{"line": line.number, "text": line.text} for line in done.lost],
        "unknown_files": list(done.unknown_files),
    }


@session.command("list")
def list_sessions(
    folder: Annotated[
        Path, typer.Argument(help="Folder of sessions, or one session.", show_default=False)
    ],
    json: Json = False,
) -> None:
    """List the sessions in a folder: plan, captures, creation time and operator."""
    from acquisition.session import MANIFEST_NAME, Session

    if not folder.is_dir():
        raise ApplicationError(f"{folder} is not a folder; name the one that holds the sessions")
    manifests = [*folder.glob(MANIFEST_NAME), *sorted(folder.glob(f"*/{MANIFEST_NAME}"))]
    rows: list[dict[str, Any]] = []
    for path in manifests:
        try:
            rows.append(_summary(Session(path.parent)))
        except SessionError as error:
            note(str(error))
            rows.append({"session": str(path.parent), "error": str(error)})
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

    opened = Session(directory)
    captures = sorted(opened.captures, key=lambda capture: capture.record.index)
    notes = [event for event in opened.events if event.kind == "note"]
    if json:
        print_json(
            {
                **_summary(opened),
                "captures": [
                    {
                        **capture.record.to_json(),
                        "superseded": capture.is_superseded,
                        "excluded_because": capture.excluded_because,
                        "uncorrected_height_mm": capture.uncorrected_height_mm,
                    }
                    for capture in captures
                ],
                "notes": [{"utc": event.utc, **event.facts} for event in notes],
                "remarks": list(opened.remarks),
            }
        )
        return
    for remark in opened.remarks:
        note(remark)
    facts = _summary(opened)
    print_table(
        f"{directory}: {facts['plan']}, {facts['captured']} of {facts['planned']} captured",
        ["index", "target", "orientation / deg", "height / mm", "exposure / us", "focus", "state"],
        [_cells(capture) for capture in captures],
    )
    for event in notes:
        index = event.facts.get("index")
        about = "" if index is None else f"capture {index}: "
        say(f"{event.utc[:16]}  {about}{event.facts.get('text', '')}")


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


def _summary(opened: Session) -> dict[str, Any]:
    captured = {c.record.index for c in opened.captures if not c.is_superseded}
    excluded = [
        c for c in opened.captures if c.excluded_because is not None and not c.is_superseded
    ]
    return {
        "session": str(opened.path),
        "plan": opened.plan.name,
        "operator": opened.manifest.operator,
        "created_utc": opened.manifest.created_utc,
        "captured": len(captured),
        "planned": len(opened.entries),
        "excluded": len(excluded),
    }


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
