from .data_set import MadeBenchmark as MadeBenchmark, make_benchmark as make_benchmark
