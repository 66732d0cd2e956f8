"""Make a new journal of what a damaged one and the captures' own records still say."""

import hashlib
import io
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from acquisition.errors import SessionError
from acquisition.plan import plan_entries
from acquisition.regular_files import LARGEST_JOURNAL_BYTES, read_regular_file
from acquisition.session._capture_files import FoundCapture, found_capture, unknown_files
from acquisition.session._files import JOURNAL_NAME, MANIFEST_NAME, atomic_write, open_own
from acquisition.session._journal import (
    HEAD_NAME,
    NO_LINES,
    SYSTEM_STAMPS,
    ChainedLine,
    JournalEvent,
    JournalHead,
    Stamps,
    chain_after,
    lock_exclusively,
)
from acquisition.session._reader import Session
from acquisition.session._record import CaptureRecord, Manifest, utc_text


@dataclass(frozen=True, slots=True, kw_only=True)
class _LostLine:
    """A line that was not taken over; its text is empty if it is gone."""

    number: int
    text: str = ""


def _vouched_lines(data: bytes, counted: int) -> tuple[list[JournalEvent], list[_LostLine]]:
    """Take a damaged journal apart: events that can be vouched for, in order, and what is lost.

    A chained line is vouched for by its chain; where the line before it is gone, its text alone
    speaks. Lines that were moved come back to their places. Of lines without a chain, those that
    parse are taken over. ``counted`` is how many lines there were, as far as known.
    """
    unchained: list[JournalEvent] = []
    links = _Links()
    odd: list[tuple[int, bytes]] = []
    for place, line in enumerate(io.BytesIO(data).readlines(), start=1):
        link = ChainedLine.parse(line)
        event = None if link is not None or links.by_number else _event(line)
        if link is not None and link.number is not None:
            links.by_number.setdefault(link.number, []).append(link)
        elif event is not None:
            unchained.append(event)
            links.unchained_bytes += line
        else:
            odd.append((place, line))
    kept, seen = list(unchained), set(range(1, len(unchained) + 1))
    lost: dict[int, str] = {}
    for number in sorted(links.by_number):
        every = links.by_number[number]
        found = [link for link in every if links.is_vouched_for(link, number, len(unchained) + 1)]
        event = _event(found[0].text) if found else None
        if event is None:
            lost[number] = _text(every[0].text)
        else:
            kept.append(event)
            seen.add(number)
    for place, line in odd:
        free = place if place not in seen | lost.keys() else max([*seen, *lost]) + 1
        lost[free] = _text(line)
    for number in range(1, max([counted, *links.by_number, 0]) + 1):
        if number not in seen:
            lost.setdefault(number, "")
    return kept, [_LostLine(number=number, text=lost[number]) for number in sorted(lost)]


class _Links:
    """Chained lines by the number that they had when they were written."""

    def __init__(self) -> None:
        self.by_number: dict[int, list[ChainedLine]] = {}
        self.unchained_bytes = b""

    def is_vouched_for(self, link: ChainedLine, number: int, first: int) -> bool:
        """Whether a line, of which the first one has the number ``first``, is as it was written."""
        before = self._chains_before(number, first)
        if before is None:
            return True
        computed = {chain_after(chain, link.text) for chain in before}
        # Its own chain may be what was damaged: then the next line's fits the one computed.
        return link.chain in computed or any(
            chain_after(chain, after.text) == after.chain
            for chain in computed
            for after in self.by_number.get(number + 1, ())
        )

    def _chains_before(self, number: int, first: int) -> set[str] | None:
        """Chains that the line before may have had, stated and computed; None if it is gone."""
        if number == first:
            return {hashlib.sha256(self.unchained_bytes).hexdigest()}
        lines = self.by_number.get(number - 1)
        if lines is None:
            return None
        earlier = {line.chain for line in self.by_number.get(number - 2, ())}
        if number - 1 == first:
            earlier = {hashlib.sha256(self.unchained_bytes).hexdigest()}
        stated = {line.chain for line in lines}
        return stated | {chain_after(chain, line.text) for chain in earlier for line in lines}


def _text(line: bytes) -> str:
    return line.decode(errors="backslashreplace").rstrip("\n")


def _event(text: bytes) -> JournalEvent | None:
    try:
        return JournalEvent.from_line(text)
    except ValueError:
        return None


_TEXT_MAX = 2000
"""Characters of a lost line that are quoted."""

