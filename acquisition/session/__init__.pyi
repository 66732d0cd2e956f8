from ._capture_files import (
    CaptureImages as CaptureImages,
    file_sha256 as file_sha256,
    parse_capture as parse_capture,
    read_capture as read_capture,
)
from ._files import (
    JOURNAL_NAME as JOURNAL_NAME,
    MANIFEST_NAME as MANIFEST_NAME,
    PART_SUFFIX as PART_SUFFIX,
    clear_parts as clear_parts,
    commit_file as commit_file,
    fsync_directory as fsync_directory,
    part_of as part_of,
    refuse_capture as refuse_capture,
    whole_file as whole_file,
    write_shared as write_shared,
)
from ._journal import (
    SYSTEM_STAMPS as SYSTEM_STAMPS,
    EventKind as EventKind,
    JournalEvent as JournalEvent,
    Stamps as Stamps,
)
from ._reader import (
    Session as Session,
    SessionCapture as SessionCapture,
    VerifyReport as VerifyReport,
    verify as verify,
)
from ._record import (
    CaptureRecord as CaptureRecord,
    Manifest as Manifest,
    Photograph as Photograph,
    Take as Take,
    camera_snapshot as camera_snapshot,
    stage_snapshot as stage_snapshot,
    utc_text as utc_text,
)
from ._repair import (
    RepairReport as RepairReport,
    repair_session as repair_session,
)
from ._writer import (
    SPARE_BYTES as SPARE_BYTES,
    SessionNotes as SessionNotes,
    SessionWriter as SessionWriter,
)
