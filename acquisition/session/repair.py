"""Make a new journal of what a damaged one and the captures' own records still say."""

import hashlib
import os
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from acquisition.errors import SessionError
from acquisition.plan import plan_entries
from acquisition.regular_files import LARGEST_JOURNAL_BYTES, read_regular_file
from acquisition.session.capture_file import read_capture
from acquisition.session.capture_files import file_sha256
from acquisition.session.durable_write import atomic_write, open_own
from acquisition.session.journal import SYSTEM_STAMPS, Stamps, lock_exclusively
from acquisition.session.journal_chain import (
    HEAD_NAME,
    NO_LINES,
    ChainedLine,
    JournalHead,
    chain_after,
)
from acquisition.session.journal_event import JournalEvent
from acquisition.session.manifest import MANIFEST_NAME, Manifest
from acquisition.session.reader import JOURNAL_NAME, Session
from acquisition.session.record import CaptureRecord, utc_text
from acquisition.session.vouched_lines import LostLine, vouched_lines

_TEXT_MAX = 2000
"""Characters of a lost line that are quoted."""

_QUOTED = 300
"""Those of them that a remark shows."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RepairReport:
    """What became of a damaged journal.

    Parameters
    ----------
    kept_as
        Where the old journal is; None if it was sound and nothing was done.
    lines
        Number of lines that were taken over.
    lost
        Lines that were not.
    recovered
        Captures that were brought back from their files.
    unknown_files
        Capture files that no line names and that hold no record of this session's plan.
    """

    kept_as: Path | None = None
    lines: int = 0
    lost: tuple[LostLine, ...] = ()
    recovered: tuple[CaptureRecord, ...] = ()
    unknown_files: tuple[str, ...] = ()

    @property
    def remarks(self) -> tuple[str, ...]:
        """What was done, in sentences."""
        if self.kept_as is None:
            return ("the journal is sound; nothing was repaired",)
        lost = ((one.number, one.text[:_QUOTED] or "nothing is left of it") for one in self.lost)
        return (
            f"the journal was made anew of {self.lines} lines; the old one is {self.kept_as.name}",
            *(f"capture {one.index} was brought back from {one.file}" for one in self.recovered),
            *(f"line {number} is lost: {text}" for number, text in lost),
            *(f"{file} is not a capture of this session and was left out"
              for file in self.unknown_files),
        )  # fmt: skip

    def to_json(self) -> dict[str, Any]:
        """Return what was done as plain lists, numbers and text."""
        return {
            "kept_as": None if self.kept_as is None else str(self.kept_as),
            "lines": self.lines,
            "recovered": [record.index for record in self.recovered],
            "lost": [{"line": line.number, "text": line.text} for line in self.lost],
            "unknown_files": list(self.unknown_files),
        }


def repair_session(path: Path, stamps: Stamps = SYSTEM_STAMPS) -> RepairReport:
    """Replace a damaged journal by what can be vouched for; the old one is kept.

    A line is taken over if its chain, or for an older journal its own text, vouches for it. A
    capture whose line is lost is brought back from the record in its file, with the hash that the
    file has now. Lost decisions, such as an exclusion, are quoted in a note.

    Raises
    ------
    SessionError
        If ``path`` is not a session, is in use, or its session.json is damaged.
    """
    journal = path / JOURNAL_NAME
    manifest = _manifest(path / MANIFEST_NAME)
    with _locked(journal):
        if _is_sound(path):
            return RepairReport()
        data = read_regular_file(journal, LARGEST_JOURNAL_BYTES)
        kept, lost = vouched_lines(data, _head_lines(journal))
        recovered, unknown = _from_files(path, kept, manifest)
        events = _with_start(_in_order(kept, recovered), manifest, path / MANIFEST_NAME, stamps)
        events, orphans = _without_orphans(events)
        lost += orphans
        kept_as = journal.with_name(f"journal-damaged-{stamps.utc_now():%Y%m%dT%H%M%S}.jsonl")
        atomic_write(kept_as, data)
        facts = {
            "text": f"the journal was damaged and was repaired; the old one is {kept_as.name}",
            "lost": [{"line": one.number, "text": one.text[:_TEXT_MAX]} for one in lost],
            "recovered": [record.index for record in recovered],
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
        unknown_files=tuple(unknown),
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
) -> tuple[list[CaptureRecord], list[str]]:
    """Records of capture files that no line names, and files that have none."""
    known = {event.uid for event in kept if event.kind == "capture"}
    indices = {entry.index for entry in plan_entries(manifest.plan)}
    recovered, unknown = [], []
    for file in sorted((path / "captures").glob("*.tif")):
        name = file.relative_to(path).as_posix()
        try:
            record = read_capture(file).record
        except SessionError:
            unknown.append(name)
            continue
        if record.uid in known:
            continue
        if record.file == name and record.index in indices:
            recovered.append(replace(record, sha256=file_sha256(file)))
        else:
            unknown.append(name)
    return recovered, unknown


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
) -> tuple[list[JournalEvent], list[LostLine]]:
    """Leave out decisions about captures that are gone, and captures that come twice."""
    kept: list[JournalEvent] = []
    orphans: list[LostLine] = []
    captured: set[str] = set()
    for number, event in enumerate(events, start=1):
        about = event.facts.get("supersedes" if event.kind == "retake" else "capture")
        is_decision = event.kind in ("retake", "exclude", "include", "height")
        if (is_decision and about not in captured) or event.uid in captured:
            orphans.append(LostLine(number=number, text=event.to_text(number).decode()))
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