_QUOTED = 300
"""Those of them that a remark shows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RepairReport:
    """What became of a damaged journal.

    ``kept_as`` is None if it was sound. Captures were ``recovered`` from their files; those
    ``left_out`` are no captures of this session.
    """

    kept_as: Path | None = None
    lines: int = 0
    lost: tuple[_LostLine, ...] = ()
    recovered: tuple[FoundCapture, ...] = ()
    left_out: tuple[FoundCapture, ...] = ()

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was done, in sentences."""
        left_out = (
            f"{one.file} {one.refusal}; it was left out, and `standoff session set-aside` moves it "
            "away"
            for one in self.left_out
        )
        if self.kept_as is None:
            return ("the journal is sound; nothing was repaired", *left_out)
        lost = ((one.number, one.text[:_QUOTED] or "nothing is left of it") for one in self.lost)
        return (
            f"the journal was rebuilt with {self.lines} lines; the old one is {self.kept_as.name}",
            *(_brought_back(one) for one in self.recovered),
            *(f"line {number} is lost: {text}" for number, text in lost),
            *left_out,
        )

    @property
    def records(self) -> tuple[CaptureRecord, ...]:
        """Of the captures that were brought back."""
        return tuple(one.record for one in self.recovered if one.record is not None)

    def to_json(self) -> dict[str, Any]:
        """Return what was done as plain lists, numbers and text."""
        return {
            "kept_as": None if self.kept_as is None else str(self.kept_as),
            "lines": self.lines,
            "recovered": [record.index for record in self.records],
            "lost": [{"line": line.number, "text": line.text} for line in self.lost],
            "unknown_files": [one.file for one in self.left_out],
        }


def repair_session(path: Path, stamps: Stamps = SYSTEM_STAMPS) -> RepairReport:
    """Replace a damaged journal by what can be vouched for; the old one is kept.

    A line is taken over if its chain, or for an older journal its own text, vouches for it, a
    capture whose line is lost from its sealed file. Lost decisions are quoted in a note.
    """
    journal = path / JOURNAL_NAME
    manifest = _manifest(path / MANIFEST_NAME)
    with _locked(journal):
        is_sound = _is_sound(path)
        data = read_regular_file(journal, LARGEST_JOURNAL_BYTES)
        kept, lost = _vouched_lines(data, _head_lines(journal))
        recovered, left_out = _from_files(path, kept, manifest)
        if is_sound and not recovered:
            return RepairReport(left_out=tuple(left_out))
        records = [one.record for one in recovered if one.record is not None]
        events = _with_start(_in_order(kept, records), manifest, path / MANIFEST_NAME, stamps)
        events, orphans = _without_orphans(events)
        lost += orphans
        kept_as = journal.with_name(f"journal-damaged-{stamps.utc_now():%Y%m%dT%H%M%S}.jsonl")
        atomic_write(kept_as, data)
        facts = {
            "text": f"the journal was damaged and was repaired; the old one is {kept_as.name}",
            "lost": [{"line": one.number, "text": one.text[:_TEXT_MAX]} for one in lost],
            "recovered": [record.index for record in records],
            "unsealed": [one.file for one in recovered if not one.is_sealed],
        }
        note = JournalEvent(
            kind="note", utc=utc_text(stamps.utc_now()), uid=stamps.new_uid(), facts=facts
        )
        _replace(journal, [*events, note])
    return RepairReport(
        kept_as=kept_as,
        lines=len(kept) - len(orphans),
        lost=tuple(lost),
        recovered=tuple(recovered),
        left_out=tuple(left_out),
    )


def _brought_back(capture: FoundCapture) -> str:
    index = "" if capture.record is None else f" {capture.record.index}"
    if capture.is_sealed:
        return f"capture{index} was brought back from {capture.file}"
    return (
        f"capture{index} was brought back from {capture.file}, which an older version wrote "
        "without a seal: whether its pixels were altered cannot be told"
    )


def _manifest(path: Path) -> Manifest:
    try:
        return Manifest.from_bytes(read_regular_file(path), source=str(path))
    except OSError as error:
        raise SessionError(
            f"{path}: {error.strerror}; give the directory that a capture run wrote",
            fault="not a session",
            path=path.parent,
        ) from error


@contextmanager
def _locked(journal: Path) -> Iterator[None]:
    try:
        descriptor = open_own(journal, os.O_RDWR | os.O_CREAT)
    except OSError as error:
        raise SessionError(f"{journal}: {error.strerror}", path=journal) from error
    try:
        lock_exclusively(descriptor)
        yield
    except BlockingIOError as error:
        raise SessionError(
            f"session {journal.parent} is in use by another process; wait for it to end",
            fault="in use",
            path=journal.parent,
        ) from error
    finally:
        os.close(descriptor)


