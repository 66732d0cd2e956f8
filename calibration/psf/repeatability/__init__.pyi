from .excess import excess_variance as excess_variance
from .focus import FocusScatter as FocusScatter
from .mixed_model import (
    CaptureFit as CaptureFit,
    EdgeSquares as EdgeSquares,
    SharedByCapture as SharedByCapture,
    capture_numbers as capture_numbers,
    fit_by_capture as fit_by_capture,
)
