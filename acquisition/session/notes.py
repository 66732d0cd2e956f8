"""An operator's decisions about a session: exclude, include or retake a capture, or note.

Of imported photographs also the height, which nothing has measured.
"""

import math
from collections.abc import Sequence
from pathlib import Path

from acquisition.errors import SessionError
from acquisition.session.capture_files import set_aside, unknown_files
from acquisition.session.journal import SYSTEM_STAMPS, JournalWriter, Stamps
from acquisition.session.journal_event import EventKind, JournalEvent
from acquisition.session.reader import JOURNAL_NAME, Session, captures_of, current_capture


class SessionNotes:
    """Journals the decisions of ``operator`` about the session at ``path``.

    Each call locks the session while it writes, so that it is refused while a run is writing.

    Raises
    ------
    SessionError
        By every call, if ``path`` is not a session, is in use, or has no such capture.
    """

    def __init__(
        self,
        path: Path,
        *,
        operator: str,
        stamps: Stamps = SYSTEM_STAMPS,
    ) -> None:
        self._path = path
        self._operator = operator
        self._stamps = stamps

    def exclude(self, index: int, reason: str) -> JournalEvent:
        """Keep the capture of an entry out of calibration and analysis."""
        return self._decide("exclude", index, reason)

    def include(self, index: int, reason: str) -> JournalEvent:
        """Include an excluded capture again."""
        return self._decide("include", index, reason)

    def retake(self, index: int, reason: str) -> JournalEvent:
        """Void the capture of an entry; the next run captures it again."""
        return self._decide("retake", index, reason)

    def correct_height(
        self, indices: Sequence[int], height_mm: float, reason: str
    ) -> tuple[JournalEvent, ...]:
        """State another height of imported photographs; their captures keep what they recorded.

        Raises
        ------
        SessionError
            Besides, if a stage read the heights back. Then nothing is journaled.
        ValueError
            If the height is not a finite number.
        """
        if not math.isfinite(height_mm):
            raise ValueError(f"a height must be a finite number, got {height_mm}")
        if Session(self._path).bench:
            raise SessionError(
                f"{self._path} has heights that its stage read back; exclude a capture whose "
                "height is wrong, or retake it",
                fault="made otherwise",
                path=self._path,
            )
        with self._open() as journal:
            captures = captures_of(journal.events, source=str(self._path / JOURNAL_NAME))
            found = [current_capture(captures, index, self._path) for index in indices]
            return tuple(
                journal.append(
                    "height",
                    {
                        "index": capture.record.index,
                        "capture": capture.record.uid,
                        "height_mm": float(height_mm),
                        "was_mm": capture.record.height_mm,
                        "reason": reason,
                        "operator": self._operator,
                    },
                )
                for capture in found
            )

    def note(self, text: str) -> JournalEvent:
        """Record a note for later readers."""
        with self._open() as journal:
            return journal.append("note", {"text": text, "operator": self._operator})

    def set_aside(self, reason: str) -> tuple[dict[str, str], ...]:
        """Move the files that the journal does not name out of the folders of captures.

        Returns
        -------
        tuple of dict
            Of each file its name (``file``), the new one (``to``) and its ``sha256``.
        """
        source = str(self._path / JOURNAL_NAME)
        with self._open() as journal:
            captures = captures_of(journal.events, source=source)
            unknown = unknown_files(self._path, (capture.record for capture in captures))
            try:
                moved = set_aside(self._path, unknown)
            except OSError as error:
                raise SessionError(
                    f"{error.filename or self._path}: cannot be set aside: {error.strerror}",
                    fault="unwritable",
                    path=self._path,
                ) from error
            if moved:
                journal.append(
                    "note", {"text": reason, "set_aside": moved, "operator": self._operator}
                )
        return tuple(moved)

    def _open(self) -> JournalWriter:
        Session(self._path)  # a mistyped path must not become a new journal
        return JournalWriter(self._path / JOURNAL_NAME, self._stamps)

    def _decide(self, kind: EventKind, index: int, reason: str) -> JournalEvent:
        with self._open() as journal:
            captures = captures_of(journal.events, source=str(self._path / JOURNAL_NAME))
            capture = current_capture(captures, index, self._path)
            if kind == "include" and capture.excluded_because is None:
                raise SessionError(
                    f"capture {index} of {self._path} is not excluded",
                    fault="no capture",
                    path=self._path,
                )
            key = "supersedes" if kind == "retake" else "capture"
            facts = {"index": index, key: capture.record.uid}
            return journal.append(kind, {**facts, "reason": reason, "operator": self._operator})
