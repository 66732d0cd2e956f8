from .bench import SimulatedBench as SimulatedBench
from .camera import CameraFaults as CameraFaults, SimulatedCamera as SimulatedCamera
from .clock import SimulatedClock as SimulatedClock
from .gige import GigeDevice as GigeDevice, GigeFaults as GigeFaults
from .practice_bench import PracticeBench as PracticeBench
from .scene.pinhole import CameraPose as CameraPose
from .scene.truth import BenchTruth as BenchTruth
from .stage import SimulatedStage as SimulatedStage, StageFaults as StageFaults

__all__ = [
    "BenchTruth",
    "CameraFaults",
    "CameraPose",
    "GigeDevice",
    "GigeFaults",
    "PracticeBench",
    "SimulatedBench",
    "SimulatedCamera",
    "SimulatedClock",
    "SimulatedStage",
    "StageFaults",
]
