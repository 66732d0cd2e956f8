from .choices import EXPORT_ENDINGS as EXPORT_ENDINGS, ExportFormat as ExportFormat
from .export import (
    ExportRequest as ExportRequest,
    ExportSummary as ExportSummary,
    export_session as export_session,
    require_exporter as require_exporter,
)
