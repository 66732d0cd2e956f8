"""The journal of a session: one event per line, made durable before work continues."""

import errno
import os
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from acquisition.errors import SessionError
from acquisition.regular_files import size_text
from acquisition.session.durable_write import (
    PART_SUFFIX,
    helper_thread,
    open_own,
    open_part,
)
from acquisition.session.journal_chain import (
    HEAD_NAME,
    LARGEST_LINE_BYTES,
    NO_LINES,
    ChainedLine,
    JournalHead,
    chain_after,
)
from acquisition.session.journal_event import EventKind, JournalEvent
from acquisition.session.journal_reading import JournalReading, read_journal_file
from acquisition.session.record import utc_text
from acquisition.session.shared_files import fsync_directory

_QUOTED_BYTES = LARGEST_LINE_BYTES // 8
"""Of a torn tail: the text of a byte takes up to six in JSON."""

try:
    import fcntl
except ModuleNotFoundError:  # Windows
    fcntl = None  # type: ignore[assignment]


def _utc_now() -> datetime:
    return datetime.now(UTC)


def _new_uid() -> str:
    return uuid.uuid4().hex


@dataclass(frozen=True, slots=True, kw_only=True)
class Stamps:
    """Source of time stamps and identities: the computer's clock and random numbers."""

    utc_now: Callable[[], datetime] = _utc_now
    new_uid: Callable[[], str] = _new_uid


SYSTEM_STAMPS = Stamps()


