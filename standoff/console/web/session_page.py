"""What the page of one session shows."""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from typing import Any, TypeVar
from urllib.parse import quote

from acquisition.session import CaptureRecord, SessionCapture
from standoff.console.page_words import page_words
from standoff.console.results import results_of
from standoff.console.session_library import SessionLibrary
from standoff.console.web.view_model import target_text

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

    Raises
    ------
    UnknownSessionError
        If there is no session with that name.
    SessionError
        If it cannot be read.
    """
    session = library.read(name)
    captures = sorted(session.captures, key=lambda capture: capture.record.index)
    kept = {capture.record.index for capture in captures if not capture.is_superseded}
    return {
        "name": name,
        "has_curves": has_curves,
        "results": [asdict(each) for each in results_of(session, has_curves=has_curves)],
        "scenes": [
            {"index": r.index, "what": f"{_short(r.target)} at {r.height_mm:.1f} mm"}
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
        "has_report": library.report_of(name) is not None,
        "remarks": [page_words(remark) for remark in session.remarks],
        "captures": [
            _capture(capture, f"/sessions/{quote(name)}") for capture in _rows(captures, page)
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


def _capture(capture: SessionCapture, address: str) -> dict[str, Any]:
    record = capture.record
    state = "used"
    if capture.is_superseded:
        state = "superseded"
    elif capture.excluded_because is not None:
        state = _short(f"excluded: {capture.excluded_because}")
    shown = f"{address}/captures/{record.index}"
    query = f"?uid={record.uid}" if capture.is_superseded else ""
    return {
        "index": record.index,
        "address": f"{shown}{query}",
        "thumbnail": f"{shown}/thumbnail{query}",
        "what": _short(target_text(record.kind, record.target)),
        "orientation": f"{record.orientation_deg:g}",
        "height": f"{record.height_mm:.3f}",
        "exposure": "" if record.exposure_us is None else f"{record.exposure_us:g}",
        "frames": record.frames_used,
        "incomplete": record.incomplete_frames,
        "focus": "" if record.focus_value is None else f"{record.focus_value:.3g}",
        "state": state,
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
