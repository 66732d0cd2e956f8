"""The journal of a session: one event per line, made durable before work continues.

Each line ends in ``"chain"``: the SHA-256 of the chain before it and of the line without it. What
was altered, removed, added or moved since is then at odds with it. The head holds the number of
lines and the last chain, so that the end cannot go unnoticed either. It guards against accidents;
whoever makes all hashes anew is not found out.
"""

import errno
import hashlib
import io
import json
import os
import re
import uuid
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, Literal, Self, get_args

from acquisition.errors import SessionError
from acquisition.regular_files import LARGEST_JOURNAL_BYTES, read_regular_file, size_text
from acquisition.session._files import (
    PART_SUFFIX,
    fsync_directory,
    helper_thread,
    open_own,
    open_part,
)
from acquisition.session._record import utc_text
from acquisition.untrusted import parse_json

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
    "height",
    "note",
]

_CHAIN_KEYS = ("seq", "chain")
"""What a line has besides its event."""

_OWN_KEYS = ("event", "utc", "uid", *_CHAIN_KEYS)


@dataclass(frozen=True, slots=True, kw_only=True)
class JournalEvent:
    """One event of a journal: kind, time (UTC, ISO 8601), uid, and facts by its kind."""

    kind: EventKind
    utc: str
    uid: str
    facts: Mapping[str, Any]

    def __post_init__(self) -> None:
        if not self.facts.keys().isdisjoint(_OWN_KEYS):
            raise ValueError(f"facts must not be named {_OWN_KEYS}, got {list(self.facts)}")

    def to_text(self, number: int) -> bytes:
        """Return the event as line ``number`` of a journal: a JSON object, without a newline."""
        document = {
            "seq": number,
            "event": self.kind,
            "utc": self.utc,
            "uid": self.uid,
            **self.facts,
        }
        return json.dumps(document, ensure_ascii=False, allow_nan=False).encode()

    @classmethod
    def from_line(cls, line: bytes) -> Self:
        """Read one line, chained or not.

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


HEAD_NAME = "journal.head"
NO_LINES = hashlib.sha256().hexdigest()
"""Chain before the first line."""

LARGEST_LINE_BYTES = 1 << 20
"""Of what is appended; a capture takes 1 kB, and a note fits into a command line of 128 kB."""

_SCHEMA = "standoff.journal-head/1"
_TAIL = re.compile(rb', "chain": "([0-9a-f]{64})"\}')
_TAIL_BYTES = len(b', "chain": ""}') + 64
_SEQ = re.compile(rb'\{"seq": ([0-9]{1,9}), ')


@dataclass(frozen=True, slots=True, kw_only=True)
class ChainedLine:
    """A line taken apart: its JSON object without the chain, and the chain that it states."""

    text: bytes
    chain: str

    @classmethod
    def parse(cls, line: bytes) -> Self | None:
        """Take a line apart; None if it has no chain."""
        line = line.removesuffix(b"\n")
        found = _TAIL.fullmatch(line[-_TAIL_BYTES:])
        if found is None:
            return None
        return cls(text=line[:-_TAIL_BYTES] + b"}", chain=found[1].decode())

    @property
    def number(self) -> int | None:
        """The line's number when it was written."""
        found = _SEQ.match(self.text)
        return None if found is None else int(found[1])

    def to_bytes(self) -> bytes:
        """The line, newline included."""
        return self.text[:-1] + f', "chain": "{self.chain}"}}\n'.encode()


def chain_after(previous: str, text: bytes) -> str:
    """Chain of a line of this text after one with the chain ``previous``."""
    return hashlib.sha256(previous.encode() + text).hexdigest()


