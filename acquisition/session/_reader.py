"""Read a capture session, and check every file's bytes against journal, plan and records."""

import hashlib
import math
from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from html import escape
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

from acquisition.dataframe import dataframe
from acquisition.errors import SessionError, SessionTypeError
from acquisition.plan import CapturePlan, PlanEntry, plan_entries
from acquisition.regular_files import (
    LARGEST_DOCUMENT_BYTES,
    LARGEST_IMAGE_BYTES,
    read_regular_file,
)
from acquisition.session._capture_files import (
    CaptureImages,
    FileState,
    file_state,
    files_of,
    found_files,
    has_record,
    parse_capture,
    unknown_files,
    unknown_files_text,
)
from acquisition.session._files import JOURNAL_NAME, MANIFEST_NAME
from acquisition.session._journal import HEAD_NAME, JournalEvent, read_journal_file
from acquisition.session._record import CaptureRecord, Manifest

if TYPE_CHECKING:
    from pandas import DataFrame


_CHANGING = ("capture", "retake", "exclude", "include", "height")


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionCapture:
    """A capture as recorded in the journal, with later decisions about it.

    It is superseded once a retake was asked for or its entry was captured again, and excluded as
    long as ``excluded_because`` gives a reason. If its height was corrected, ``record`` has the
    corrected height, and ``uncorrected_height_mm`` the height that was recorded with the capture.
    """

    record: CaptureRecord
    is_superseded: bool = False
    excluded_because: str | None = None
    uncorrected_height_mm: float | None = None

    @property
    def is_used(self) -> bool:
        """Whether calibration and analysis should use it."""
        return not self.is_superseded and self.excluded_because is None


