"""The sessions in one folder, as the console shows and serves them."""

import re
from dataclasses import dataclass
from pathlib import Path

from acquisition.errors import SessionError
from acquisition.session import JOURNAL_NAME, MANIFEST_NAME, Session
from standoff.console.photographs import PHOTOGRAPHS_FOLDER
from standoff.console.results import export_path, page_path
from standoff.errors import ApplicationError
from standoff.library import RESULTS_FOLDER

REPORT_NAME = "report.html"
SNAPSHOTS_FOLDER = "snapshots"
"""Beside the sessions: no session can have this name."""

CURVES_FOLDER = "curves"
"""Of the files of curves that were sent to the console; no session can have this name either."""

TAKEN_NAMES = (SNAPSHOTS_FOLDER, CURVES_FOLDER, PHOTOGRAPHS_FOLDER)
LONGEST_NAME_BYTES = 255
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9 ._+-]{0,99}")


class UnknownSessionError(ApplicationError):
    """There is no session with that name in the folder."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionSummary:
    """One line about a session; ``fault`` says why it cannot be read, and is empty if it can."""

    name: str
    plan: str = ""
    operator: str = ""
    created_utc: str = ""
    captured: int = 0
    planned: int = 0
    excluded: int = 0
    has_report: bool = False
    fault: str = ""

    @property
    def is_complete(self) -> bool:
        """Whether the whole plan is captured."""
        return not self.fault and self.captured == self.planned


def is_session_name(name: str) -> bool:
    """Whether a name is valid for a session's folder: no separators, no leading dot."""
    is_plain = _NAME.fullmatch(name) is not None and not name.endswith((".", " "))
    return is_plain and name.lower() not in TAKEN_NAMES


def _is_entry_name(name: str) -> bool:
    """Whether a name can be that of a folder entry that is not hidden."""
    return (
        0 < len(name.encode("utf-8", "replace")) <= LONGEST_NAME_BYTES
        and not name.startswith(".")
        and not any(mark in name for mark in "/\\\0")
        and name.isprintable()
    )


class SessionLibrary:
    """Reads a folder of sessions; names from outside are checked before they touch a path.

    New sessions get plain names. Existing ones, made by other commands, may have any name.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._known: dict[str, tuple[tuple[int, ...], SessionSummary]] = {}
        self._last: tuple[str, tuple[int, ...], Session] | None = None

    def summaries(self) -> tuple[SessionSummary, ...]:
        """All sessions, the newest first."""
        names = [
            path.parent.name
            for path in self.folder.glob(f"*/{MANIFEST_NAME}")
            if _is_entry_name(path.parent.name) and not path.parent.is_symlink()
        ]
        found = [self._summary(name) for name in names]
        return tuple(sorted(found, key=lambda each: (each.created_utc, each.name), reverse=True))

    def path_for(self, name: str) -> Path:
        """Path of a new session with that name."""
        if not is_session_name(name):
            raise UnknownSessionError(
                "a session's name has only letters, digits, spaces and . _ + -, and must begin "
                f"with a letter or digit; it is none of {', '.join(TAKEN_NAMES)}"
            )
        return self.folder / name

    def path_of(self, name: str) -> Path:
        """Path of the session with that name."""
        path = self.folder / name
        if not _is_entry_name(name) or path.is_symlink() or not (path / MANIFEST_NAME).is_file():
            raise UnknownSessionError(f"there is no session {name!r}")
        return path

    def open(self, name: str) -> Session:
        """Read the session with that name."""
        return Session(self.path_of(name))

    def read(self, name: str) -> Session:
        """As `open`, but the session that was read last is read again only if it has changed.

        Whoever turns the pages of a long one does not wait for its journal each time.
        """
        state, last = _state_of(self.path_of(name)), self._last
        if last is not None and last[:2] == (name, state):
            return last[2]
        session = self.open(name)
        self._last = (name, state, session)
        return session

    def report_of(self, name: str) -> bytes | None:
        """The session's report, or None if it has not been written yet."""
        path = self.path_of(name) / RESULTS_FOLDER / REPORT_NAME
        if path.is_symlink() or path.parent.is_symlink() or not path.is_file():
            return None
        return path.read_bytes()

    def result_page(self, name: str, page: str) -> bytes | None:
        """A result's page or picture by its name in the results folder; None if not there."""
        path = page_path(self.path_of(name), page)
        return None if path is None else path.read_bytes()

    def export_of(self, name: str, file: str) -> Path | None:
        """Path of a file that a session was exported to; None if not there."""
        return export_path(self.path_of(name), file)

    def _summary(self, name: str) -> SessionSummary:
        """Read a session only if its files have changed: a journal can be long."""
        state = _state_of(self.folder / name)
        known = self._known.get(name)
        if known is None or known[0] != state:
            known = self._known[name] = (state, self._read(name))
        return known[1]

    def _read(self, name: str) -> SessionSummary:
        try:
            session = self.open(name)
        except (SessionError, UnknownSessionError) as error:
            return SessionSummary(name=name, fault=str(error))
        kept = [capture for capture in session.captures if not capture.is_superseded]
        return SessionSummary(
            name=name,
            plan=session.plan.name,
            operator=session.manifest.operator,
            created_utc=session.manifest.created_utc,
            captured=len({capture.record.index for capture in kept}),
            planned=len(session.entries),
            excluded=sum(capture.excluded_because is not None for capture in kept),
            has_report=self.report_of(name) is not None,
        )


def _state_of(path: Path) -> tuple[int, ...]:
    """Sizes and times of the files that a summary is made from; 0 for missing ones."""
    state: list[int] = []
    for file in (MANIFEST_NAME, JOURNAL_NAME, f"{RESULTS_FOLDER}/{REPORT_NAME}"):
        try:
            found = (path / file).stat()
        except OSError:
            state += (0, 0)
        else:
            state += (found.st_size, found.st_mtime_ns)
    return tuple(state)
