from .capture_file import CaptureImages as CaptureImages, read_capture as read_capture
from .durable_write import atomic_write as atomic_write
from .journal import EventKind as EventKind, new_uid as new_uid, utc_now as utc_now
from .manifest import (
    MANIFEST_NAME as MANIFEST_NAME,
    Manifest as Manifest,
    camera_snapshot as camera_snapshot,
    stage_snapshot as stage_snapshot,
)
from .notes import SessionNotes as SessionNotes
from .reader import (
    JOURNAL_NAME as JOURNAL_NAME,
    Session as Session,
    SessionCapture as SessionCapture,
    file_sha256 as file_sha256,
    verify as verify,
)
from .record import CaptureRecord as CaptureRecord
from .writer import SessionWriter as SessionWriter

__all__ = [
    "JOURNAL_NAME",
    "MANIFEST_NAME",
    "CaptureImages",
    "CaptureRecord",
    "EventKind",
    "Manifest",
    "Session",
    "SessionCapture",
    "SessionNotes",
    "SessionWriter",
    "atomic_write",
    "camera_snapshot",
    "file_sha256",
    "new_uid",
    "read_capture",
    "stage_snapshot",
    "utc_now",
    "verify",
]
