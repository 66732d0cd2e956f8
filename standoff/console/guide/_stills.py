"""Stills of the phone: each becomes a capture session with its pose, its verdict, its changes."""

import json
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass, replace
from datetime import UTC, datetime
from functools import partial
from math import pi, sqrt
from pathlib import Path
from queue import SimpleQueue
from threading import Event, Lock, Thread
from typing import Any, Literal

import cv2
import numpy as np
from pydantic import BaseModel, ConfigDict, TypeAdapter

from acquisition.errors import ImageFileError
from acquisition.files import make_results_folder, write_file
from acquisition.photographs import read_photograph
from acquisition.printable import on_one_line
from acquisition.regular_files import read_regular_file
from acquisition.untrusted import parse_json
from analysis.changes import Change, ChangeSummary, describe_focus, describe_limit
from analysis.pose import PoseFollower, RadialTerm, Verdict, straightened
from analysis.reports import compared_pictures
from standoff.console.guide._assessment import Assessment, Judge
from standoff.console.guide._reference import UprightView, upright
from standoff.console.photographs import MOST_PX, Uploads, jpeg_size, without_location
from standoff.errors import REPORTED_ERRORS
from standoff.library import (
    add_note,
    camera_noise,
    find_changes,
    import_photographs,
    opened_psf,
)

INCOMING = "incoming"
OPERATOR = "guide"
PHOTOGRAPH_NAME, DOCUMENT_NAME, CHANGES_FOLDER = "photograph.jpg", "guide.json", "changes"
PICTURES = ("before.jpg", "after.jpg")

_ONE_COMPARISON = Lock()
"""Of two at a time, for two references, each takes twice as long and both take their memory."""

