from ._export import (
    ExportRequest as ExportRequest,
    require_exporter as require_exporter,
    write_export as write_export,
)
