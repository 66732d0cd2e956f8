"""Create or reopen a session and add captures, so that a kill at any byte loses nothing."""

import hashlib
import math
import os
import shutil
from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Self

import numpy as np

from acquisition.bench import BenchConfig
from acquisition.devices import FrameImage
from acquisition.errors import SessionError
from acquisition.plan import CapturePlan, PlanEntry, plan_entries
from acquisition.regular_files import read_regular_file
from acquisition.session._capture_files import (
    CaptureImages,
    KilledRun,
    capture_parts,
    capture_seal,
    frames_parts,
    is_intact,
    left_by_killed_run,
    set_aside,
    unknown_files,
    unknown_files_text,
)
from acquisition.session._files import (
    CAPTURE_FOLDERS,
    JOURNAL_NAME,
    MANIFEST_NAME,
    PART_SUFFIX,
    atomic_write,
    fsync_directory,
    write_new_hashed,
)
from acquisition.session._journal import (
    HEAD_NAME,
    SYSTEM_STAMPS,
    EventKind,
    JournalEvent,
    JournalReading,
    JournalWriter,
    Stamps,
)
from acquisition.session._reader import Session, SessionCapture, captures_of, current_capture
from acquisition.session._record import (
    CaptureRecord,
    Manifest,
    Photograph,
    Take,
    software_versions,
    utc_text,
)

SPARE_BYTES = 64 * 2**20
"""Disk space kept free beyond the captures, so that the journal can always be written."""


