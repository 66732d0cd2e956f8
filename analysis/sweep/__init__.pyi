from ._engine import (
    SweepCall as SweepCall,
    SweepOptions as SweepOptions,
    SweepSummary as SweepSummary,
    announced_sweep as announced_sweep,
    run_sweep as run_sweep,
)
from ._items import (
    Manifest as Manifest,
    SweepItem as SweepItem,
    batch_number as batch_number,
    group_of as group_of,
    is_few as is_few,
    sorted_lines as sorted_lines,
)
from ._records import Answer as Answer, Records as Records, merge_notes as merge_notes
from ._work import (
    Batch as Batch,
    Commit as Commit,
    Record as Record,
    Row as Row,
    Stored as Stored,
    SweepWork as SweepWork,
    refusal as refusal,
)
