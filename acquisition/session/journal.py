"""The journal of a session: one event per line, made durable before work continues."""

import io
import json
import os
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any, Literal, Self, get_args

from acquisition.errors import SessionError
from acquisition.regular_files import LARGEST_JOURNAL_BYTES, read_regular_file
from acquisition.session.durable_write import fsync_directory
from acquisition.session.record import utc_text
from acquisition.untrusted import parse_json

try:
    import fcntl
except ModuleNotFoundError:  # Windows
    fcntl = None  # type: ignore[assignment]


EventKind = Literal[
    "start",
    "plan",
    "capture",
    "skip",
    "error",
    "resume",
    "stop",
    "retake",
    "exclude",
    "include",
    "note",
]

_OWN_KEYS = ("event", "utc", "uid")


@dataclass(frozen=True, slots=True, kw_only=True)
class JournalEvent:
    """One event: kind, time (UTC, ISO 8601), its own uid, and facts that depend on the kind."""

    kind: EventKind
    utc: str
    uid: str
    facts: Mapping[str, Any]

    def __post_init__(self) -> None:
        if not self.facts.keys().isdisjoint(_OWN_KEYS):
            raise ValueError(f"facts must not be named {_OWN_KEYS}, got {list(self.facts)}")

    def to_line(self) -> bytes:
        """The event as one line of the journal, newline included."""
        document = {"event": self.kind, "utc": self.utc, "uid": self.uid, **self.facts}
        return json.dumps(document, ensure_ascii=False, allow_nan=False).encode() + b"\n"

    @classmethod
    def from_line(cls, line: bytes) -> Self:
        """Read one line.

        Raises
        ------
        ValueError
            If it is not an event; the message says why.
        """
        document = parse_json(line)
        if not isinstance(document, dict):
            raise ValueError("not a JSON object")  # noqa: TRY004
        facts = {key: value for key, value in document.items() if key not in _OWN_KEYS}
        utc, uid = document.get("utc"), document.get("uid")
        if not (isinstance(utc, str) and isinstance(uid, str) and uid):
            raise ValueError("an event needs utc and uid")
        for kind in get_args(EventKind):
            if kind == document.get("event"):
                return cls(kind=kind, utc=utc, uid=uid, facts=facts)
        raise ValueError(f"unknown event {document.get('event')!r}")


@dataclass(frozen=True, slots=True, kw_only=True)
class JournalReading:
    """The events of a journal; ``sound_bytes`` of the file hold them, ``torn_tail`` is the rest."""

    events: tuple[JournalEvent, ...]
    sound_bytes: int
    torn_tail: bytes = b""

    @property
    def remark(self) -> str | None:
        """What to tell the operator about the tail, if there is one."""
        if not self.torn_tail:
            return None
        return (
            f"the last line of the journal was cut short and is ignored "
            f"(line {len(self.events) + 1}, {len(self.torn_tail)} bytes)"
        )


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

    Raises
    ------
    SessionError
        If another process holds the journal, or it is damaged or cannot be written.
    """

    def __init__(self, path: Path, stamps: Stamps = SYSTEM_STAMPS) -> None:
        self._path = path
        self._stamps = stamps
        try:
            self._descriptor = os.open(path, os.O_RDWR | os.O_APPEND | os.O_CREAT, 0o666)
        except OSError as error:
            raise SessionError(
                f"journal {path}: {error.strerror}", fault="unwritable", path=path
            ) from error
        try:
            self._lock()
            self.events = self._mend()
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
            If it cannot be written; the journal is then as it was before.
        """
        event = JournalEvent(
            kind=kind,
            utc=utc_text(self._stamps.utc_now()),
            uid=self._stamps.new_uid() if uid is None else uid,
            facts=dict(facts),
        )
        self._write(event.to_line())
        self.events = (*self.events, event)
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

    def _mend(self) -> tuple[JournalEvent, ...]:
        try:
            data = read_regular_file(self._path, LARGEST_JOURNAL_BYTES)
        except OSError as error:
            raise SessionError(
                f"journal {self._path}: {error.strerror}; restore it from a copy",
                fault="damaged",
                path=self._path,
            ) from error
        reading = read_journal(data, source=str(self._path))
        self.events = reading.events
        fsync_directory(self._path.parent)
        if reading.torn_tail:
            os.ftruncate(self._descriptor, reading.sound_bytes)
        if reading.sound_bytes and data[reading.sound_bytes - 1 : reading.sound_bytes] != b"\n":
            self._write(b"\n")
        if reading.remark is not None:
            text = reading.torn_tail.decode(errors="backslashreplace")
            self.append("note", {"text": reading.remark, "cut_short": text})
        return self.events

    def _write(self, line: bytes) -> None:
        start = os.fstat(self._descriptor).st_size
        try:
            written = 0
            while written < len(line):
                written += os.write(self._descriptor, line[written:])
            os.fsync(self._descriptor)
        except BaseException as error:
            # Half a line followed by another would be damage: remove it.
            try:
                os.ftruncate(self._descriptor, start)
            except OSError as second:
                error.add_note(f"removing the half-written line failed too: {second}")
            if isinstance(error, OSError):
                raise SessionError(
                    f"journal {self._path}: {error.strerror}; check the disk and run again",
                    fault="unwritable",
                    path=self._path,
                ) from error
            raise


def read_journal(data: bytes, *, source: str = "journal.jsonl") -> JournalReading:
    r"""Read a journal as far as it is sound.

    Every line was made durable before the next was begun, so that a power cut can affect only
    the last line: if that does not parse, it was cut short and is ignored. No event's text is
    the beginning of another's, so a last line that parses is complete even without its ``\n``.
    A bad line anywhere before it is damage.

    Raises
    ------
    SessionError
        If a line before the last is damaged; the message names it.
    """
    lines = io.BytesIO(data).readlines()
    events: list[JournalEvent] = []
    sound_bytes = 0
    for number, line in enumerate(lines, start=1):
        try:
            events.append(JournalEvent.from_line(line))
        except ValueError as error:
            if number == len(lines):
                break
            raise SessionError(
                f"{source}, line {number}: damaged ({error}); restore the file from a copy",
                fault="damaged",
                line=number,
            ) from error
        sound_bytes += len(line)
    return JournalReading(
        events=tuple(events), sound_bytes=sound_bytes, torn_tail=data[sound_bytes:]
    )


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
