from .export import ExportedSession as ExportedSession, export_session as export_session
from .photograph_import import (
    ImportedPhotographs as ImportedPhotographs,
    import_photographs as import_photographs,
)
from .records import (
    VerifiedSession as VerifiedSession,
    add_note as add_note,
    correct_height as correct_height,
    exclude_capture as exclude_capture,
    include_capture as include_capture,
    list_sessions as list_sessions,
    set_aside_files as set_aside_files,
    show_session as show_session,
    verify_session as verify_session,
)
from .session_report import (
    WrittenReport as WrittenReport,
    write_report as write_report,
    write_session_report as write_session_report,
)
from .validation_run import (
    VALIDATION_FILES as VALIDATION_FILES,
    default_models as default_models,
    run_validation as run_validation,
    session_validation as session_validation,
    validate as validate,
)
