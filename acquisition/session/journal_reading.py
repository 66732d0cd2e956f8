"""Read a journal as far as it is sound, and say what is not."""

import hashlib
import io
from dataclasses import dataclass
from pathlib import Path

from acquisition.errors import SessionError
from acquisition.regular_files import LARGEST_JOURNAL_BYTES, read_regular_file
from acquisition.session.journal_chain import (
    HEAD_NAME,
    LARGEST_LINE_BYTES,
    NO_LINES,
    ChainedLine,
    JournalHead,
    chain_after,
)
from acquisition.session.journal_event import CHAIN_KEYS, JournalEvent
from acquisition.untrusted import parse_json

REPAIR = "restore the file from a copy, or see what `standoff verify --repair` can bring back"


@dataclass(frozen=True, slots=True, kw_only=True)
class JournalReading:
    """The events of a journal.

    Parameters
    ----------
    events
        One a line.
    sound_bytes, torn_tail
        How much of the file holds them, and the rest.
    chain
        Of the last line; of the lines' bytes where they are not chained.
    unchained
        Number of lines, at the beginning, of a version that did not chain them.
    head
        What the file beside the journal says, if there is one.
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


def read_journal(
    data: bytes, *, head: JournalHead | None = None, source: str = "journal.jsonl"
) -> JournalReading:
    r"""Read a journal as far as it is sound.

    Every line was made durable before the next was begun, and the head only after it. A power cut
    can thus affect only a last line that the head does not count: if that is no event, it was cut
    short and is ignored, unless it is longer than any that is appended. No event's text is the
    beginning of another's, so a last line that parses is complete even without its ``\n``.
    Anything else is damage.

    Raises
    ------
    SessionError
        If a line is damaged or missing; the message names it.
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
    """Read a journal and its head.

    Raises
    ------
    SessionError
        If either cannot be read or is damaged.
    """
    try:
        # The head first: a line that is written meanwhile is then one that it does not count.
        head = JournalHead.of_journal(path)
    except ValueError as error:
        raise SessionError(
            f"{path.with_name(HEAD_NAME)}: damaged ({error}); {REPAIR}",
            fault="damaged",
            path=path.with_name(HEAD_NAME),
        ) from error
    try:
        data = read_regular_file(path, LARGEST_JOURNAL_BYTES)
    except OSError as error:
        raise SessionError(f"{path}: {error.strerror}; {REPAIR}", path=path) from error
    return read_journal(data, head=head, source=str(path))


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
        """Add a line.

        Raises
        ------
        ValueError
            If it is no event, or not the one that was written here.
        """
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
                raise ValueError(_why_at_odds(link, number))
            event, chain = JournalEvent.from_line(link.text), link.chain
        self.events.append(event)
        self.chains.append(chain)


def _unchained_event(line: bytes) -> JournalEvent:
    """An event of a version that did not chain; nothing but its own text vouches for it."""
    event = JournalEvent.from_line(line)
    keys = parse_json(line, has_single_keys=True).keys()
    if not keys.isdisjoint(CHAIN_KEYS):
        raise ValueError("its chain is damaged")
    return event


def _why_at_odds(link: ChainedLine, number: int) -> str:
    if link.number not in (None, number):
        return f"it was written as line {link.number}: lines were removed, added or moved"
    return "it was altered after it was written"


def _check_head(head: JournalHead, sound: _SoundLines, source: str) -> None:
    """Compare the end of a journal with its head."""
    count = len(sound.events)
    if head.lines > count:
        raise _damaged(source, count + 1, f"missing; {HEAD_NAME} counts {head.lines} lines")
    if sound.chains[head.lines] != head.chain:
        raise _damaged(source, head.lines, f"at odds with {HEAD_NAME}")


def _damaged(source: str, number: int, why: str) -> SessionError:
    return SessionError(
        f"{source}, line {number}: damaged ({why}); {REPAIR}", fault="damaged", line=number
    )
