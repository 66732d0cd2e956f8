from .capture_file import (
    CaptureImages as CaptureImages,
    parse_capture as parse_capture,
    read_capture as read_capture,
)
from .capture_files import file_sha256 as file_sha256
from .durable_write import atomic_write as atomic_write
from .journal import SYSTEM_STAMPS as SYSTEM_STAMPS, Stamps as Stamps
from .journal_event import EventKind as EventKind, JournalEvent as JournalEvent
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
)
from .record import CaptureRecord as CaptureRecord, utc_text as utc_text
from .repair import RepairReport as RepairReport, repair_session as repair_session
from .shared_files import (
    clear_parts as clear_parts,
    commit_file as commit_file,
    fsync_directory as fsync_directory,
    part_of as part_of,
    refuse_capture as refuse_capture,
    whole_file as whole_file,
    write_shared as write_shared,
)
from .take import Photograph as Photograph, Take as Take
from .verification import VerifyReport as VerifyReport, verify as verify
from .writer import SPARE_BYTES as SPARE_BYTES, SessionWriter as SessionWriter
