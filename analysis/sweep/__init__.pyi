from .engine import (
    SweepCall as SweepCall,
    SweepOptions as SweepOptions,
    SweepSummary as SweepSummary,
    announced_sweep as announced_sweep,
    run_sweep as run_sweep,
)
from .exact_sum import ExactSum as ExactSum, on_own_grid as on_own_grid
from .kept_items import KeptItems as KeptItems, digests_of as digests_of
from .manifest import Manifest as Manifest, SweepItem as SweepItem
from .records import (
    CommittedRecord as CommittedRecord,
    refusal_line as refusal_line,
    size_of as size_of,
)
from .shards import (
    Finder as Finder,
    Shard as Shard,
    ShardDone as ShardDone,
    ShardWork as ShardWork,
    blocks_of as blocks_of,
    is_few as is_few,
    overlaps as overlaps,
    shard_key as shard_key,
)
from .sorting import sorted_lines as sorted_lines
