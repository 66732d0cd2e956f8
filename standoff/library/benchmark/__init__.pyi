from ._data_set import MadeBenchmark as MadeBenchmark, make_benchmark as make_benchmark
from ._scoring import (
    SCORE_FILES as SCORE_FILES,
    ScoredBenchmark as ScoredBenchmark,
    score_benchmark as score_benchmark,
)
