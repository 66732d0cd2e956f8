from .commits import commit_file as commit_file
from .engine import (
    SweepOptions as SweepOptions,
    SweepSummary as SweepSummary,
    run_sweep as run_sweep,
)
from .manifest import Manifest as Manifest, SweepItem as SweepItem
from .shards import Shard as Shard, ShardDone as ShardDone, ShardWork as ShardWork
from .sorting import sorted_lines as sorted_lines

__all__ = [
    "Manifest",
    "Shard",
    "ShardDone",
    "ShardWork",
    "SweepItem",
    "SweepOptions",
    "SweepSummary",
    "commit_file",
    "run_sweep",
    "sorted_lines",
]