class SessionWriter:
    """The only process that writes a session; a context manager that releases it.

    Opening creates the session, or resumes one with the same plan, bench and devices; the journal's
    ``flock`` is held until ``close``. Photographs from elsewhere have no bench.
    """

    def __init__(
        self,
        path: Path,
        *,
        plan: CapturePlan,
        bench: BenchConfig | None,
        devices: Mapping[str, Mapping[str, Any]],
        operator: str,
        stamps: Stamps = SYSTEM_STAMPS,
    ) -> None:
        self.path = path
        self.plan = plan
        self.entries = plan_entries(plan)
        self._stamps = stamps
        _prepare_directory(path)
        self._takes: Counter[int] = Counter()
        self._killed = KilledRun()
        self._require_start(is_begun=_has_text(path / JOURNAL_NAME))
        self._journal = JournalWriter(path / JOURNAL_NAME, stamps, self._examine)
        try:
            self._begin({} if bench is None else bench.model_dump(mode="json"), devices, operator)
        except OSError as error:
            self.close()
            raise _write_failure(path, error) from error
        except BaseException:
            self.close()
            raise

    @property
    def captures(self) -> tuple[SessionCapture, ...]:
        """The captures journaled so far, marked superseded and excluded."""
        return captures_of(self._journal.events, source=str(self.path / JOURNAL_NAME))

    def pending_entries(self) -> tuple[PlanEntry, ...]:
        """Entries of the plan without a capture whose files all match the journal."""
        done = {
            capture.record.index
            for capture in self.captures
            if not capture.is_superseded and is_intact(self.path, capture.record)
        }
        return tuple(entry for entry in self.entries if entry.index not in done)

    def require_space(self, needed_bytes: int) -> None:
        """Raise if the disk has no space for ``needed_bytes`` and some to spare."""
        free_bytes = shutil.disk_usage(self.path).free
        if free_bytes < needed_bytes + SPARE_BYTES:
            raise SessionError(
                f"the disk of {self.path} has {free_bytes / 1e6:.0f} MB free, but the captures "
                f"need {needed_bytes / 1e6:.0f} MB, and {SPARE_BYTES / 1e6:.0f} MB must stay free; "
                "free some space and run again",
                fault="unwritable",
                path=self.path,
            )

    def journal(self, kind: EventKind, facts: Mapping[str, Any]) -> JournalEvent:
        """Journal an event other than a capture."""
        return self._journal.append(kind, facts)

    def retake(self, index: int, reason: str, operator: str) -> None:
        """Void the capture of an entry, so that it is pending again."""
        void = current_capture(self.captures, index, self.path).record.uid
        facts = {"index": index, "supersedes": void, "reason": reason, "operator": operator}
        self._journal.append("retake", facts)

    def add_capture(self, entry: PlanEntry, take: Take) -> CaptureRecord:
        """Store one capture; when this returns it is on the disk and journaled."""
        averaged, settings = take.averaged, take.settings
        record = CaptureRecord(
            **self._identity(entry),
            height_mm=take.height_mm,
            frames_used=averaged.frames_used,
            incomplete_frames=averaged.incomplete_frames,
            resent_packets=averaged.resent_packets,
            saturated_pixels=averaged.saturated_pixels,
            min_dn=averaged.min_dn,
            max_dn=averaged.max_dn,
            exposure_us=settings.exposure_us,
            gain_db=settings.gain_db,
            pixel_format=settings.pixel_format,
            black_level_dn=settings.black_level_dn,
            max_level_dn=settings.max_level_dn,
            started_utc=utc_text(take.started),
            finished_utc=utc_text(take.finished),
            first_timestamp_ns=averaged.first_timestamp_ns,
            last_timestamp_ns=averaged.last_timestamp_ns,
            focus_value=take.focus_value,
            scale_px_per_mm=take.scale_px_per_mm,
            frames_file=self._file(entry, "frames") if take.raw_frames else None,
            gain=settings.gain,
            gain_unit=settings.gain_unit,
            black_level=settings.black_level,
            black_level_unit=settings.black_level_unit,
            bracket=None if take.bracket is None else take.bracket.exposures,
        )
        images = CaptureImages(
            mean_dn=averaged.mean_dn,
            variance_dn2=averaged.variance_dn2,
            exposures_used=None if take.bracket is None else take.bracket.exposures_used,
            record=record,
        )
        return self._store(images, take.raw_frames)

    def add_photograph(self, entry: PlanEntry, photograph: Photograph) -> CaptureRecord:
        """Store a photograph as a capture of one frame, or of as many as it is the mean of."""
        image_dn = photograph.image_dn
        now = utc_text(self._stamps.utc_now())
        record = CaptureRecord(
            **self._identity(entry),
            height_mm=entry.height_mm,
            frames_used=photograph.frames,
            incomplete_frames=0,
            resent_packets=0,
            saturated_pixels=int(np.count_nonzero(image_dn >= photograph.max_level_dn)),
            min_dn=float(image_dn.min()),
            max_dn=float(image_dn.max()),
            exposure_us=photograph.exposure_us,
            gain_db=photograph.gain_db,
            pixel_format=photograph.pixel_format,
            black_level_dn=photograph.black_level_dn,
            max_level_dn=photograph.max_level_dn,
            started_utc=now,
            finished_utc=now,
            first_timestamp_ns=None,
            last_timestamp_ns=None,
            focus_value=None,
            scale_px_per_mm=photograph.scale_px_per_mm,
            frames_file=None,
        )
        images = CaptureImages(
            mean_dn=image_dn, variance_dn2=photograph.variance_dn2, record=record
        )
        return self._store(images, ())

    def close(self) -> None:
        """Release the session; closing twice is harmless."""
        self._journal.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _begin(
        self,
        bench: dict[str, Any],
        devices: Mapping[str, Mapping[str, Any]],
        operator: str,
    ) -> None:
        """Write session.json, or compare with an existing one, and journal the run."""
        path = self.path / MANIFEST_NAME
        reconnected: dict[str, str] = {}
        if path.exists():
            data = read_regular_file(path)
            old = Manifest.from_bytes(data, source=str(path))
            reconnected = old.reconnected(bench)
            differences = old.differences(self.plan, bench, devices)
            if differences:
                raise SessionError(
                    f"session {self.path} was made with other settings: "
                    f"{'; '.join(f'{key} {text}' for key, text in differences.items())}; "
                    "go back to those, or use a new directory",
                    fault="made otherwise",
                    path=self.path,
                    keys=tuple(differences),
                )
            self._require_start(
                is_begun=any(event.kind == "start" for event in self._journal.events)
            )
        else:
            if self._journal.events:
                raise SessionError(
                    f"{path} is missing but the journal is not empty; restore it",
                    fault="damaged",
                    path=path,
                )
            data = Manifest(
                uid=self._stamps.new_uid(),
                created_utc=utc_text(self._stamps.utc_now()),
                operator=operator,
                plan=self.plan,
                bench=bench,
                devices=devices,
                software=software_versions(),
            ).to_bytes()
            atomic_write(path, data)
        for folder in (*CAPTURE_FOLDERS, "logs"):
            _make_own_folder(self.path / folder)
        self._journal_what_a_kill_left()
        facts = {"operator": operator, "devices": devices, "software": software_versions()}
        if any(event.kind == "start" for event in self._journal.events):
            self._journal.append("resume", {**facts, "pending": len(self.pending_entries())})
            if reconnected:
                named = "; ".join(f"{key} {text}" for key, text in reconnected.items())
                self._journal.append("note", {"text": f"connected otherwise: {named}"})
        else:
            digest = hashlib.sha256(data).hexdigest()
            self._journal.append("start", {**facts, "session_sha256": digest})
            self._journal.append("plan", {"name": self.plan.name, "captures": len(self.entries)})
            fsync_directory(self.path)  # a run is known by the name of the journal's head

    def _examine(self, journal: JournalReading) -> None:
        """Refuse to go on where files lie that the journal ought to name, but after a kill."""
        source = str(self.path / JOURNAL_NAME)
        records = [capture.record for capture in captures_of(journal.events, source=source)]
        self._takes.update(record.index for record in records)
        unknown = unknown_files(self.path, records)
        killed = left_by_killed_run(
            self.path,
            unknown,
            [(self._file(one, "captures"), self._file(one, "frames")) for one in self.entries],
            {record.uid for record in records},
        )
        if killed is None or (unknown and journal.head is None):
            raise self._unknown(unknown)
        self._killed = killed

    def _unknown(self, files: Collection[str]) -> SessionError:
        return SessionError(
            f"session {self.path}: {unknown_files_text(files)}",
            fault="unknown files",
            path=self.path,
        )

    def _journal_what_a_kill_left(self) -> None:
        """Take in the capture that was whole when a run was killed, and put aside what was not."""
        capture, remains = self._killed.capture, self._killed.remains
        text = "the previous run was killed before it could journal a capture"
        if capture is not None and capture.record is not None:
            record = capture.record
            self._journal.append("capture", {"record": record.to_json()}, uid=record.uid)
            self._takes[record.index] += 1
            facts = {"text": f"{text}; {record.file} is taken in", "recovered": [record.index]}
            self._journal.append("note", facts)
        elif remains:
            moved = set_aside(self.path, remains)
            self._journal.append(
                "note", {"text": f"{text}; its remains are set aside", "set_aside": moved}
            )

    def _require_start(self, *, is_begun: bool) -> None:
        """Refuse to begin anew where captures lie: a run is journaled before the first of them."""
        if not is_begun and unknown_files(self.path, ()):
            raise SessionError(
                f"session {self.path} has captures, but its {JOURNAL_NAME} is empty or missing; "
                "restore it from a copy, or run `standoff verify --repair`",
                fault="damaged",
                path=self.path / JOURNAL_NAME,
            )

    def _identity(self, entry: PlanEntry) -> dict[str, Any]:
        """What a new record takes from its entry; its hashes are not known yet."""
        return {
            "index": entry.index,
            "uid": self._stamps.new_uid(),
            "kind": entry.kind,
            "target": entry.target,
            "orientation_deg": entry.orientation_deg,
            "height_asked_mm": entry.height_mm,
            "file": self._file(entry, "captures"),
            "frames_sha256": None,
            "sha256": None,
        }

    def _file(self, entry: PlanEntry, folder: str) -> str:
        """Return a file name that no journaled capture has: later takes are numbered."""
        takes = self._takes[entry.index]
        suffix = f"_take{takes + 1}" if takes else ""
        return f"{folder}/{entry.stem}{suffix}.tif"

    def _store(self, images: CaptureImages, raw_frames: Sequence[FrameImage]) -> CaptureRecord:
        record = images.record
        try:
            if record.frames_file is not None:
                path = self.path / record.frames_file
                digest = write_new_hashed(path, frames_parts(raw_frames))
                record = replace(record, frames_sha256=digest)
                images = replace(images, record=record)
            path = self.path / record.file
            digest = write_new_hashed(path, capture_parts(images), capture_seal)
        except FileExistsError as error:
            raise self._unknown([path.relative_to(self.path).as_posix()]) from error
        except OSError as error:
            raise _write_failure(self.path, error) from error
        record = replace(record, sha256=digest)
        self._journal.append("capture", {"record": record.to_json()}, uid=record.uid)
        self._takes[record.index] += 1
        return record


