from ._documents import (
    FORMAT as FORMAT,
    TRACKS as TRACKS,
    VERSION as VERSION,
    benchmark_tasks as benchmark_tasks,
    card_files as card_files,
    document_bytes as document_bytes,
    track_documents as track_documents,
)
from ._tasks import SIZES as SIZES, RenderedTask as RenderedTask, Task as Task
