from .learned_kernel import FoundKernel as FoundKernel
from .poses import (
    given_homography as given_homography,
    refuse_giant_frame as refuse_giant_frame,
    simulate_pose as simulate_pose,
    zoom_out as zoom_out,
)
from .simulated_photograph import (
    SimulatedPhotograph as SimulatedPhotograph,
)
from .simulation import (
    CaptureOptions as CaptureOptions,
    simulate as simulate,
)
from .uncertainty import (
    SimulationUncertainty as SimulationUncertainty,
    UncertaintyOptions as UncertaintyOptions,
)
