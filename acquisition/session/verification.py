"""Check that a session is what was captured: journal, plan, records and the bytes of every file."""

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from acquisition.errors import SessionError
from acquisition.plan import PlanEntry
from acquisition.regular_files import LARGEST_IMAGE_BYTES, read_regular_file
from acquisition.session.capture_file import has_record
from acquisition.session.capture_files import (
    FileState,
    file_state,
    files_of,
    found_files,
    unknown_files,
    unknown_files_text,
)
from acquisition.session.journal_chain import HEAD_NAME
from acquisition.session.manifest import MANIFEST_NAME
from acquisition.session.reader import JOURNAL_NAME, Session
from acquisition.session.record import CaptureRecord


@dataclass(frozen=True, slots=True, kw_only=True)
class FileCheck:
    """Check of one file of a session against the journal; ``uid`` is its capture's, if any."""

    file: str
    state: FileState
    uid: str | None = None
    is_superseded: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class VerifyReport:
    """Check of every file of a session against its journal.

    Parameters
    ----------
    files
        Every file that the journal names or that lies beside those.
    faults
        Sentences on what is at odds within the session, each naming the journal's line.
    remarks
        Sentences on what is odd but no fault.
    """

    files: tuple[FileCheck, ...]
    faults: tuple[str, ...]
    remarks: tuple[str, ...]

    @property
    def is_ok(self) -> bool:
        """Whether nothing is at odds, and every file is known, there and unchanged.

        What is missing or changed of a superseded capture does not count: nothing uses it.
        """
        return not self.faults and not any(
            check.state in ("missing", "changed") and not check.is_superseded
            for check in self.files
        )


def verify(path: Path) -> VerifyReport:
    """Hash every file of the session at ``path`` and compare with the journal.

    Raises
    ------
    SessionError
        If ``path`` is not a session, or its session.json or journal is damaged.
    """
    session = Session(path)
    checks, faults = [_check_manifest(session)], []
    unknown = unknown_files(path, (capture.record for capture in session.captures))
    if unknown and session.is_begun:
        faults.append(unknown_files_text(unknown))
    if session.is_journal_head_missing:
        faults.append(
            f"{HEAD_NAME} is missing, and lines may be, at the end of {JOURNAL_NAME}; restore it "
            "from a copy, or run the capture command again, which writes a new one"
        )
    entries = {entry.index: entry for entry in session.entries}
    journaled = {
        event.facts["record"]["uid"]: (number, event.facts["record"])
        for number, event in enumerate(session.events, start=1)
        if event.kind == "capture"
    }
    for capture in session.captures:
        record = capture.record
        number, document = journaled[record.uid]
        states, odd = _check_capture(path, record, document)
        checks += [
            FileCheck(file=file, state=state, uid=record.uid, is_superseded=capture.is_superseded)
            for file, state in states.items()
        ]
        faults += [
            f"{JOURNAL_NAME}, line {number}: capture {record.index} {one}"
            for one in (_differs_from_plan(record, entries.get(record.index)), odd)
            if one is not None
        ]
    if not session.is_begun:
        faults.append(
            f"{JOURNAL_NAME} holds no start of a run, yet there are captures; restore it from a "
            "copy, or see what `standoff verify --repair` can bring back"
            if unknown
            else f"{JOURNAL_NAME} holds no start of a run; restore it from a copy, or run the "
            "capture command again, which begins the session"
        )
    checks += [FileCheck(file=file, state="unjournaled") for file in unknown]
    known = {check.file for check in checks}
    leftovers = [file for file in found_files(path) if file not in known]
    checks += [FileCheck(file=file, state="unfinished") for file in leftovers]
    remarks = [
        f"{f} is left from a run that was killed while writing; delete it" for f in leftovers
    ]
    return VerifyReport(
        files=tuple(checks), faults=tuple(faults), remarks=(*session.remarks, *remarks)
    )


def _check_manifest(session: Session) -> FileCheck:
    starts = [event for event in session.events if event.kind == "start"]
    if not starts:
        return FileCheck(file=MANIFEST_NAME, state="unjournaled")
    expected = str(starts[0].facts.get("session_sha256"))
    return FileCheck(file=MANIFEST_NAME, state=file_state(session.path / MANIFEST_NAME, expected))


def _differs_from_plan(record: CaptureRecord, entry: PlanEntry | None) -> str | None:
    if entry is None:
        return "is none of the plan's"
    exposures = 1 if entry.bracket is None else entry.bracket.exposures
    taken = 1 if record.bracket is None else len(record.bracket)
    if taken != exposures:
        return f"has {taken} exposure(s); the plan asks for {exposures}"
    asked = (entry.kind, entry.target, entry.orientation_deg, entry.height_mm)
    made = (record.kind, record.target, record.orientation_deg, record.height_asked_mm)
    if made == asked:
        return None
    as_text = "{} {!r}, {:g} degrees, {:g} mm"
    return f"is of {as_text.format(*made)}; the plan asks for {as_text.format(*asked)}"


def _check_capture(
    path: Path, record: CaptureRecord, document: Mapping[str, Any]
) -> tuple[dict[str, FileState], str | None]:
    """State of each file of a capture, and what is odd about the record in it."""
    states: dict[str, FileState] = {}
    odd = None
    for file, sha256 in files_of(record):
        if file != record.file:
            states[file] = file_state(path / file, sha256)
            continue
        try:
            if not (path / file).is_file():
                states[file] = "missing"
                continue
            data = read_regular_file(path / file, LARGEST_IMAGE_BYTES)
        except OSError as error:
            raise SessionError(f"{path / file}: {error.strerror}", path=path / file) from error
        states[file] = "ok" if hashlib.sha256(data).hexdigest() == sha256 else "changed"
        if states[file] == "ok":
            odd = _differs_from_file(data, document, file)
    return states, odd


def _differs_from_file(data: bytes, document: Mapping[str, Any], file: str) -> str | None:
    try:
        return None if has_record(data, document, source=file) else f"has another record in {file}"
    except SessionError:
        return f"cannot be read from {file}, though its bytes are those that were journaled"