class Session:
    """A capture session as recorded in its journal; reading changes nothing on disk.

    Opening reads session.json and the journal; capture files are read by `load` only.

    Parameters
    ----------
    path
        Directory of the session.

    Raises
    ------
    SessionError
        If it is not a session, or its session.json or journal is damaged.

    Examples
    --------
    >>> session = standoff.Session("session")
    >>> session.plan.name, len(session.records), session.is_complete
    ('edges and coins', 6, True)
    """

    def __init__(self, path: str | PathLike[str]) -> None:
        if not isinstance(path, str | PathLike):
            raise SessionTypeError(
                f"Session: expected the path of a session, got {type(path).__name__}"
            )
        self._path = Path(path)
        manifest_path = self._path / MANIFEST_NAME
        if not manifest_path.is_file():
            raise SessionError(
                f"{self._path} is not a capture session (it has no {MANIFEST_NAME}); "
                "give the directory that a capture run wrote",
                fault="not a session",
                path=self._path,
            )
        self._manifest = Manifest.from_bytes(
            _read(manifest_path, LARGEST_DOCUMENT_BYTES), source=str(manifest_path)
        )
        journal_path = self._path / JOURNAL_NAME
        self._journal = read_journal_file(journal_path)
        self._captures = captures_of(self._journal.events, source=str(journal_path))

    def __repr__(self) -> str:
        return f"Session({str(self._path)!r}: {self._kinds_text()})"

    def _repr_html_(self) -> str:
        rows = {
            "session": str(self._path),
            "plan": self.plan.name,
            "captures": self._kinds_text(),
            "complete": "yes" if self.is_complete else "no",
        }
        cells = (f"<tr><th>{key}</th><td>{escape(text)}</td></tr>" for key, text in rows.items())
        return f"<table>{''.join(cells)}</table>"

    @property
    def summary(self) -> dict[str, Any]:
        """Counts of captures, plan, operator and creation time of the session, as plain values."""
        current = [capture for capture in self.captures if not capture.is_superseded]
        return {
            "session": str(self._path),
            "plan": self.plan.name,
            "operator": self.manifest.operator,
            "created_utc": self.manifest.created_utc,
            "captured": len({capture.record.index for capture in current}),
            "planned": len(self.entries),
            "excluded": sum(capture.excluded_because is not None for capture in current),
        }

    def to_json(self) -> dict[str, Any]:
        """Return summary, captures with later decisions, notes and remarks as plain values."""
        return {
            **self.summary,
            "captures": [
                {
                    **capture.record.to_json(),
                    "superseded": capture.is_superseded,
                    "excluded_because": capture.excluded_because,
                    "uncorrected_height_mm": capture.uncorrected_height_mm,
                }
                for capture in sorted(self.captures, key=lambda capture: capture.record.index)
            ],
            "notes": [{"utc": e.utc, **e.facts} for e in self.events if e.kind == "note"],
            "remarks": list(self.remarks),
        }

    def to_dataframe(self) -> "DataFrame":
        """Return the captures as a pandas table, one row per capture, in order of time.

        Columns are those of `CaptureRecord`, and ``is_superseded``, ``excluded_because`` and
        ``uncorrected_height_mm``.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.

        Examples
        --------
        >>> table = standoff.Session("session").to_dataframe()
        >>> table[["target", "height_mm"]].tail(3).values.tolist()
        [['coins', 200.0], ['coins', 240.0], ['coins', 300.0]]
        """
        return dataframe(
            {
                **capture.record.to_json(),
                "is_superseded": capture.is_superseded,
                "excluded_because": capture.excluded_because,
                "uncorrected_height_mm": capture.uncorrected_height_mm,
            }
            for capture in self.captures
        )

    def _kinds_text(self) -> str:
        """Number of usable captures, by kind."""
        kinds = Counter(record.kind for record in self.records)
        by_kind = ", ".join(f"{count} {kind}" for kind, count in kinds.items())
        noun = "capture" if kinds.total() == 1 else "captures"
        return f"{kinds.total()} {noun}" + (f" ({by_kind})" if by_kind else "")

    @property
    def path(self) -> Path:
        """Directory of the session."""
        return self._path

    @property
    def manifest(self) -> Manifest:
        """Plan, bench, devices and software that the session was made with, as in session.json."""
        return self._manifest

    @property
    def events(self) -> tuple[JournalEvent, ...]:
        """Events of the journal, in order of time."""
        return self._journal.events

    @property
    def is_begun(self) -> bool:
        """Whether the journal records the start of a run; otherwise there are no captures."""
        return any(event.kind == "start" for event in self.events)

    @property
    def captures(self) -> tuple[SessionCapture, ...]:
        """Every capture in the journal in order of time, also superseded and excluded ones."""
        return self._captures

    @property
    def remarks(self) -> tuple[str, ...]:
        """Anything odd about the journal."""
        return self._journal.remarks

    @property
    def is_journal_head_missing(self) -> bool:
        """Whether the end of the journal may be missing without a trace."""
        return self._journal.is_head_missing

    @property
    def plan(self) -> CapturePlan:
        """The plan that the session was made with."""
        return self.manifest.plan

    @property
    def bench(self) -> Mapping[str, Any]:
        """The resolved bench config, as a JSON object."""
        return self.manifest.bench

    def known_height_mm(self, record: CaptureRecord) -> float | None:
        """Height of a capture in mm; None for the 0 of an imported photograph: not known."""
        is_known = bool(self.bench) or record.height_mm != 0
        return record.height_mm if is_known else None

    @property
    def devices(self) -> Mapping[str, Mapping[str, Any]]:
        """State of ``camera`` and ``stage`` when the session was made, as read from them."""
        return self.manifest.devices

    @property
    def entries(self) -> tuple[PlanEntry, ...]:
        """Every capture that the plan asks for."""
        return plan_entries(self.plan)

    @property
    def records(self) -> tuple[CaptureRecord, ...]:
        """The captures to use, in order of index: neither superseded nor excluded."""
        used = (capture.record for capture in self.captures if capture.is_used)
        return tuple(sorted(used, key=lambda record: record.index))

    @property
    def changed_utc(self) -> str:
        """Time of the last change to the captures to use, ISO 8601 in UTC; empty without captures.

        A repair of the journal counts as a change: decisions may have been lost, and captures
        recovered.
        """
        return max(
            (e.utc for e in self.events if e.kind in _CHANGING or "recovered" in e.facts),
            default="",
        )

    @property
    def is_complete(self) -> bool:
        """Whether every entry of the plan has a capture that was not superseded."""
        done = {c.record.index for c in self.captures if not c.is_superseded}
        return done.issuperset(entry.index for entry in self.entries)

    def load(self, record: CaptureRecord) -> CaptureImages:
        """Read the pixels of a capture, after checking its file against the journal.

        Raises
        ------
        SessionError
            If the file is missing or has changed since the capture.
        """
        path = self.path / record.file
        data = _read(path, LARGEST_IMAGE_BYTES)
        if hashlib.sha256(data).hexdigest() != record.sha256:
            raise SessionError(
                f"{path} is not the file that was captured (its sha256 differs); "
                "restore it from a copy, or retake the capture",
                fault="changed",
                path=path,
            )
        images = parse_capture(data, source=str(path))
        return replace(images, record=record)


def captures_of(events: Iterable[JournalEvent], *, source: str) -> tuple[SessionCapture, ...]:
    """Replay a journal: its captures in order of time, with the decisions about them."""
    records: dict[str, CaptureRecord] = {}
    superseded: set[str] = set()
    excluded: dict[str, str] = {}
    latest: dict[int, str] = {}
    uncorrected_mm: dict[str, float] = {}
    for number, event in enumerate(events, start=1):
        here = f"{source}, line {number}"
        if event.kind == "capture":
            record = _record(event, here, number)
            if record.uid in records:
                raise SessionError(
                    f"{here}: capture {record.index} is journaled twice",
                    fault="damaged",
                    line=number,
                )
            if record.index in latest:
                superseded.add(latest[record.index])
            latest[record.index] = record.uid
            records[record.uid] = record
        elif event.kind in ("retake", "exclude", "include", "height"):
            uid = str(event.facts.get("supersedes" if event.kind == "retake" else "capture"))
            if uid not in records:
                raise SessionError(
                    f"{here}: {event.kind} of {uid!r}, which was never captured",
                    fault="no capture",
                    line=number,
                )
            if event.kind == "retake":
                superseded.add(uid)
            elif event.kind == "exclude":
                excluded[uid] = str(event.facts.get("reason", ""))
            elif event.kind == "include":
                excluded.pop(uid, None)
            else:
                uncorrected_mm.setdefault(uid, records[uid].height_mm)
                records[uid] = replace(records[uid], height_mm=_height_mm(event, here, number))
    return tuple(
        SessionCapture(
            record=record,
            is_superseded=uid in superseded,
            excluded_because=excluded.get(uid),
            uncorrected_height_mm=uncorrected_mm.get(uid),
        )
        for uid, record in records.items()
    )