class JournalWriter:
    """The one process that may append to a journal, for as long as it holds the lock.

    ``flock`` ends with the process, so that a killed one leaves no stale lock. Opening repairs a
    torn tail: it is cut off and quoted in a ``note`` event.

    Parameters
    ----------
    examine
        Called with the journal as it was found, before it is repaired; what it raises leaves
        the journal so.

    Raises
    ------
    SessionError
        If another process holds the journal, or it is damaged or cannot be written.
    """

    def __init__(
        self,
        path: Path,
        stamps: Stamps = SYSTEM_STAMPS,
        examine: Callable[[JournalReading], None] = lambda _: None,
    ) -> None:
        self.events: tuple[JournalEvent, ...] = ()
        self._path = path
        self._stamps = stamps
        self._chain, self._size = NO_LINES, 0
        try:
            self._descriptor = open_own(path, os.O_RDWR | os.O_APPEND | os.O_CREAT)
        except OSError as error:
            raise self._refusal(error) from error
        try:
            self._lock()
            examine(read_journal_file(path))
            self._mend()
        except BaseException:
            self.close()
            raise

    def append(
        self, kind: EventKind, facts: Mapping[str, Any], *, uid: str | None = None
    ) -> JournalEvent:
        """Append one event; when this returns, it is on the disk.

        Raises
        ------
        SessionError
            If it is too long or cannot be written; the journal is then as it was before.
        """
        event = JournalEvent(
            kind=kind,
            utc=utc_text(self._stamps.utc_now()),
            uid=self._stamps.new_uid() if uid is None else uid,
            facts=dict(facts),
        )
        if os.fstat(self._descriptor).st_size != self._size:
            self._mend()  # the append before this one was interrupted
        number = len(self.events) + 1
        text = event.to_text(number)
        link = ChainedLine(text=text, chain=chain_after(self._chain, text))
        line = link.to_bytes()
        if len(line) > LARGEST_LINE_BYTES:
            raise SessionError(
                f"journal {self._path}: a {kind} of {size_text(len(line))}, at most "
                f"{size_text(LARGEST_LINE_BYTES)} are written; keep it in a file and name that",
                path=self._path,
            )
        self._write(line, JournalHead(lines=number, chain=link.chain))
        self.events = (*self.events, event)
        self._chain = link.chain
        return event

    def close(self) -> None:
        """Release the lock; closing twice is harmless."""
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _lock(self) -> None:
        try:
            lock_exclusively(self._descriptor)
        except BlockingIOError as error:
            raise SessionError(
                f"session {self._path.parent} is in use by another process; "
                "wait for it to end, or stop it",
                fault="in use",
                path=self._path.parent,
            ) from error

    def _mend(self) -> None:
        """Cut off a torn tail, bring the head up to date, and note what was done."""
        try:
            self._mend_file()
        except OSError as error:
            raise self._refusal(error) from error

    def _mend_file(self) -> None:
        reading = read_journal_file(self._path)
        fsync_directory(self._path.parent)
        if reading.torn_tail:
            os.ftruncate(self._descriptor, reading.sound_bytes)
        if not self._ends_in_newline():
            self._write(b"\n", None)
        mended = read_journal_file(self._path)
        self.events, self._chain = mended.events, mended.chain
        self._size = os.fstat(self._descriptor).st_size
        if reading.torn_tail:
            text = reading.torn_tail[:_QUOTED_BYTES].decode(errors="backslashreplace")
            self.append("note", {"text": reading.remarks[0], "cut_short": text})
        if reading.is_head_missing:
            self.append("note", {"text": f"{HEAD_NAME} was missing; lines may be, at the end"})
        elif len(mended.events) > mended.unchained and not _is_counted(mended):
            self._replace_head(JournalHead(lines=len(mended.events), chain=mended.chain))

    def _refusal(self, error: OSError) -> SessionError:
        remedy = "" if error.errno == errno.ELOOP else "; check the disk and run again"
        return SessionError(
            f"journal {self._path}: {error.strerror}{remedy}",
            fault="unwritable",
            path=self._path,
        )

    def _ends_in_newline(self) -> bool:
        with self._path.open("rb") as file:
            size = file.seek(0, os.SEEK_END)
            file.seek(max(size - 1, 0))
            return file.read(1) in (b"", b"\n")

    def _write(self, line: bytes, head: JournalHead | None) -> None:
        """Append to the file and replace the head; undo the former if the disk refuses."""
        start = os.fstat(self._descriptor).st_size
        try:
            written = 0
            while written < len(line):
                written += os.write(self._descriptor, line[written:])
            if head is None:
                os.fsync(self._descriptor)
            else:
                self._replace_head(head)
        except OSError as error:
            # Half a line followed by another would be damage: remove it.
            try:
                os.ftruncate(self._descriptor, start)
            except OSError as second:
                error.add_note(f"removing the half-written line failed too: {second}")
            raise self._refusal(error) from error
        self._size = os.fstat(self._descriptor).st_size

    def _replace_head(self, head: JournalHead) -> None:
        """Make the lines durable, and then replace the head, whole or not at all.

        The disk works at the lines and at the head's part at once. The head's name is durable with
        the next line: a file system's journal keeps the order, and a head that lags behind is no
        fault.
        """
        path = self._path.with_name(HEAD_NAME)
        with open_part(path) as file:
            file.write(head.to_bytes())
            file.flush()
            lines = helper_thread().submit(os.fsync, self._descriptor)
            try:
                os.fsync(file.fileno())
            finally:
                lines.result()
        path.with_name(path.name + PART_SUFFIX).replace(path)


def _is_counted(reading: JournalReading) -> bool:
    return reading.head is not None and reading.head.lines == len(reading.events)


def lock_exclusively(descriptor: int) -> None:
    """Lock an open file; closing the descriptor or ending the process releases it.

    Raises
    ------
    BlockingIOError
        If another process holds it.
    """
    if fcntl is not None:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        return
    import msvcrt  # exists on Windows alone

    # A byte far behind the end: Windows bars even readers from a locked part of a file.
    position = os.lseek(descriptor, 0, os.SEEK_CUR)
    try:
        os.lseek(descriptor, 1 << 40, os.SEEK_SET)
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
    except PermissionError as error:
        raise BlockingIOError(error.errno, "the file is locked") from error
    finally:
        os.lseek(descriptor, position, os.SEEK_SET)
