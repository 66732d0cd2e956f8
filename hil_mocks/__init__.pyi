from .bench import SimulatedBench as SimulatedBench
from .clock import SimulatedClock as SimulatedClock
from .scene.pinhole import CameraPose as CameraPose
from .scene.truth import BenchTruth as BenchTruth
from .stage import SimulatedStage as SimulatedStage, StageFaults as StageFaults
