from .export import (
    ExportRequest as ExportRequest,
    export_session as export_session,
    require_exporter as require_exporter,
)