_SCHEMA = "standoff.guide/1"
_KEPT = "The computer keeps the photograph; the next run of the guide tries again."
_MOST_LISTED = 100
_MOST_DOCUMENT_BYTES = 1 << 20
_SOFTER_PX2 = 1.0
_COMPARED_SHARE = 0.7
State = Literal["waiting", "comparing", "done", "failed"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparisonInputs:
    """Files that describe the camera of both photographs; None where it is not known."""

    psf: Path | None = None
    noise: Path | None = None

    def check(self) -> None:
        """Read both, so that a bad file is named before a phone is asked for anything."""
        if self.psf is not None:
            opened_psf(self.psf)
        camera_noise(self.noise)


@dataclass(frozen=True, slots=True, kw_only=True)
class StillRecord:
    """What is known of one still; ``guide.json`` of its session keeps it.

    Parameters
    ----------
    name
        Of its session.
    reference
        Name of the file of its reference.
    sha256
        Of the file as the phone sent it.
    state
        How far it is.
    words
        What happens, or why it failed, in a sentence.
    pose
        The assessment of its pose; None until it is known.
    changes
        Its changes, the most conspicuous first: where, in shares of the picture, and how much.
    better
        What would make another take better; empty if nothing would.
    """

    name: str
    reference: str
    sha256: str
    state: State = "waiting"
    words: str = ""
    pose: dict[str, Any] | None = None
    changes: tuple[dict[str, Any], ...] = ()
    better: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the record for the page and for its file."""
        return {"schema": _SCHEMA, **asdict(self)}


class _StoredPose(BaseModel):
    """What the pages need of a pose."""

    model_config = ConfigDict(strict=True)

    verdict: Verdict
    words: str


class _StoredChange(BaseModel):
    """What the page needs of a change."""

    model_config = ConfigDict(strict=True)

    x: float
    y: float
    radius: float
    area_px: float
    amplitude_dn: float
    delta_e: float | None = None
    what: str
    side: Literal["brighter", "darker"]


_RECORD = TypeAdapter(StillRecord)


class StillStore:
    """Takes stills one by one into sessions, and compares each with the reference.

    Work is done in a thread of its own, between ``start`` and ``close``; what had arrived in an
    earlier run is taken first, without its location, as nobody knows any more what was asked for.
    A still that cannot be stored stays where it arrived, for the next run: in ``incoming``, which
    is in the same folder by default. ``inputs`` are asked for at each comparison.
    """

    def __init__(
        self,
        folder: Path,
        judge: Judge,
        inputs: Callable[[], ComparisonInputs] = ComparisonInputs,
        incoming: Path | None = None,
    ) -> None:
        self.folder = folder
        self._incoming = folder / INCOMING if incoming is None else incoming
        self.uploads = Uploads(self._incoming)
        self._judge = judge
        self._inputs = inputs
        self._follower = PoseFollower(judge.reference.levels)
        self._records = {
            record.name: record
            for record in _stored(folder)
            if record.reference == judge.reference.name
        }
        self._judges: dict[str, Judge] = {}
        self._lock = Lock()
        self._taking = Lock()
        self._ended = Event()
        self._queue: SimpleQueue[tuple[StillRecord, Callable[[], object]] | None] = SimpleQueue()
        self._thread = Thread(target=self._run, name="stills", daemon=True)

    def start(self) -> None:
        """Begin to work."""
        for record in self.records():
            if record.state == "comparing":  # the earlier run ended
                self._queue.put((record, partial(self._finish, record)))
        for path in self.uploads.whole():
            if self._is_stored(path.name):  # just before the earlier run ended
                self.uploads.discard(path)
                continue
            with suppress(ImageFileError):  # gone then
                self.take(path, is_location_removed=True)
        self._thread.start()

    def close(self) -> None:
        """Begin no other still; the next run takes up those that wait, and the one at work.

        Its thread is not waited for, which may compare for minutes: it ends with the process.
        """
        self._ended.set()
        self._queue.put(None)

    def records(self) -> list[StillRecord]:
        """Return what is known of each still, the newest first."""
        with self._lock:
            return [self._records[name] for name in sorted(self._records, reverse=True)]

    def record_of(self, sha256: str) -> StillRecord | None:
        """Return the still that was sent with this hash, if the computer has it.

        One that was refused is not there any more: it may be sent again.
        """
        found = next((one for one in self.records() if one.sha256 == sha256), None)
        if found is None or found.state != "failed":
            return found
        is_kept = self._is_stored(sha256) or (self._incoming / sha256).is_file()
        return found if is_kept else None

    def take(
        self, path: Path, *, is_location_removed: bool, judge: Judge | None = None
    ) -> StillRecord:
        """Queue a still that has arrived whole, under its hash as its name; each one once.

        ``judge`` knows the phone that took it; without one it is judged by what is known of all.

        Raises
        ------
        ImageFileError
            If it is no photograph that can be worked on; its file is gone then.
        """
        with self._taking:
            known = self.record_of(path.name)
            if known is not None:
                return known
            try:
                _require_still(read_regular_file(path))
            except ImageFileError:
                self.uploads.discard(path)
                raise
            record = replace(self._begun(path), words="The photograph has arrived.")
            self._publish(record)
            if judge is not None:
                self._judges[path.name] = judge
        work = partial(self.process, path, is_location_removed=is_location_removed)
        self._queue.put((record, work))
        return record

    def picture(self, name: str, which: str) -> bytes | None:
        """Return ``before.jpg`` or ``after.jpg`` of a still; None if there is none."""
        with self._lock:
            is_known = name in self._records
        path = self.folder / name / "results" / which
        if not is_known or which not in PICTURES or not path.is_file():
            return None
        return read_regular_file(path)

    def _run(self) -> None:
        while (item := self._queue.get()) is not None and not self._ended.is_set():
            record, work = item
            try:
                work()
            except Exception as error:  # noqa: BLE001 - decoders and fits: the next still goes on
                what = on_one_line(f"{type(error).__name__}: {error}")
                self._failed(self._newest(record), f"{what}. {_KEPT}")

    def _newest(self, record: StillRecord) -> StillRecord:
        with self._lock:
            return self._records.get(record.name, record)

    def _is_stored(self, sha256: str) -> bool:
        """Whether a session has the photograph."""
        return any(
            (self.folder / one.name / "results" / PHOTOGRAPH_NAME).is_file()
            for one in self.records()
            if one.sha256 == sha256
        )

    def process(self, path: Path, *, is_location_removed: bool) -> StillRecord:
        """Store, judge and compare one still; what goes wrong is in its record."""
        record = self._begun(path)
        try:
            self._store(path, record, is_location_removed=is_location_removed)
            record = replace(record, state="comparing", words="The photograph is stored.")
            self._write(record)
        except ImageFileError as error:  # it is no photograph, and will be none
            self.uploads.discard(path)
            return self._failed(record, on_one_line(str(error)))
        except (*REPORTED_ERRORS, OSError) as error:
            return self._failed(record, f"{on_one_line(str(error))}. {_KEPT}")
        self.uploads.discard(path)
        return self._finish(record)

    def _failed(self, record: StillRecord, words: str) -> StillRecord:
        record = replace(record, state="failed", words=words)
        self._publish(record)
        return record

    def _finish(self, record: StillRecord) -> StillRecord:
        """Judge and compare a still that is stored."""
        session = self.folder / record.name
        try:
            if record.pose is None:
                record = self._posed(session, record)
            record = self._compared(session, record)
        except (*REPORTED_ERRORS, OSError) as error:
            said = on_one_line(str(error)).replace(f"{session}/", "")
            record = replace(record, state="failed", words=f"No changes: {said}")
        self._publish(record)
        self._write(record)
        return record

    def _store(self, path: Path, record: StillRecord, *, is_location_removed: bool) -> None:
        """Import the still into a session; its file, with Exif, lies in the session's results."""
        self._publish(replace(record, words="The photograph is stored."))
        data = read_regular_file(path)
        _require_still(data)
        if is_location_removed:
            data = without_location(data)
        session = self.folder / record.name
        staged = path.with_name(f"{record.name}.jpg")
        staged.write_bytes(data)
        try:
            import_photographs([staged], session, kind="texture", height_mm=0, operator=OPERATOR)
        finally:
            staged.unlink()
        write_file(make_results_folder(session) / PHOTOGRAPH_NAME, data)
        removed = ", its location removed" if is_location_removed else ""
        add_note(
            session,
            f"sent by a phone as SHA-256 {record.sha256}, kept as results/{PHOTOGRAPH_NAME}"
            f"{removed}; follow-up of {self._judge.reference.name}",
            operator=OPERATOR,
        )

    def _posed(self, session: Path, record: StillRecord) -> StillRecord:
        """Judge the pose, which takes a second."""
        photograph = read_photograph(session / "results" / PHOTOGRAPH_NAME)
        judge = self._judges.pop(record.sha256, self._judge)
        assessed = self._assessed(UprightView.of(photograph), judge)
        if assessed.deviation is None:
            words = "It does not show the scene of the reference, or too little of it."
        else:
            words = "The pose is judged; changes are being looked for, which takes a minute or two."
        record = replace(
            record,
            state="comparing",
            words=words,
            pose=assessed.to_json(),
            better=(assessed.remedy,) if assessed.remedy else (),
        )
        said = f"pose: {assessed.verdict}; {assessed.words}"
        add_note(session, on_one_line(said), operator=OPERATOR)
        self._publish(record)
        self._write(record)
        return record

    def _assessed(self, view: UprightView, judge: Judge) -> Assessment:
        self._follower.reset()
        found = self._follower.update(view.levels)
        if found.pose is None:
            return judge.lost()
        rows, cols = view.levels.shape
        lens = RadialTerm()
        lens.add(found.pose, (rows, cols))
        matrix = lens.without(found.pose, (rows, cols))
        levels = straightened(view.levels, lens.k1)
        return judge.judged(levels, matrix, full_size=view.size, level=view.level)

    def _compared(self, session: Path, record: StillRecord) -> StillRecord:
        """Look for changes, and write them into the session."""
        results = session / "results"
        with _ONE_COMPARISON:
            inputs = self._inputs()
            found = find_changes(
                self._judge.reference.path,
                results / PHOTOGRAPH_NAME,
                inputs.psf,
                noise=inputs.noise,
            )
        found.write(results / CHANGES_FOLDER)
        pictures = compared_pictures(found.reference.grey_dn, found, found.left_out, found.colours)
        orientation = found.followup.facts.orientation
        for name, data in zip(PICTURES, (pictures.before, pictures.after), strict=True):
            write_file(results / name, _turned_jpeg(data, orientation))
        summary = found.summary
        rows, cols = found.valid.shape
        listed = [
            _listed(change, (cols, rows), orientation) for change in summary.changes[:_MOST_LISTED]
        ]
        count = len(summary.changes)
        what = "No change was found" if not count else f"{count} change{'s' * (count > 1)} found"
        limit = describe_limit(summary)
        return replace(
            record,
            state="done",
            words=f"{what}; {limit}." if limit else f"{what}.",
            changes=tuple(listed),
            better=(*record.better, *_better(summary)),
        )

    def _begun(self, path: Path) -> StillRecord:
        """A still that arrived as this file, named by its hash: when, and the hash's beginning."""
        arrived = datetime.fromtimestamp(path.stat().st_mtime, UTC)
        return StillRecord(
            name=f"{arrived:%Y%m%d-%H%M%S}-{path.name[:8]}",
            reference=self._judge.reference.name,
            sha256=path.name,
        )

    def _publish(self, record: StillRecord) -> None:
        with self._lock:
            self._records[record.name] = record

    def _write(self, record: StillRecord) -> None:
        data = json.dumps(record.to_json(), indent=1, ensure_ascii=False).encode()
        write_file(self.folder / record.name / "results" / DOCUMENT_NAME, data)


def _require_still(data: bytes) -> None:
    """Refuse what is no JPEG file of a size that can be worked on, before a pixel is decoded."""
    width, height = jpeg_size(data)
    if width * height > MOST_PX:
        raise ImageFileError(
            f"the photograph has {width} x {height} px; at most {MOST_PX / 1e6:.0f} million are "
            "compared: choose a lower resolution in the phone's camera"
        )


def _turned_jpeg(data: bytes, orientation: int | None) -> bytes:
    """A picture turned as the photograph is viewed."""
    if (orientation or 1) == 1:
        return data
    stored = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR)
    assert stored is not None  # drawn here
    options = [cv2.IMWRITE_JPEG_QUALITY, 90]
    turned = np.asarray(upright(stored, orientation), np.uint8)
    return cv2.imencode(".jpg", turned, options)[1].tobytes()