@dataclass(frozen=True, slots=True, kw_only=True)
class JournalHead:
    """Number of lines of a journal and the chain of the last one."""

    lines: int
    chain: str

    def to_bytes(self) -> bytes:
        """The file's text."""
        document = {"schema": _SCHEMA, "lines": self.lines, "chain": self.chain}
        return json.dumps(document).encode() + b"\n"

    @classmethod
    def from_bytes(cls, data: bytes) -> Self:
        """Read the file's text."""
        document = parse_json(data)
        if not isinstance(document, dict) or document.get("schema") != _SCHEMA:
            raise ValueError(f"its schema is not {_SCHEMA}")
        head = cls(lines=document.get("lines", 0), chain=document.get("chain", ""))
        if head.to_bytes() != data:
            raise ValueError("it was altered")
        return head

    @classmethod
    def of_journal(cls, journal: Path) -> Self | None:
        """Read the head beside a journal; None if there is none."""
        try:
            data = read_regular_file(journal.with_name(HEAD_NAME))
        except FileNotFoundError:
            return None
        except OSError as error:
            raise ValueError(error.strerror or str(error)) from error
        return cls.from_bytes(data)


_REPAIR = "restore the file from a copy, or see what `standoff verify --repair` can bring back"


@dataclass(frozen=True, slots=True, kw_only=True)
class JournalReading:
    """The events of a journal, one a line, and how much of it is sound.

    ``sound_bytes`` of the file hold them, ``torn_tail`` is the rest. ``chain`` is that of the last
    line, ``unchained`` the number of first lines that an older version did not chain, ``head`` what
    the file beside the journal says.
    """

    events: tuple[JournalEvent, ...]
    sound_bytes: int
    torn_tail: bytes = b""
    chain: str = NO_LINES
    unchained: int = 0
    head: JournalHead | None = None

    @property
    def remarks(self) -> tuple[str, ...]:
        """What to tell the operator, though nothing is lost."""
        remarks = []
        if self.torn_tail:
            remarks.append(
                f"the last line of the journal was cut short and is ignored "
                f"(line {len(self.events) + 1}, {len(self.torn_tail)} bytes)"
            )
        if self.unchained:
            which = (
                "its lines"
                if self.unchained == len(self.events)
                else (
                    "its first line" if self.unchained == 1 else f"its first {self.unchained} lines"
                )
            )
            remarks.append(
                f"the journal is unchained: an older version wrote {which}, "
                "and whether they were altered cannot be told"
            )
        return tuple(remarks)

    @property
    def is_head_missing(self) -> bool:
        """Whether lines may be missing at the end without a trace."""
        return self.head is None and len(self.events) > self.unchained


def _read_journal(
    data: bytes, *, head: JournalHead | None = None, source: str = "journal.jsonl"
) -> JournalReading:
    r"""Read a journal as far as it is sound.

    A power cut can only affect a last line that the head does not count: if that is no event, it
    was cut short and is ignored. No event's text is the beginning of another's, so a last line that
    parses is complete even without its ``\n``. Anything else is damage.
    """
    lines = io.BytesIO(data).readlines()
    sound, sound_bytes = _SoundLines(), 0
    for number, line in enumerate(lines, start=1):
        try:
            sound.add(line)
        except ValueError as error:
            is_counted = head is not None and head.lines >= number
            if number == len(lines) and not is_counted and _may_be_torn(line):
                break
            raise _damaged(source, number, str(error)) from error
        sound_bytes += len(line)
    if head is not None:
        _check_head(head, sound, source)
    return JournalReading(
        events=tuple(sound.events),
        sound_bytes=sound_bytes,
        torn_tail=data[sound_bytes:],
        chain=sound.chains[-1],
        unchained=sound.unchained,
        head=head,
    )


def read_journal_file(path: Path) -> JournalReading:
    """Read a journal and its head."""
    try:
        # The head first: a line that is written meanwhile is then one that it does not count.
        head = JournalHead.of_journal(path)
    except ValueError as error:
        raise SessionError(
            f"{path.with_name(HEAD_NAME)}: damaged ({error}); {_REPAIR}",
            fault="damaged",
            path=path.with_name(HEAD_NAME),
        ) from error
    try:
        data = read_regular_file(path, LARGEST_JOURNAL_BYTES)
    except OSError as error:
        raise SessionError(f"{path}: {error.strerror}; {_REPAIR}", path=path) from error
    return _read_journal(data, head=head, source=str(path))


