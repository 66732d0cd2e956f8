"""What a capture session holds, whether it is whole, and what is noted in it."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from acquisition.errors import SessionError
from acquisition.session import (
    MANIFEST_NAME,
    RepairReport,
    Session,
    SessionNotes as SessionNotes,
    VerifyReport,
    repair_session,
    verify,
)
from standoff.errors import ApplicationError
from standoff.library.inputs import FilePath, opened_session, path_of

_QUOTED = 300
"""Characters of a lost line that a note shows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class VerifiedSession:
    """Every file of a session held against its journal; what was repaired before, if asked for."""

    session: Path
    report: VerifyReport
    repaired: RepairReport | None = None

    @property
    def is_ok(self) -> bool:
        """Whether nothing is at odds, and every file that counts is there and unchanged."""
        return self.report.is_ok

    @property
    def notes(self) -> tuple[str, ...]:
        """What is odd but no fault, and what a repair did."""
        return (*self._repair_notes(), *self.report.remarks)

    def _repair_notes(self) -> list[str]:
        done = self.repaired
        if done is None:
            return []
        if done.kept_as is None:
            return ["the journal is sound; nothing was repaired"]
        lost = [f"line {one.number} is lost: {_quoted(one.text)}" for one in done.lost]
        return [
            f"the journal was made anew of {done.lines} lines; the old one is {done.kept_as.name}",
            *(f"capture {one.index} was brought back from {one.file}" for one in done.recovered),
            *lost,
            *(f"{file} is not a capture of this session and was left out"
              for file in done.unknown_files),
        ]  # fmt: skip

    def to_json(self) -> dict[str, Any]:
        """Return the checks as ``standoff verify --json`` prints them."""
        return {
            "session": str(self.session),
            "ok": self.is_ok,
            "files": [
                {"file": one.file, "state": one.state, "superseded": one.is_superseded}
                for one in self.report.files
            ],
            "faults": list(self.report.faults),
            "remarks": list(self.report.remarks),
            "repaired": None if self.repaired is None else _repair_facts(self.repaired),
        }


def verify_session(session: FilePath, *, repair: bool = False) -> VerifiedSession:
    """Check every file of a session against its journal.

    Parameters
    ----------
    session
        The folder.
    repair
        Make a new journal of what a damaged one and the captures themselves still say, first; the
        old one is kept.

    Raises
    ------
    SessionError
        If it is not a session, or its session.json or journal is damaged.

    Examples
    --------
    >>> standoff.verify_session("session").is_ok
    True
    """
    folder = path_of(session, "session")
    repaired = repair_session(folder) if repair else None
    return VerifiedSession(session=folder, report=verify(folder), repaired=repaired)


def list_sessions(folder: FilePath) -> list[dict[str, Any]]:
    """Return plan, captures, creation time and operator of the sessions in a folder.

    Parameters
    ----------
    folder
        Of sessions, or one session. One that cannot be read has an ``error`` instead.

    Raises
    ------
    ApplicationError
        If it is no folder.

    Examples
    --------
    >>> [one["session"] for one in standoff.list_sessions("sessions")]
    """
    path = path_of(folder, "folder")
    if not path.is_dir():
        raise ApplicationError(f"{path} is not a folder; name the one that holds the sessions")
    found = []
    for manifest in [*path.glob(MANIFEST_NAME), *sorted(path.glob(f"*/{MANIFEST_NAME}"))]:
        try:
            found.append(session_summary(Session(manifest.parent)))
        except SessionError as error:
            found.append({"session": str(manifest.parent), "error": str(error)})
    return found


def session_summary(session: Session) -> dict[str, Any]:
    """Return how much of its plan a session holds, and who made it when."""
    current = [capture for capture in session.captures if not capture.is_superseded]
    return {
        "session": str(session.path),
        "plan": session.plan.name,
        "operator": session.manifest.operator,
        "created_utc": session.manifest.created_utc,
        "captured": len({capture.record.index for capture in current}),
        "planned": len(session.entries),
        "excluded": sum(capture.excluded_because is not None for capture in current),
    }


def show_session(session: Session | FilePath) -> dict[str, Any]:
    """Return a session's captures, whether they are used, and its notes.

    Raises
    ------
    SessionError
        If it cannot be read.

    Examples
    --------
    >>> standoff.show_session("session")["captured"]
    """
    opened = opened_session(session)
    return {
        **session_summary(opened),
        "captures": [
            {
                **capture.record.to_json(),
                "superseded": capture.is_superseded,
                "excluded_because": capture.excluded_because,
                "uncorrected_height_mm": capture.uncorrected_height_mm,
            }
            for capture in sorted(opened.captures, key=lambda capture: capture.record.index)
        ],
        "notes": [{"utc": e.utc, **e.facts} for e in opened.events if e.kind == "note"],
        "remarks": list(opened.remarks),
    }


def _repair_facts(done: RepairReport) -> dict[str, Any]:
    return {
        "kept_as": None if done.kept_as is None else str(done.kept_as),
        "lines": done.lines,
        "recovered": [record.index for record in done.recovered],
        "lost": [{"line": line.number, "text": line.text} for line in done.lost],
        "unknown_files": list(done.unknown_files),
    }


def _quoted(text: str) -> str:
    return text[:_QUOTED] or "nothing is left of it"
