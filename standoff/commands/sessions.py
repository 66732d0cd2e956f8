"""Capture sessions: ``standoff session``, ``verify``, ``import``, ``export`` and ``report``."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, BadParameter, Option, Typer

from acquisition.choices import EXPORT_ENDINGS, CaptureKind, ExportFormat
from acquisition.files import require_folder
from standoff import library, terminal
from standoff.errors import ApplicationError

if TYPE_CHECKING:
    from acquisition.session import Session, SessionCapture, VerifyReport

Index = Annotated[int, Argument(help="Index of the capture.", show_default=False, min=0)]
Reason = Annotated[str, Option(help="Reason, recorded in the session.")]

session = Typer(
    name="session",
    help="Manage capture sessions: list, show, exclude, include, set-height, set-aside, note.",
)


@terminal.command()
def verify(
    directory: terminal.SessionFolder,
    repair: Annotated[bool, Option("--repair")] = False,
) -> None:
    """Check every file of a session against its journal.

    Options
    -------
    repair: Rebuild a damaged journal from what it and the captures still record; the old journal is
        kept.
    """
    checked = library.verify_session(directory, repair=repair)
    report = checked.report
    is_told = terminal.wants_json()  # of the remarks
    terminal.note(*checked.notes[: len(checked.notes) - is_told * len(report.remarks)])
    terminal.answer(checked.to_json, lambda: _show_verified(report))
    if report.faults:
        raise ApplicationError(f"{directory}: {report.faults[0]}")
    if not report.is_ok:
        raise ApplicationError(
            f"{directory}: files are missing or changed; restore them from a copy, "
            "or run the capture command again to retake them"
        )


def _show_verified(report: VerifyReport) -> None:
    terminal.say(*report.faults)
    wrong = [check for check in report.files if check.state != "ok"]
    for check in wrong:
        remark = " (superseded)" if check.is_superseded else ""
        terminal.say(f"{check.state:12} {check.file}{remark}")
    good = len(report.files) - len(wrong)
    terminal.say(f"{good} of {len(report.files)} files match the journal")
    superseded = [c for c in wrong if c.is_superseded and c.state in ("missing", "changed")]
    if superseded:
        terminal.say(
            f"{len(superseded)} of the others belong to captures that were retaken later: "
            "nothing uses them, so they do not count"
        )


@session.command("list")
@terminal.command()
def list_sessions(
    folder: Path,
) -> None:
    """List the sessions in a folder: plan, captures, creation time and operator.

    Options
    -------
    folder: Folder of sessions, or one session.
    """
    rows = library.list_sessions(folder)
    terminal.note(*(row["error"] for row in rows if "error" in row))
    terminal.answer(rows, lambda: _show_list(folder, rows))


def _show_list(folder: Path, rows: list[dict[str, Any]]) -> None:
    terminal.print_items(
        f"{len(rows)} sessions in {folder}",
        ({"plan": "cannot be read"} | row for row in rows),
        {
            "session": lambda row: Path(row["session"]).name,
            "plan": lambda row: row["plan"],
            "captured": lambda row: (
                f"{row['captured']} of {row['planned']}" if "planned" in row else ""
            ),
            "excluded": lambda row: str(row.get("excluded", "")),
            "created (UTC)": lambda row: row.get("created_utc", "")[:16],
            "operator": lambda row: row.get("operator", ""),
        },
    )


@session.command("show")
@terminal.command()
def show(directory: terminal.SessionFolder) -> None:
    """Show a session's captures, whether they are used, and its notes."""
    from acquisition.session import Session

    opened = Session(directory)
    facts = library.show_session(opened)
    terminal.answer(facts, lambda: _show(directory, opened, facts))


def _show(directory: Path, opened: Session, facts: dict[str, Any]) -> None:
    terminal.note(*opened.remarks)
    terminal.print_items(
        f"{directory}: {facts['plan']}, {facts['captured']} of {facts['planned']} captured",
        sorted(opened.captures, key=lambda capture: capture.record.index),
        {
            "index": lambda one: str(one.record.index),
            "target": lambda one: f"{one.record.kind} {one.record.target}",
            "orientation / deg": lambda one: f"{one.record.orientation_deg:g}",
            "height / mm": lambda one: (
                "" if (at := opened.known_height_mm(one.record)) is None else f"{at:.3f}"
            ),
            "exposure / us": lambda one: (
                "" if one.record.exposure_us is None else f"{one.record.exposure_us:g}"
            ),
            "focus": lambda one: (
                "" if one.record.focus_value is None else f"{one.record.focus_value:.3g}"
            ),
            "state": _state,
        },
    )
    for written in facts["notes"]:
        index = written.get("index")
        about = "" if index is None else f"capture {index}: "
        terminal.say(f"{written['utc'][:16]}  {about}{written.get('text', '')}")


def _state(capture: SessionCapture) -> str:
    because = capture.excluded_because
    state = "used" if because is None else f"excluded: {because}"
    if capture.is_superseded:
        state = "superseded"
    if capture.uncorrected_height_mm is not None:
        state += f", recorded at {capture.uncorrected_height_mm:.3f} mm"
    return state


