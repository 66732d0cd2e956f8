"""A GigE Vision camera in pure Python, served on a loopback address."""

from hil_mocks.gige.bootstrap import Identity
from hil_mocks.gige.device import GigeDevice
from hil_mocks.gige.faults import GigeFaults
from hil_mocks.gige.frame_source import BenchFrameSource, FrameRequest, FrameSource

__all__ = [
    "BenchFrameSource",
    "FrameRequest",
    "FrameSource",
    "GigeDevice",
    "GigeFaults",
    "Identity",
]
