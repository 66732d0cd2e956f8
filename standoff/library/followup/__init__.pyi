from .poses import simulate_pose as simulate_pose, zoom_out as zoom_out
from .simulated_photograph import (
    CaptureOptions as CaptureOptions,
    FollowUp as FollowUp,
    FoundKernel as FoundKernel,
    SimulatedPhotograph as SimulatedPhotograph,
    simulate as simulate,
    zoomed_out as zoomed_out,
)
