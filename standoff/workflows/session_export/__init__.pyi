from .choices import ENDINGS as ENDINGS, ExportFormat as ExportFormat
from .export import (
    ExportRequest as ExportRequest,
    ExportSummary as ExportSummary,
    export_session as export_session,
    require_exporter as require_exporter,
)

__all__ = [
    "ENDINGS",
    "ExportFormat",
    "ExportRequest",
    "ExportSummary",
    "export_session",
    "require_exporter",
]