def _has_text(journal: Path) -> bool:
    """Whether there is more than an empty file, whatever it is; nothing is created."""
    return os.path.lexists(journal) and not (journal.is_file() and journal.stat().st_size == 0)


def _prepare_directory(path: Path) -> None:
    """Make the directory; refuse one that holds anything but a session or the start of one."""
    try:
        path.mkdir(parents=True, exist_ok=True)
        present = {file.name for file in path.iterdir()}
    except OSError as error:
        raise _write_failure(path, error) from error
    beginning = {JOURNAL_NAME, MANIFEST_NAME + PART_SUFFIX, HEAD_NAME, HEAD_NAME + PART_SUFFIX}
    if MANIFEST_NAME not in present and not present <= beginning:
        raise SessionError(
            f"{path} contains files but is not a capture session; give a new or empty directory",
            fault="not a session",
            path=path,
        )


def _make_own_folder(path: Path) -> None:
    if path.is_symlink():
        raise SessionError(
            f"{path} is a link, but a session is written only into folders of its own; replace the "
            "link by the folder itself",
            fault="unwritable",
            path=path,
        )
    path.mkdir(exist_ok=True)


def _write_failure(path: Path, error: OSError) -> SessionError:
    return SessionError(
        f"session {path} cannot be written: {error.strerror or error}; "
        "check the disk and run the same command again",
        fault="unwritable",
        path=path,
    )


class SessionNotes:
    """Journals the decisions of ``operator`` about a session, locked for each call."""

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
        """State another height of imported photographs; their captures keep what they recorded."""
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
        """Move unnamed files out of the folders of captures; return their names and hashes."""
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
