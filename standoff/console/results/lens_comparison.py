"""The last calibration of the same camera and lens, and whether the lens has moved since."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from math import isfinite
from pathlib import Path
from typing import Any

from standoff.console.results.key_figures import read_document
from standoff.library import RESULTS_FOLDER

PSF_NAME = "psf.json"
CHANGED = "the PSF has changed: "
OPTICS = ("lens", "focal_length_mm", "pixel_pitch_um")
SAME_HEIGHT = 0.01
"""Heights that differ by less, relative to themselves, are the same: defocus is hardly another."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Calibration:
    """A psf.json and what it was calibrated on: camera, optics and time of the first capture.

    ``heights_mm`` are the least and largest height of its edges, None where it states none.
    """

    path: Path
    session: str
    serial: str
    captured_utc: str
    optics: tuple[tuple[str, object], ...]
    heights_mm: tuple[float, float] | None

    def is_of(self, other: "Calibration") -> bool:
        """Whether it is of the same camera, with the same optics as far as both state them."""
        mine, others = dict(self.optics), dict(other.optics)
        return self.serial == other.serial and all(
            mine[key] == others[key] for key in mine.keys() & others.keys()
        )

    def is_at_heights_of(self, other: "Calibration") -> bool:
        """Whether both were calibrated at the same heights, as far as both state them."""
        if self.heights_mm is None or other.heights_mm is None:
            return True
        pairs = zip(self.heights_mm, other.heights_mm, strict=True)
        return all(abs(mine - others) <= SAME_HEIGHT * mine for mine, others in pairs)


def calibration_of(session: Path) -> Calibration | None:
    """The calibration in a session's results; None if there is none that names its camera."""
    path = session / RESULTS_FOLDER / PSF_NAME
    try:
        if path.parent.is_symlink() or path.is_symlink():
            return None
        state = path.stat()
    except OSError:
        return None
    return _read(path, session.name, state.st_mtime_ns, state.st_size)


def earlier_calibration(sessions: Path, session: Path) -> Calibration | None:
    """Find the newest calibration before that of a session, of the same camera and optics.

    One at the same heights goes before newer ones at others.

    Parameters
    ----------
    sessions
        Folder in which to look.
    session
        Folder of the session, with its own calibration.
    """
    own = calibration_of(session)
    if own is None:
        return None
    others = (
        calibration_of(path)
        for path in sessions.iterdir()
        if path != session and path.is_dir() and not path.is_symlink()
    )
    earlier = [o for o in others if o and o.is_of(own) and o.captured_utc < own.captured_utc]
    return max(
        earlier, key=lambda each: (each.is_at_heights_of(own), each.captured_utc), default=None
    )


def lens_sentence(
    document: Mapping[str, Any], earlier: Calibration, now: Calibration | None
) -> str:
    """Say what `standoff compare` found, in one sentence.

    Parameters
    ----------
    document
        As that command prints it with ``--json``.
    earlier
        The first of the two calibrations.
    now
        The second one, if it can be read.
    """
    since = f"{earlier.session} ({earlier.captured_utc[:10]})"
    verdict = str(document["verdict"])
    if document["shared_inputs"]:
        return f"Against {since}: {verdict}."
    if document["is_changed"]:
        what = verdict.removeprefix(CHANGED)
        if now is not None and not now.is_at_heights_of(earlier):
            return (
                f"Not the same as {since}: {what}. But that was calibrated at "
                f"{_range_text(earlier)} and this at {_range_text(now)}, where the same lens is in "
                "focus otherwise: calibrate at the same heights to tell whether it has moved."
            )
        return f"The lens has moved, or its focus has changed, since {since}: {what}."
    return f"The lens has not moved since {since}, as far as this shows: {verdict}."


def _range_text(calibration: Calibration) -> str:
    low_mm, high_mm = calibration.heights_mm or (0.0, 0.0)
    return f"{low_mm:g} mm" if low_mm == high_mm else f"{low_mm:g} to {high_mm:g} mm"


def _heights_of(document: Mapping[str, Any]) -> tuple[float, float] | None:
    edges = document.get("edges")
    stated = (
        [e.get("height_mm") for e in edges if isinstance(e, dict)]
        if isinstance(edges, list)
        else []
    )
    heights_mm = [float(h) for h in stated if isinstance(h, int | float) and isfinite(h)]
    return (min(heights_mm), max(heights_mm)) if heights_mm else None


@lru_cache(maxsize=1024)
def _read(path: Path, session: str, _changed_ns: int, _bytes: int) -> Calibration | None:
    document = read_document(path)
    camera, photograph = document.get("camera"), document.get("photograph")
    serial = camera.get("serial") if isinstance(camera, dict) else None
    captured_utc = document.get("captured_utc")
    if not (isinstance(serial, str) and serial and isinstance(captured_utc, str)):
        return None
    stated = photograph if isinstance(photograph, dict) else {}
    return Calibration(
        path=path,
        session=session,
        serial=serial,
        captured_utc=captured_utc,
        optics=tuple((key, stated[key]) for key in OPTICS if key in stated),
        heights_mm=_heights_of(document),
    )
