"""What a capture session holds, whether it is whole, and what is noted in it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from acquisition.dataframe import dataframe
from acquisition.errors import SessionError
from acquisition.session import (
    MANIFEST_NAME,
    JournalEvent,
    RepairReport,
    Session,
    SessionNotes,
    VerifyReport,
    repair_session,
    verify,
)
from simulation.arguments import checked
from simulation.notebook import Shown, html_table
from standoff.errors import ApplicationError
from standoff.library.caller import login_name
from standoff.library.files import refusal_text
from standoff.library.inputs import FilePath, opened_session, path_of

if TYPE_CHECKING:
    from pandas import DataFrame


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class VerifiedSession(Shown):
    """Every file of a session held against its journal; what was repaired before, if asked for."""

    session: Path
    report: VerifyReport
    repaired: RepairReport | None = None

    def __repr__(self) -> str:
        faults = len(self.report.faults)
        state = "sound" if self.is_ok else f"not sound, {faults} faults"
        return f"<VerifiedSession {self.session.name}: {len(self.report.files)} files, {state}>"

    def _repr_html_(self) -> str:
        rows = [(str(one["file"]), str(one["state"])) for one in self.to_json()["files"]]
        return html_table(repr(self)[1:-1], ("file", "state"), rows)

    def to_dataframe(self) -> "DataFrame":
        """Return the files as a pandas table, a line each.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.
        """
        return dataframe(self.to_json()["files"])

    @property
    def is_ok(self) -> bool:
        """Whether nothing is at odds, and every file that counts is there and unchanged."""
        return self.report.is_ok

    @property
    def notes(self) -> tuple[str, ...]:
        """What is odd but no fault, and what a repair did."""
        return (*(self.repaired.remarks if self.repaired else ()), *self.report.remarks)

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
            "repaired": None if self.repaired is None else self.repaired.to_json(),
        }


@checked
def verify_session(session: FilePath, *, repair: bool = False) -> VerifiedSession:
    """Check every file of a session against its journal.

    Parameters
    ----------
    session
        The folder.
    repair
        Make a new journal of what a damaged one and the captures themselves still say, first; the
        old one is kept.

    Returns
    -------
    VerifiedSession
        The state of each file, and what a repair did.

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


@checked
def list_sessions(folder: FilePath) -> list[dict[str, Any]]:
    """Return plan, captures, creation time and operator of the sessions in a folder.

    Parameters
    ----------
    folder
        Of sessions, or one session. One that cannot be read has an ``error`` instead.

    Returns
    -------
    list of dict
        A session each, as ``standoff session list --json`` prints it.

    Raises
    ------
    ApplicationError
        If it is no folder, or one that cannot be read.

    Examples
    --------
    >>> [(one["session"], one["captured"]) for one in standoff.list_sessions(".")]
    [('board', 3), ('flats', 8), ('session', 6)]
    """
    path = path_of(folder, "folder")
    if not path.is_dir():
        raise ApplicationError(f"{path} is not a folder; name the one that holds the sessions")
    try:
        folders = [path] * (path / MANIFEST_NAME).exists() + sorted(path.iterdir())
    except OSError as error:
        raise ApplicationError(f"cannot read the folder {path}: {error.strerror}") from error
    found = []
    for one in folders:
        manifest = one / MANIFEST_NAME
        try:
            if manifest.exists():
                found.append(Session(one).summary)
        except SessionError as error:
            found.append({"session": str(one), "error": str(error)})
        except OSError as error:
            found.append({"session": str(one), "error": refusal_text(manifest, error)})
    return found


@checked
def show_session(session: Session | FilePath) -> dict[str, Any]:
    """Return a session's captures, whether they are used, and its notes.

    Parameters
    ----------
    session
        A session or its folder.

    Returns
    -------
    dict
        As ``standoff session show --json`` prints it.

    Raises
    ------
    SessionError
        If it cannot be read.

    Examples
    --------
    >>> shown = standoff.show_session("session")
    >>> shown["captured"]
    6
    """
    return opened_session(session).to_json()


