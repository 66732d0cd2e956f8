from ._checked import CheckedDetector as CheckedDetector, open_detector as open_detector
from ._spec import (
    BUILT_IN_DETECTORS as BUILT_IN_DETECTORS,
    Detector as Detector,
    DetectorAnswer as DetectorAnswer,
    DetectorSpec as DetectorSpec,
    takes_colour as takes_colour,
)
from .answers import (
    FollowupView as FollowupView,
    followup_view as followup_view,
    in_light_of as in_light_of,
    sees_reference as sees_reference,
)
from .built_in import (
    ir_mad_statistic as ir_mad_statistic,
    structural_dissimilarity as structural_dissimilarity,
)