@session.command("exclude")
@terminal.command(has_json=False)
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
@terminal.command(has_json=False)
def include(
    index: Index,
    directory: terminal.SessionFolder,
    reason: Reason = "",
    operator: terminal.OperatorName = None,
) -> None:
    """Use an excluded capture again."""
    library.include_capture(directory, index, reason, operator=operator)
    terminal.say(f"{directory}: capture {index} is used again")


@session.command("set-height")
@terminal.command(has_json=False)
def set_height(
    indices: Annotated[list[int], Argument(min=0, metavar="I")],
    directory: terminal.SessionFolder,
    height_mm: Annotated[float, Option()],
    reason: Reason,
    operator: terminal.OperatorName = None,
) -> None:
    """Correct the height of imported photographs; the earlier value stays on record.

    Options
    -------
    indices: Indices of the captures.
    height_mm: The correct height of the camera in mm.
    """
    if not math.isfinite(height_mm):
        raise BadParameter(f"a height must be a finite number, got {height_mm}")
    for event in library.correct_height(directory, indices, height_mm, reason, operator=operator):
        terminal.say(
            f"{directory}: capture {event.facts['index']} is at {height_mm:g} mm "
            f"(was {event.facts['was_mm']:g} mm): {reason}"
        )


@session.command("set-aside")
@terminal.command(has_json=False)
def set_aside(
    directory: terminal.SessionFolder,
    reason: Reason,
    operator: terminal.OperatorName = None,
) -> None:
    """Move files that are not in the journal out of the capture folders."""
    moved = library.set_aside_files(directory, reason, operator=operator)
    terminal.say(*(f"{one['file']} is now {one['to']}" for one in moved))
    terminal.say(f"{directory}: {len(moved)} files set aside: {reason}")


@session.command("note")
@terminal.command(has_json=False)
def write_note(
    text: str,
    directory: terminal.SessionFolder,
    operator: terminal.OperatorName = None,
) -> None:
    """Add a note to the session's journal.

    Options
    -------
    text: Text of the note.
    """
    library.add_note(directory, text, operator=operator)
    terminal.say(f"{directory}: noted")


@terminal.command()
def import_photographs(
    images: list[Path],
    *,
    kind: CaptureKind,
    out: Path,
    height_mm: float,
    scale_px_per_mm: Annotated[float | None, Option("--scale")] = None,
    reading: terminal.ReadingWithShortForms,
    operator: terminal.OperatorName = None,
) -> None:
    """Make a session from photographs taken by another program: grey, linear, one frame each.

    Each photograph is a target of its own, named after its file.

    Options
    -------
    images: Photographs of one kind.
    kind: What the photographs show.
    out: Session folder; an existing session is resumed.
    height_mm: Height of the camera in mm; session set-height corrects it. Give 0 if it is unknown:
        calibrate needs no height; geometry and validate do.
    scale_px_per_mm: Scale in the plane of the target in px/mm.
    """
    require_folder(out, is_written=True)
    how = terminal.keywords_of(library.import_photographs)
    found = library.import_photographs(images, out, **how)
    terminal.answer(
        found.to_json,
        lambda: terminal.say(f"{out}: {found.imported} of {len(images)} photographs imported"),
        found.notes,
    )


@terminal.command()
def export(
    directory: terminal.SessionFolder,
    *,
    format_: Annotated[ExportFormat, Option("--format")],
    out: Path,
    geometry: Path | None = None,
    force: terminal.Force = False,
) -> None:
    """Export a session's captures, with heights, exposures, variance and provenance.

    Excluded captures, and those replaced by a retake, are left out. The session is not changed.

    Options
    -------
    format_: OME-Zarr 0.5, OME-TIFF (schema 2016-06) or NeXus.
    out: File to write, .ome.tif or .nxs; for OME-Zarr a folder, .ome.zarr.
    geometry: geometry.json that gives the scale of captures without their own.
    """
    endings = EXPORT_ENDINGS[format_]
    if not out.name.lower().endswith(endings):
        raise BadParameter(f"{out} must end in {' or '.join(endings)}", param_hint="--out")
    _refuse_within(out, directory)
    is_replaced = format_ == "ome-zarr" and out.is_dir()
    if is_replaced:
        _refuse_folder(out, force=force)
    else:
        terminal.refuse_replacing(out)
    how = terminal.keywords_of(library.export_session, format=format_)
    done = library.export_session(directory, out, **how)
    terminal.answer(done.to_json, lambda: terminal.say(f"wrote {out}: {done.captures} captures"))


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
        raise ApplicationError(f"cannot write {out}: it is a folder, but not an OME-Zarr")
    if not force:
        raise ApplicationError(f"{out} exists already; --force replaces it, or name another one")


@terminal.command()
def report(
    directory: terminal.SessionFolder,
    out: Annotated[Path | None, Option(), terminal.REPORT] = None,
) -> None:
    """Write a report on a session and the results obtained from it so far.

    Options
    -------
    out: Report to write (HTML or PDF); DIRECTORY/results/report.html by default.
    """
    written = library.write_report(directory, out, progress=terminal.ShownProgress())
    terminal.answer(written.to_json, lambda: terminal.say(f"wrote {written.report}"))
