"""What the page of one capture shows, its levels, and its small picture in tables."""

from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import Lock
from typing import Any
from urllib.parse import quote

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.errors import SessionError
from acquisition.regular_files import LARGEST_IMAGE_BYTES, read_regular_file
from acquisition.session import CaptureRecord, Session, SessionCapture
from acquisition.untrusted import read_tiff
from standoff.console.session_library import SessionLibrary, UnknownSessionError
from standoff.console.web.view_model import target_text

THUMBNAIL_PX = (128, 96)
THUMBNAILS_KEPT = 4000
JPEG_QUALITY = 75
FLAT_SHARE = 0.005
DARK_PERCENT, BRIGHT_PERCENT = 0.5, 99.8


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureLevels:
    """One image of a capture: float32 levels in DN, shape ``(rows, cols)``; NaN is not valid."""

    levels: NDArray[np.float32]

    def chunks(self, size: int = 2**20) -> Sequence[memoryview]:
        """The pixels row by row, little-endian, in parts that a connection sends one by one."""
        data = memoryview(np.ascontiguousarray(self.levels, dtype="<f4").data).cast("B")
        return [data[start : start + size] for start in range(0, len(data), size)]


def find_capture(session: Session, index: int, uid: str | None) -> SessionCapture:
    """Find the capture of an entry that counts, or the one with an identity.

    Raises
    ------
    UnknownSessionError
        If there is none.
    """
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
    """Facts of one capture, its images, and its neighbours among those that count.

    Raises
    ------
    UnknownSessionError
        If there is no such session or capture.
    SessionError
        If the session cannot be read.
    """
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
        "facts": _facts(record),
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


def capture_levels(session: Session, record: CaptureRecord, image: str) -> CaptureLevels | None:
    """Read one image of a capture; None if the capture has no such image.

    Parameters
    ----------
    image
        ``mean``, ``noise`` (standard deviation of one frame), ``exposures`` (of a bracket, how
        many count), or the number of a raw frame, from 0 on.

    Raises
    ------
    SessionError
        If a file is missing or is not the one that was captured.
    """
    if image.isascii() and image.isdigit() and len(image) < 6:
        return _frame(session, record, int(image))
    if image not in [each["key"] for each in _images(record)]:
        return None
    _own_path(session, record.file)
    images = session.load(record)
    if image == "noise":
        assert images.variance_dn2 is not None
        return CaptureLevels(levels=np.sqrt(np.maximum(images.variance_dn2, 0)))
    if image == "exposures":
        assert images.exposures_used is not None
        return CaptureLevels(levels=images.exposures_used)
    if images.exposures_used is None:
        return CaptureLevels(levels=images.mean_dn)
    valid = np.where(images.exposures_used > 0, images.mean_dn, np.float32(np.nan))
    return CaptureLevels(levels=valid.astype(np.float32))


class Thumbnails:
    """Small pictures of captures, each made once and kept as long as there is room."""

    def __init__(self) -> None:
        self._lock = Lock()
        self._kept: OrderedDict[str, bytes] = OrderedDict()

    def of(self, session: Session, record: CaptureRecord) -> bytes:
        """Return a JPEG of the capture's mean, at most 128 x 96 pixels, stretched to be seen.

        Raises
        ------
        SessionError
            If its file cannot be read.
        """
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


def _frame(session: Session, record: CaptureRecord, number: int) -> CaptureLevels | None:
    if record.frames_file is None:
        return None
    pages = _pages(_own_path(session, record.frames_file))
    if number >= len(pages):
        return None
    return CaptureLevels(levels=pages[number].astype(np.float32))


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


def _facts(record: CaptureRecord) -> list[tuple[str, str]]:
    """Names and values, rounded for reading."""
    facts = [
        ("orientation", f"{record.orientation_deg:g}°"),
        ("height", f"{record.height_mm:.3f} mm"),
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
