from .adjusted import capture_of as capture_of, without_blur as without_blur
from .excess import excess_variance as excess_variance
from .focus import FocusScatter as FocusScatter, scatter_err as scatter_err
from .mixed_model import (
    CaptureFit as CaptureFit,
    EdgeSquares as EdgeSquares,
    fit_by_capture as fit_by_capture,
    shared_reach_px2 as shared_reach_px2,
)
from .shared import SharedByCapture as SharedByCapture, capture_numbers as capture_numbers
