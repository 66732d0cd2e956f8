"""The simulated bench that stands in for camera, stage and scene."""

from hil_mocks.bench import SimulatedBench
from hil_mocks.camera import CameraFaults, SimulatedCamera
from hil_mocks.clock import SimulatedClock
from hil_mocks.gige import GigeDevice, GigeFaults
from hil_mocks.pinhole import CameraPose
from hil_mocks.practice_bench import PracticeBench
from hil_mocks.stage import SimulatedStage, StageFaults
from hil_mocks.truth import BenchTruth

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