def current_capture(captures: Iterable[SessionCapture], index: int, path: Path) -> SessionCapture:
    """Return the capture of an entry that is not superseded, in the session at ``path``."""
    for capture in captures:
        if capture.record.index == index and not capture.is_superseded:
            return capture
    raise SessionError(
        f"session {path} has no capture with index {index}", fault="no capture", path=path
    )


def _record(event: JournalEvent, here: str, number: int) -> CaptureRecord:
    document = event.facts.get("record")
    if not isinstance(document, dict):
        raise SessionError(
            f"{here}: {event.kind} without a record", fault="damaged", line=number, keys=("record",)
        )
    try:
        return CaptureRecord.from_json(document, source=here)
    except SessionError as error:
        raise SessionError(str(error), fault="damaged", line=number, keys=error.keys) from error


def _height_mm(event: JournalEvent, here: str, number: int) -> float:
    height_mm = event.facts.get("height_mm")
    if not (isinstance(height_mm, float) and math.isfinite(height_mm)):
        raise SessionError(
            f"{here}: height_mm {height_mm!r} is not a height in mm",
            fault="damaged",
            line=number,
            keys=("height_mm",),
        )
    return height_mm


def _read(path: Path, most_bytes: int) -> bytes:
    try:
        return read_regular_file(path, most_bytes)
    except OSError as error:
        raise SessionError(
            f"{path}: {error.strerror}; restore it from a copy", path=path
        ) from error


@dataclass(frozen=True, slots=True, kw_only=True)
class _FileCheck:
    """Check of one file of a session against the journal; ``uid`` is its capture's, if any."""

    file: str
    state: FileState
    uid: str | None = None
    is_superseded: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class VerifyReport:
    """Check of every file of a session: ``faults``, and ``remarks`` on what is odd but none."""

    files: tuple[_FileCheck, ...]
    faults: tuple[str, ...]
    remarks: tuple[str, ...]

    @property
    def is_ok(self) -> bool:
        """Whether nothing is at odds, and every file that is in use is known and unchanged."""
        return not self.faults and not any(
            check.state in ("missing", "changed") and not check.is_superseded
            for check in self.files
        )


def verify(path: Path) -> VerifyReport:
    """Hash every file of the session at ``path`` and compare with the journal."""
    session = Session(path)
    checks, faults = [_check_manifest(session)], []
    unknown = unknown_files(path, (capture.record for capture in session.captures))
    if unknown and session.is_begun:
        faults.append(unknown_files_text(unknown))
    if session.is_journal_head_missing:
        faults.append(
            f"{HEAD_NAME} is missing, and lines at the end of {JOURNAL_NAME} may be missing, too; "
            "restore it from a copy, or run the capture command again, which writes a new one"
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
            _FileCheck(file=file, state=state, uid=record.uid, is_superseded=capture.is_superseded)
            for file, state in states.items()
        ]
        faults += [
            f"{JOURNAL_NAME}, line {number}: capture {record.index} {one}"
            for one in (_differs_from_plan(record, entries.get(record.index)), odd)
            if one is not None
        ]
    if not session.is_begun:
        faults.append(
            f"{JOURNAL_NAME} records no start of a run, yet there are captures; restore it from a "
            "copy, or see what `standoff verify --repair` can bring back"
            if unknown
            else f"{JOURNAL_NAME} records no start of a run; restore it from a copy, or run the "
            "capture command again, which begins the session"
        )
    checks += [_FileCheck(file=file, state="unjournaled") for file in unknown]
    known = {check.file for check in checks}
    leftovers = [file for file in found_files(path) if file not in known]
    checks += [_FileCheck(file=file, state="unfinished") for file in leftovers]
    remarks = [
        f"{f} is left from a run that was killed while writing; delete it" for f in leftovers
    ]
    return VerifyReport(
        files=tuple(checks), faults=tuple(faults), remarks=(*session.remarks, *remarks)
    )


def _check_manifest(session: Session) -> _FileCheck:
    starts = [event for event in session.events if event.kind == "start"]
    if not starts:
        return _FileCheck(file=MANIFEST_NAME, state="unjournaled")
    expected = str(starts[0].facts.get("session_sha256"))
    return _FileCheck(file=MANIFEST_NAME, state=file_state(session.path / MANIFEST_NAME, expected))


def _differs_from_plan(record: CaptureRecord, entry: PlanEntry | None) -> str | None:
    if entry is None:
        return "is not in the plan"
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
