from .engine import (
    SweepCall as SweepCall,
    SweepOptions as SweepOptions,
    SweepSummary as SweepSummary,
    announced_sweep as announced_sweep,
    run_sweep as run_sweep,
)
from .items import (
    Manifest as Manifest,
    SweepItem as SweepItem,
    batch_number as batch_number,
    group_of as group_of,
    is_few as is_few,
)
from .records import Answer as Answer, Records as Records, merge_notes as merge_notes
from .segments import Batch as Batch, Record as Record, Stored as Stored
from .work import Commit as Commit, SweepWork as SweepWork, refusal as refusal
