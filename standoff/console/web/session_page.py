"""What the page of one session shows."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from shlex import quote
from typing import Any, TypeVar

from acquisition.session import Session, SessionCapture
from acquisition.untrusted import parse_json
from calibration.sharpness import NORMAL_95
from standoff.console.session_library import SessionLibrary
from standoff.workflows import RESULTS_FOLDER

T = TypeVar("T")

MAX_RESULT_BYTES = 50 * 10**6
ROWS_A_PAGE = 200
LONGEST_TEXT = 500
PSF_FIGURES = (("sigma_x_px", "σx"), ("sigma_y_px", "σy"), ("rho", "ρ"))
NOTES_SHOWN = 200


def sessions_document(library: SessionLibrary, page: int = 1) -> dict[str, Any]:
    """One page of the sessions in a folder, the newest first."""
    summaries = library.summaries()
    return {
        "folder": library.folder,
        "summaries": _rows(summaries, page),
        "paging": _paging(len(summaries), page),
    }


def session_document(library: SessionLibrary, name: str, page: int = 1) -> dict[str, Any]:
    """One page of a session's captures, its notes and results, rounded for reading.

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
        "calibrate": _calibrate_command(session.path),
        "plan": session.plan.name,
        "operator": session.manifest.operator,
        "created": session.manifest.created_utc[:16].replace("T", " "),
        "captured": len(kept),
        "planned": len(session.entries),
        "is_complete": session.is_complete,
        "has_report": library.report_of(name) is not None,
        "remarks": list(session.remarks),
        "captures": [_capture(capture) for capture in _rows(captures, page)],
        "paging": _paging(len(captures), page),
        "notes": [
            {"when": event.utc[:16].replace("T", " "), "text": _note(event.facts)}
            for event in session.events
            if event.kind in ("note", "error", "stop", "skip")
        ][-NOTES_SHOWN:],
        "psf": _psf(session),
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


def _calibrate_command(path: Path) -> str:
    """Command that calibrates the PSF."""
    out = path / RESULTS_FOLDER / "psf.json"
    return f"standoff calibrate --session {quote(str(path))} --out {quote(str(out))}"


def _capture(capture: SessionCapture) -> dict[str, Any]:
    record = capture.record
    state = "used"
    if capture.is_superseded:
        state = "superseded"
    elif capture.excluded_because is not None:
        state = _short(f"excluded: {capture.excluded_because}")
    return {
        "index": record.index,
        "what": _short(f"{record.kind} {record.target}"),
        "orientation": f"{record.orientation_deg:g}",
        "height": f"{record.height_mm:.3f}",
        "exposure": "" if record.exposure_us is None else f"{record.exposure_us:g}",
        "frames": record.frames_used,
        "incomplete": record.incomplete_frames,
        "focus": "" if record.focus_value is None else f"{record.focus_value:.3g}",
        "state": state,
        "is_current": not capture.is_superseded,
        "is_used": capture.is_used,
    }


def _note(facts: Mapping[str, Any]) -> str:
    index = facts.get("index")
    about = "" if index is None else f"capture {index}: "
    text = facts.get("text") or facts.get("message") or facts.get("error")
    return _short(f"{about}{text or 'stopped or skipped by the operator'}")


def _psf(session: Session) -> list[dict[str, str]]:
    """Headline figures of the session's psf.json, ± at 95 %, if it has a readable one."""
    path = session.path / RESULTS_FOLDER / "psf.json"
    try:
        if path.is_symlink() or path.stat().st_size > MAX_RESULT_BYTES:
            return []
        stored = parse_json(path.read_bytes())
    except (OSError, ValueError):
        return []
    if not isinstance(stored, dict):
        return []
    figures = []
    for key, symbol in PSF_FIGURES:
        value, err = stored.get(key), stored.get(f"{key.removesuffix('_px')}_err_px")
        err = stored.get("rho_err") if key == "rho" else err
        if isinstance(value, int | float):
            unit = "" if key == "rho" else " px"
            sure = f" ± {NORMAL_95 * err:.4f}" if isinstance(err, int | float) else ""
            figures.append({"name": symbol, "value": f"{value:.4f}{sure}{unit}"})
    return figures