def _listed(change: Change, size: tuple[int, int], orientation: int | None) -> dict[str, Any]:
    """One change for the page: its place and size in shares of the picture as it is viewed."""
    width, height = size
    x, y = (change.x_px + 0.5) / width, (change.y_px + 0.5) / height
    if (orientation or 1) >= 5:
        x, y, width, height = y, x, height, width
    if orientation in (2, 3, 6, 7):
        x = 1 - x
    if orientation in (3, 4, 7, 8):
        y = 1 - y
    return {
        "x": x,
        "y": y,
        "radius": max(1.7 * sqrt(change.area_px / pi) / width, 0.02),
        "area_px": change.area_px,
        "amplitude_dn": change.amplitude_dn,
        "delta_e": change.delta_e,
        "significance": change.significance,
        "what": change.what,
        "side": "brighter" if change.amplitude_dn > 0 else "darker",
    }


def _better(summary: ChangeSummary) -> list[str]:
    """What would let another take find more."""
    said = []
    if summary.extra_blur_px2 > _SOFTER_PX2 and summary.extra_blur_err_px2 < _SOFTER_PX2:
        said.append(f"Focus again and hold still: {describe_focus(summary)}.")
    if summary.frame_px and summary.compared_px < _COMPARED_SHARE * summary.frame_px:
        share = 100 * summary.compared_px / summary.frame_px
        said.append(
            f"Only {share:.0f} % of the photograph could be compared: show the same part of the "
            "scene, without reflections."
        )
    return said


def _stored(folder: Path) -> list[StillRecord]:
    """Stills of earlier runs; a document that is damaged is passed over."""
    found = []
    for path in sorted(folder.glob(f"*/results/{DOCUMENT_NAME}")):
        try:
            document = parse_json(read_regular_file(path, _MOST_DOCUMENT_BYTES))
            if not isinstance(document, dict) or document.get("schema") != _SCHEMA:
                continue
            record = _RECORD.validate_python(document | {"name": path.parent.parent.name})
            if record.pose is not None:
                _StoredPose.model_validate(record.pose)
            for change in record.changes:
                _StoredChange.model_validate(change)
        except (OSError, ValueError):
            continue
        found.append(record)
    return found
