"""What the pages about sessions show: their captures with images, and the pages of results."""

import re
from base64 import b64encode
from collections import Counter, OrderedDict
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from threading import Lock
from typing import Any, TypeVar
from urllib.parse import quote

import cv2
import numpy as np
from numpy.typing import NDArray
from starlette.responses import Response

from acquisition.errors import SessionError
from acquisition.regular_files import LARGEST_IMAGE_BYTES, read_regular_file
from acquisition.session import CaptureRecord, Session, SessionCapture
from acquisition.untrusted import read_tiff
from analysis.reports import views_script
from standoff.console.page_words import page_words
from standoff.console.results import results_of
from standoff.console.session_library import SessionLibrary, UnknownSessionError
from standoff.console.web._view_model import target_text

_SCRIPT_HASH = f"sha256-{b64encode(sha256(views_script().encode('utf-8')).digest()).decode()}"

REPORT_POLICY = (
    f"default-src 'none'; script-src '{_SCRIPT_HASH}'; style-src 'unsafe-inline'; img-src data:; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'; "
    "sandbox allow-scripts allow-popups"
)
"""One file that contains its styles and figures. Only that script runs which this version writes
into its reports, word for word, in an origin of its own that reaches nothing."""

_SCRIPTS = re.compile(rb"<script\b[^>]*>(.*?)</script", re.IGNORECASE | re.DOTALL)
_BODY = re.compile(rb"<body\b[^>]*>", re.IGNORECASE)

BLOCKED = (
    '<p role="alert" style="margin:0;padding:.7em 1em;background:#fff3cd;color:#3d2f00">'
    "<b>The script of this page does not run in the console</b>, as it is from another version of "
    "standoff: rows cannot be chosen, and before and after do not blink. To have both, compute the "
    "result again, or open the file itself.</p>"
)


def report_response(page: bytes) -> Response:
    """Answer with a page of results; one whose script does not run says so at its top."""
    return Response(
        _with_notice(page) if has_foreign_script(page) else page,
        media_type="text/html",
        headers={"Content-Security-Policy": REPORT_POLICY},
    )


def has_foreign_script(page: bytes) -> bool:
    """Whether a page has a script that the policy keeps from running."""
    own = views_script().encode("utf-8")
    # A browser reads line ends of either kind as one.
    return any(found.replace(b"\r\n", b"\n") != own for found in _SCRIPTS.findall(page))


def _with_notice(page: bytes) -> bytes:
    """Say at the top of a page that its script does not run."""
    body = _BODY.search(page)
    at = 0 if body is None else body.end()
    return page[:at] + BLOCKED.encode("utf-8") + page[at:]


T = TypeVar("T")

ROWS_A_PAGE = 200
LONGEST_TEXT = 500
NOTES_SHOWN = 200
SCENES_SHOWN = 200


def sessions_document(library: SessionLibrary, page: int = 1) -> dict[str, Any]:
    """One page of the sessions in a folder, the newest first."""
    summaries = library.summaries()
    return {
        "folder": library.folder,
        "summaries": _rows(summaries, page),
        "paging": _paging(len(summaries), page),
    }


def session_document(
    library: SessionLibrary, name: str, page: int = 1, *, has_curves: bool = False
) -> dict[str, Any]:
    """One page of a session's captures, its notes and results, rounded for reading.

    ``has_curves`` says whether there is a curve by which poses are judged.
    """
    session = library.read(name)
    captures = sorted(session.captures, key=lambda capture: capture.record.index)
    kept = {capture.record.index for capture in captures if not capture.is_superseded}
    return {
        "name": name,
        "has_curves": has_curves,
        "results": [asdict(each) for each in results_of(session, has_curves=has_curves)],
        "scenes": [
            {"index": r.index, "what": _at_height(_short(r.target), session.known_height_mm(r))}
            for r in session.records
            if r.kind not in ("flat", "dark")
        ][:SCENES_SHOWN],
        "pair": _pair(session.records),
        "others": [each.name for each in library.summaries() if each.name != name][:SCENES_SHOWN],
        "plan": session.plan.name,
        "operator": session.manifest.operator,
        "created": session.manifest.created_utc[:16].replace("T", " "),
        "captured": len(kept),
        "planned": len(session.entries),
        "is_complete": session.is_complete,
        "is_imported": not session.bench,
        "has_report": library.report_of(name) is not None,
        "remarks": [page_words(remark) for remark in session.remarks],
        "captures": [
            _capture(capture, f"/sessions/{quote(name)}", session.known_height_mm(capture.record))
            for capture in _rows(captures, page)
        ],
        "paging": _paging(len(captures), page),
        "notes": [
            {"when": event.utc[:16].replace("T", " "), "text": _note(event.facts)}
            for event in session.events
            if event.kind in ("note", "error", "stop", "skip")
        ][-NOTES_SHOWN:],
    }


def _rows(rows: Sequence[T], page: int) -> Sequence[T]:
    return rows[(page - 1) * ROWS_A_PAGE : page * ROWS_A_PAGE]


