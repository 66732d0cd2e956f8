from .agreement import (
    Agreement as Agreement,
    AlignedPhotograph as AlignedPhotograph,
    block_votes as block_votes,
)
from .candidates import OVERLAP_MIN_PX as OVERLAP_MIN_PX
from .descent import zoom_at_centre as zoom_at_centre
from .distorted_pose import DistortedPose as DistortedPose, FeatureMatches as FeatureMatches
from .document import Homography as Homography
from .features import (
    ImageFeatures as ImageFeatures,
    RegistrationHints as RegistrationHints,
    find_features as find_features,
    homography_pose as homography_pose,
    leaving_out as leaving_out,
    match_features as match_features,
    parse_points as parse_points,
)
from .pair import (
    Registration as Registration,
    RegistrationReference as RegistrationReference,
    register_images as register_images,
)
from .refinement import RefinedPose as RefinedPose
from .tracking import TrackedPose as TrackedPose, TrackingReference as TrackingReference
