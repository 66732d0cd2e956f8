from .built_in import structural_dissimilarity as structural_dissimilarity
from .checked import CheckedDetector as CheckedDetector
from .detector import (
    Detector as Detector,
    DetectorAnswer as DetectorAnswer,
    takes_colour as takes_colour,
)
from .followup_view import (
    FollowupView as FollowupView,
    followup_view as followup_view,
    in_light_of as in_light_of,
    sees_reference as sees_reference,
)
from .ir_mad import ir_mad_statistic as ir_mad_statistic
from .opening import open_detector as open_detector
from .spec import BUILT_IN_DETECTORS as BUILT_IN_DETECTORS, DetectorSpec as DetectorSpec
