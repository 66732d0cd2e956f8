from .commits import (
    PART_SUFFIX as PART_SUFFIX,
    commit_file as commit_file,
    whole_file as whole_file,
)
from .engine import (
    SweepOptions as SweepOptions,
    SweepSummary as SweepSummary,
    run_sweep as run_sweep,
)
from .manifest import Manifest as Manifest, SweepItem as SweepItem
from .shards import (
    Shard as Shard,
    ShardDone as ShardDone,
    ShardWork as ShardWork,
    blocks_of as blocks_of,
    is_few as is_few,
)
from .sorting import sorted_lines as sorted_lines
