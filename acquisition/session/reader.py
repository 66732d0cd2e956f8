"""Read a capture session: what was planned and captured, and whether the files are intact."""

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
from acquisition.session.capture_file import CaptureImages, parse_capture
from acquisition.session.journal_chain import JOURNAL_NAME as JOURNAL_NAME
from acquisition.session.journal_event import JournalEvent
from acquisition.session.journal_reading import read_journal_file
from acquisition.session.manifest import MANIFEST_NAME, Manifest
from acquisition.session.record import CaptureRecord

if TYPE_CHECKING:
    from pandas import DataFrame

_CHANGING = ("capture", "retake", "exclude", "include", "height")


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionCapture:
    """A journaled capture and the decisions about it since.

    It is superseded once it is to be retaken or its entry is captured again, and excluded for as
    long as ``excluded_because`` gives a reason. ``record`` has the corrected height, if there is
    one; ``uncorrected_height_mm`` is then the one that was recorded with the capture.
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
        """How much of its plan the session holds, and who made it when, as plain values."""
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
        """Return the summary, the captures, and whether they are used, the notes and remarks."""
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
        """Return the captures as a pandas table, a line each in order of time.

        Columns are those of the journal's records, and ``is_superseded``, ``excluded_because`` and
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
        """Its directory."""
        return self._path

    @property
    def manifest(self) -> Manifest:
        """What it was made with, as in session.json."""
        return self._manifest

    @property
    def events(self) -> tuple[JournalEvent, ...]:
        """The journal, in order of time."""
        return self._journal.events

    @property
    def is_begun(self) -> bool:
        """Whether the journal tells the start of a run; without one there are no captures."""
        return any(event.kind == "start" for event in self.events)

    @property
    def captures(self) -> tuple[SessionCapture, ...]:
        """Every journaled capture in order of time, marked superseded and excluded."""
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
        """The plan the session was made with."""
        return self.manifest.plan

    @property
    def bench(self) -> Mapping[str, Any]:
        """The resolved bench config, as a JSON object."""
        return self.manifest.bench

    @property
    def devices(self) -> Mapping[str, Mapping[str, Any]]:
        """Snapshots of ``camera`` and ``stage`` when the session was made."""
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
        """When the captures to use last changed, ISO 8601 in UTC; empty before the first one.

        A repair of the journal counts: decisions may have been lost, and captures came back.
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
            If the file is missing or not the one that was captured.
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
    """Replay a journal: its captures in order of time, with the decisions about them.

    Raises
    ------
    SessionError
        If an event names a capture that does not exist, or has no valid record or height.
    """
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
    """Return the capture of an entry that is not superseded, in the session at ``path``.

    Raises
    ------
    SessionError
        If there is none.
    """
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