@checked
def exclude_capture(
    session: Session | FilePath, index: int, reason: str, *, operator: str | None = None
) -> None:
    """Exclude a capture from calibration and analysis; its file stays.

    Parameters
    ----------
    session
        A session or its folder.
    index
        Of the capture.
    reason
        Recorded in the journal.
    operator
        Whose decision it is; the login name if None.

    Raises
    ------
    SessionError
        If it is no session, is being written, or has no such capture.

    Examples
    --------
    >>> standoff.exclude_capture("session", 3, "a hair on the target")
    >>> standoff.Session("session").captures[3].excluded_because
    'a hair on the target'
    """
    _notes(session, operator).exclude(index, reason)


@checked
def include_capture(
    session: Session | FilePath, index: int, reason: str = "", *, operator: str | None = None
) -> None:
    """Use an excluded capture again.

    Parameters
    ----------
    session, index, reason, operator
        As in ``exclude_capture``.

    Examples
    --------
    >>> standoff.exclude_capture("session", 3, "a hair on the target")
    >>> standoff.include_capture("session", 3)
    >>> standoff.Session("session").captures[3].excluded_because is None
    True
    """
    _notes(session, operator).include(index, reason)


@checked
def correct_height(
    session: Session | FilePath,
    indices: Sequence[int],
    height_mm: float,
    reason: str,
    *,
    operator: str | None = None,
) -> tuple[JournalEvent, ...]:
    """Correct the height of imported photographs; what was recorded before is kept.

    Parameters
    ----------
    session, reason, operator
        As in ``exclude_capture``.
    indices
        Of the captures.
    height_mm
        The right height of the camera.

    Returns
    -------
    tuple of JournalEvent
        A line of the journal for each capture.

    Raises
    ------
    ValueError
        If the height is not a finite number.
    SessionError
        Besides, if a stage has read the heights back.

    Examples
    --------
    >>> paths = ["before.tif"]
    >>> made = standoff.import_photographs(paths, "imported", kind="texture", height_mm=250)
    >>> lines = standoff.correct_height("imported", [0], 262.5, "measured with a tape")
    >>> standoff.Session("imported").records[0].height_mm
    262.5
    """
    return _notes(session, operator).correct_height(indices, height_mm, reason)


@checked
def add_note(session: Session | FilePath, text: str, *, operator: str | None = None) -> None:
    """Add a note to the session's journal.

    Parameters
    ----------
    session, operator
        As in ``exclude_capture``.
    text
        Of the note.

    Examples
    --------
    >>> standoff.add_note("session", "the lamp was changed after capture 2")
    """
    _notes(session, operator).note(text)


@checked
def set_aside_files(
    session: Session | FilePath, reason: str, *, operator: str | None = None
) -> tuple[dict[str, str], ...]:
    """Move files that the journal does not name to the session's folder ``set-aside``.

    Such files end a capture run, as they may be captures whose lines were lost: let
    ``verify_session(..., repair=True)`` take those in first.

    Parameters
    ----------
    session, operator
        As in ``exclude_capture``.
    reason
        What they are; recorded in the journal.

    Returns
    -------
    tuple of dict
        Of each file its name before (``file``) and now (``to``), and its ``sha256``.

    Raises
    ------
    SessionError
        If it is no session, is being written, or a file cannot be moved.

    Examples
    --------
    >>> from shutil import copy
    >>> copied = copy("before.tif", "session/captures")
    >>> [one["to"] for one in standoff.set_aside_files("session", "dropped here by mistake")]
    ['set-aside/before.tif']
    """
    return _notes(session, operator).set_aside(reason)


def _notes(session: Session | FilePath, operator: str | None) -> SessionNotes:
    path = session.path if isinstance(session, Session) else path_of(session, "session")
    return SessionNotes(path, operator=operator or login_name())
