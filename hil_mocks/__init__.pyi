from .bench import SimulatedBench as SimulatedBench
from .devices import (
    SimulatedClock as SimulatedClock,
    SimulatedStage as SimulatedStage,
    StageFaults as StageFaults,
)
from .truth.bench_truth import BenchTruth as BenchTruth
from .truth.render import CameraPose as CameraPose