def _is_sound(path: Path) -> bool:
    try:
        session = Session(path)
    except SessionError:
        return False
    return session.is_begun and not session.is_journal_head_missing


def _head_lines(journal: Path) -> int:
    """Number of lines that the head counts; 0 where it does not say."""
    try:
        head = JournalHead.of_journal(journal)
    except ValueError:
        return 0
    return 0 if head is None else head.lines


def _from_files(
    path: Path, kept: Iterable[JournalEvent], manifest: Manifest
) -> tuple[list[FoundCapture], list[FoundCapture]]:
    """Captures in files that no line names, and the files that hold none."""
    captured = [event for event in kept if event.kind == "capture"]
    uids = {event.uid for event in captured}
    indices = {entry.index for entry in plan_entries(manifest.plan)}
    named = set().union(*(_files_named(event.facts.get("record")) for event in captured))
    found = [
        found_capture(path, file, indices=indices, known_uids=uids)
        for file in unknown_files(path, ())
        if file not in named and file.startswith("captures/")
    ]
    recovered = [one for one in found if one.record is not None]
    named |= {one.record.frames_file for one in recovered if one.record is not None}
    named |= {one.file for one in found}
    orphans = [file for file in unknown_files(path, ()) if file not in named]
    return recovered, [
        *(one for one in found if one.record is None),
        *(
            FoundCapture(file=file, refusal="belongs to no capture of this session")
            for file in orphans
        ),
    ]


def _files_named(record: object) -> set[object]:
    """Files of a capture by its line, which may be any text."""
    if not isinstance(record, dict):
        return set()
    names = (record.get("file"), record.get("frames_file"))
    return {name for name in names if isinstance(name, str)}


def _in_order(kept: list[JournalEvent], recovered: Iterable[CaptureRecord]) -> list[JournalEvent]:
    """The events with the recovered captures where they belong in time."""
    events = list(kept)
    for record in sorted(recovered, key=lambda record: record.finished_utc):
        event = JournalEvent(
            kind="capture",
            utc=record.finished_utc,
            uid=record.uid,
            facts={"record": record.to_json()},
        )
        later = (i for i, other in enumerate(events) if other.utc > record.finished_utc)
        events.insert(next(later, len(events)), event)
    return events


def _with_start(
    events: list[JournalEvent], manifest: Manifest, manifest_path: Path, stamps: Stamps
) -> list[JournalEvent]:
    if any(event.kind == "start" for event in events):
        return events
    digest = hashlib.sha256(manifest_path.read_bytes()).hexdigest()
    start = JournalEvent(
        kind="start",
        utc=manifest.created_utc,
        uid=stamps.new_uid(),
        facts={
            "operator": manifest.operator,
            "devices": manifest.devices,
            "session_sha256": digest,
        },
    )
    return [start, *events]


def _without_orphans(
    events: Iterable[JournalEvent],
) -> tuple[list[JournalEvent], list[_LostLine]]:
    """Leave out decisions about captures that are gone, and captures that come twice."""
    kept: list[JournalEvent] = []
    orphans: list[_LostLine] = []
    captured: set[str] = set()
    for number, event in enumerate(events, start=1):
        about = event.facts.get("supersedes" if event.kind == "retake" else "capture")
        is_decision = event.kind in ("retake", "exclude", "include", "height")
        if (is_decision and about not in captured) or event.uid in captured:
            orphans.append(_LostLine(number=number, text=event.to_text(number).decode()))
            continue
        if event.kind == "capture":
            captured.add(event.uid)
        kept.append(event)
    return kept, orphans


def _replace(journal: Path, events: Iterable[JournalEvent]) -> None:
    """Write journal and head anew; without a head in between, what is cut short says so."""
    journal.with_name(HEAD_NAME).unlink(missing_ok=True)
    lines, chain = [], NO_LINES
    for number, event in enumerate(events, start=1):
        text = event.to_text(number)
        chain = chain_after(chain, text)
        lines.append(ChainedLine(text=text, chain=chain).to_bytes())
    atomic_write(journal, b"".join(lines))
    head = JournalHead(lines=len(lines), chain=chain)
    atomic_write(journal.with_name(HEAD_NAME), head.to_bytes())