def _paging(rows: int, page: int) -> dict[str, int]:
    """Which rows a page shows, counted from 1, of how many on how many pages."""
    return {
        "page": page,
        "pages": max(1, -(-rows // ROWS_A_PAGE)),
        "first": (page - 1) * ROWS_A_PAGE + 1,
        "last": min(page * ROWS_A_PAGE, rows),
        "rows": rows,
    }


def _short(text: str) -> str:
    """As much of a text as a line of a table can hold; the files have all of it."""
    return text if len(text) <= LONGEST_TEXT else f"{text[:LONGEST_TEXT]} …"


def _at_height(what: str, height_mm: float | None) -> str:
    return what if height_mm is None else f"{what} at {height_mm:.1f} mm"


def _capture(capture: SessionCapture, address: str, height_mm: float | None) -> dict[str, Any]:
    record = capture.record
    shown = f"{address}/captures/{record.index}"
    query = f"?uid={record.uid}" if capture.is_superseded else ""
    return {
        "index": record.index,
        "address": f"{shown}{query}",
        "thumbnail": f"{shown}/thumbnail{query}",
        "what": _short(target_text(record.kind, record.target)),
        "orientation": f"{record.orientation_deg:g}",
        "height": "" if height_mm is None else f"{height_mm:.3f}",
        "exposure": "" if record.exposure_us is None else f"{record.exposure_us:g}",
        "frames": record.frames_used,
        "incomplete": record.incomplete_frames,
        "focus": "" if record.focus_value is None else f"{record.focus_value:.3g}",
        "state": _short(_state(capture)),
        "is_current": not capture.is_superseded,
        "is_used": capture.is_used,
        "is_excluded": not capture.is_superseded and capture.excluded_because is not None,
    }


def _pair(records: Sequence[CaptureRecord]) -> dict[str, int]:
    """Two captures that one would compare: of a scene, the nearest and the furthest.

    Where no scene was captured twice, as of imported photographs, each with a name of its own, the
    first and the last of all; of a single one, nothing to compare it with.
    """
    seen = [r for r in records if r.kind not in ("flat", "dark")]
    for scenes in ([r for r in seen if r.kind in ("texture", "chart")], seen):
        commonest = Counter(map(_scene, scenes)).most_common(1)
        series = [[r for r in scenes if _scene(r) == name] for name, _ in commonest]
        for same in (*series, scenes):
            if len(same) > 1:
                ordered = sorted(same, key=lambda r: r.height_mm)
                return {"reference": ordered[0].index, "followup": ordered[-1].index}
    return {"followup": seen[0].index} if seen else {}


def _scene(record: CaptureRecord) -> tuple[str, str]:
    return record.kind, record.target


def _note(facts: Mapping[str, Any]) -> str:
    index = facts.get("index")
    about = "" if index is None else f"capture {index}: "
    text = facts.get("text") or facts.get("message") or facts.get("error")
    return _short(f"{about}{page_words(text or 'stopped or skipped by the operator')}")


THUMBNAIL_PX = (128, 96)
THUMBNAILS_KEPT = 4000
JPEG_QUALITY = 75
FLAT_SHARE = 0.005
DARK_PERCENT, BRIGHT_PERCENT = 0.5, 99.8


def find_capture(session: Session, index: int, uid: str | None) -> SessionCapture:
    """Find the capture of an entry that counts, or the one with an identity."""
    for capture in session.captures:
        record = capture.record
        if record.index == index and (
            record.uid == uid if uid is not None else not capture.is_superseded
        ):
            return capture
    raise UnknownSessionError(f"{session.path.name} has no capture {index}")


def capture_document(
    library: SessionLibrary, name: str, index: int, uid: str | None
) -> dict[str, Any]:
    """Facts of one capture, its images, and its neighbours among those that count."""
    session = library.read(name)
    capture = find_capture(session, index, uid)
    record = capture.record
    indices = sorted(c.record.index for c in session.captures if not c.is_superseded)
    address = f"/sessions/{quote(name)}"
    return {
        "session": name,
        "index": index,
        "uid": record.uid,
        "address": f"{address}/captures/{index}",
        "previous": max((i for i in indices if i < index), default=None),
        "next": min((i for i in indices if i > index), default=None),
        "what": target_text(record.kind, record.target),
        "state": _state(capture),
        "is_excluded": not capture.is_superseded and capture.excluded_because is not None,
        "is_current": not capture.is_superseded,
        "images": _images(record),
        "frames": record.frames_used if record.frames_file is not None else 0,
        "max_level_dn": record.max_level_dn if record.bracket is None else None,
        "facts": _facts(record, session.known_height_mm(record)),
        "exposures": [
            {
                "exposure": f"{each.exposure_us:g}",
                "frames": each.frames_used,
                "mean": f"{each.mean_dn:.1f}",
                "saturated": each.saturated_pixels,
                "used": each.used_pixels,
                "ratio": "" if each.light_ratio is None else f"{each.light_ratio:.4f}",
            }
            for each in record.bracket or ()
        ],
    }


def capture_levels(
    session: Session, record: CaptureRecord, image: str
) -> NDArray[np.float32] | None:
    """Read one image of a capture, in DN, NaN where it is not valid; None if there is none.

    Images are ``mean``, ``noise`` (standard deviation of one frame), ``exposures`` (of a bracket,
    how many count), or the number of a raw frame, from 0 on.
    """
    if image.isascii() and image.isdigit() and len(image) < 6:
        file, number = record.frames_file, int(image)
        frames = [] if file is None else _pages(_own_path(session, file))
        return frames[number].astype(np.float32) if number < len(frames) else None
    if image not in [each["key"] for each in _images(record)]:
        return None
    _own_path(session, record.file)
    images = session.load(record)
    if image == "noise":
        assert images.variance_dn2 is not None
        return np.sqrt(np.maximum(images.variance_dn2, 0))
    if image == "exposures":
        assert images.exposures_used is not None
        return images.exposures_used
    if images.exposures_used is None:
        return images.mean_dn
    valid = np.where(images.exposures_used > 0, images.mean_dn, np.float32(np.nan))
    return valid.astype(np.float32)


class Thumbnails:
    """Small pictures of captures, each made once and kept as long as there is room."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._kept: OrderedDict[str, bytes] = OrderedDict()

    def of(self, session: Session, record: CaptureRecord) -> bytes:
        """Return a JPEG of the capture's mean, at most 128 x 96 pixels, stretched to be seen."""
        key = f"{record.uid} {record.sha256}"
        with self._lock:
            kept = self._kept.get(key)
        if kept is None:
            kept = _thumbnail(_own_path(session, record.file), record.max_level_dn)
            with self._lock:
                self._kept[key] = kept
                while len(self._kept) > THUMBNAILS_KEPT:
                    self._kept.popitem(last=False)
        return kept


def _thumbnail(path: Path, max_level_dn: float) -> bytes:
    levels = _pages(path, first_alone=True)[0].astype(np.float32)
    rows, cols = levels.shape
    scale = min(THUMBNAIL_PX[0] / cols, THUMBNAIL_PX[1] / rows, 1.0)
    size = (max(1, round(cols * scale)), max(1, round(rows * scale)))
    small = cv2.resize(levels, size, interpolation=cv2.INTER_AREA)
    low, high = np.percentile(small, (DARK_PERCENT, BRIGHT_PERCENT))
    if high - low < FLAT_SHARE * max_level_dn:  # nothing to see but how bright it is
        low, high = 0.0, max_level_dn
    shown = 255 * (small - low) / max(float(high - low), 1.0)
    _, data = cv2.imencode(
        ".jpg", np.clip(shown, 0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY]
    )
    return data.tobytes()


def _pages(path: Path, *, first_alone: bool = False) -> Sequence[NDArray[Any]]:
    try:
        data = read_regular_file(path, LARGEST_IMAGE_BYTES)
        return read_tiff(data, first_alone=first_alone).images
    except OSError as error:
        raise SessionError(
            f"{path}: {error.strerror}; restore it from a copy", path=path
        ) from error
    except ValueError as error:
        raise SessionError(f"{path}: not a readable TIFF file: {error}", path=path) from error


def _own_path(session: Session, file: str) -> Path:
    """Path of a session's file, which no link may lead elsewhere."""
    path = session.path
    for part in file.split("/"):
        path = path / part
        if path.is_symlink():
            raise SessionError(f"{path} is a link, which is not followed", path=path)
    return path


def _images(record: CaptureRecord) -> list[dict[str, str]]:
    images = [{"key": "mean", "label": "Mean"}]
    if record.frames_used > 1:
        images.append({"key": "noise", "label": "Noise"})
    if record.bracket is not None:
        images.append({"key": "exposures", "label": "Exposures used"})
    return images


def _state(capture: SessionCapture) -> str:
    if capture.is_superseded:
        return "superseded"
    if capture.excluded_because is not None:
        return f"excluded: {capture.excluded_because}"
    return "used"


def _facts(record: CaptureRecord, height_mm: float | None) -> list[tuple[str, str]]:
    """Names and values, rounded for reading."""
    facts = [
        ("orientation", f"{record.orientation_deg:g}°"),
        ("height", "not known" if height_mm is None else f"{height_mm:.3f} mm"),
        ("exposure", "" if record.exposure_us is None else f"{record.exposure_us:g} µs"),
        ("gain", "" if record.gain_db is None else f"{record.gain_db:g} dB"),
        ("frames", str(record.frames_used)),
        ("bad frames", str(record.incomplete_frames or "")),
        ("levels", f"{record.min_dn:g} to {record.max_dn:g} of {record.max_level_dn:g} DN"),
        ("saturated", f"{record.saturated_pixels} px"),
        ("black level", f"{record.black_level_dn:g} DN"),
        ("focus", "" if record.focus_value is None else f"{record.focus_value:.4g}"),
        ("captured", f"{record.started_utc[:19].replace('T', ' ')} UTC"),
        ("file", record.file),
    ]
    return [(name, value) for name, value in facts if value]
