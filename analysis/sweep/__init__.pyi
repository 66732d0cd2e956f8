from .commits import (
    PART_SUFFIX as PART_SUFFIX,
    commit_file as commit_file,
    whole_file as whole_file,
)
from .engine import (
    SweepCall as SweepCall,
    SweepOptions as SweepOptions,
    SweepSummary as SweepSummary,
    announced_sweep as announced_sweep,
    run_sweep as run_sweep,
)
from .manifest import Manifest as Manifest, SweepItem as SweepItem
from .records import (
    CommittedRecord as CommittedRecord,
    refusal_line as refusal_line,
    size_of as size_of,
)
from .shards import (
    Shard as Shard,
    ShardDone as ShardDone,
    ShardWork as ShardWork,
    blocks_of as blocks_of,
    is_few as is_few,
)
from .sorting import sorted_lines as sorted_lines