def _may_be_torn(line: bytes) -> bool:
    """Whether the writing of a line was cut short, for all that it tells."""
    is_whole = line.endswith(b"\n") and ChainedLine.parse(line) is not None
    return not is_whole and len(line) <= LARGEST_LINE_BYTES


class _SoundLines:
    """Events of the lines so far, and what the next one follows."""

    def __init__(self) -> None:
        self.events: list[JournalEvent] = []
        self.chains = [NO_LINES]
        self.unchained = 0
        self._unchained_bytes = hashlib.sha256()

    def add(self, line: bytes) -> None:
        """Add a line."""
        number = len(self.events) + 1
        link = ChainedLine.parse(line)
        if link is None:
            if self.unchained < len(self.events):
                raise ValueError("it has no chain, but the lines before it have")
            event = _unchained_event(line)
            self.unchained += 1
            self._unchained_bytes.update(line)
            chain = self._unchained_bytes.hexdigest()
        else:
            if chain_after(self.chains[-1], link.text) != link.chain:
                if link.number in (None, number):
                    raise ValueError("it was altered after it was written")
                raise ValueError(
                    f"it was written as line {link.number}: lines were removed, added or moved"
                )
            event, chain = JournalEvent.from_line(link.text), link.chain
        self.events.append(event)
        self.chains.append(chain)


def _unchained_event(line: bytes) -> JournalEvent:
    """An event of a version that did not chain; nothing but its own text vouches for it."""
    event = JournalEvent.from_line(line)
    keys = parse_json(line, has_single_keys=True).keys()
    if not keys.isdisjoint(_CHAIN_KEYS):
        raise ValueError("its chain is damaged")
    return event


def _check_head(head: JournalHead, sound: _SoundLines, source: str) -> None:
    """Compare the end of a journal with its head."""
    count = len(sound.events)
    if head.lines > count:
        raise _damaged(source, count + 1, f"missing; {HEAD_NAME} counts {head.lines} lines")
    if sound.chains[head.lines] != head.chain:
        raise _damaged(source, head.lines, f"at odds with {HEAD_NAME}")


def _damaged(source: str, number: int, why: str) -> SessionError:
    return SessionError(
        f"{source}, line {number}: damaged ({why}); {_REPAIR}", fault="damaged", line=number
    )


_QUOTED_BYTES = LARGEST_LINE_BYTES // 8
"""Of a torn tail: the text of a byte takes up to six in JSON."""

try:
    import fcntl
except ModuleNotFoundError:  # Windows
    fcntl = None  # type: ignore[assignment]


@dataclass(frozen=True, slots=True, kw_only=True)
class Stamps:
    """Source of time stamps and identities: the computer's clock and random numbers."""

    utc_now: Callable[[], datetime] = lambda: datetime.now(UTC)
    new_uid: Callable[[], str] = lambda: uuid.uuid4().hex


SYSTEM_STAMPS = Stamps()


class JournalWriter:
    """The one process that may append to a journal, for as long as it holds the ``flock``.

    Opening cuts off a torn tail and quotes it in a ``note``, after ``examine`` was called with the
    journal as it was found; what that raises leaves it so.
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
        """Append one event; when this returns, it is on the disk."""
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
                f"journal {self._path}: this {kind} takes {size_text(len(line))}, but at most "
                f"{size_text(LARGEST_LINE_BYTES)} is allowed; put it in a file and name the file",
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

    def __exit__(self, *_: object) -> None:
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
            text = f"{HEAD_NAME} was missing; lines at the end may be missing, too"
            self.append("note", {"text": text})
        elif len(mended.events) > mended.unchained and (
            mended.head is None or mended.head.lines != len(mended.events)
        ):
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
        """Make the lines durable, and replace the head, at once.

        The head's name is durable with the next line; a head that lags behind is no fault.
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


def lock_exclusively(descriptor: int) -> None:
    """Lock an open file; closing the descriptor or ending the process releases it."""
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
