from ._agreement import (
    Agreement as Agreement,
    AlignedPhotograph as AlignedPhotograph,
    block_votes as block_votes,
)
from ._candidates import OVERLAP_MIN_PX as OVERLAP_MIN_PX
from ._descent import zoom_at_centre as zoom_at_centre
from ._distorted_pose import (
    DistortedPose as DistortedPose,
    FeatureMatches as FeatureMatches,
    PixelParallax as PixelParallax,
)
from ._document import Homography as Homography
from ._features import (
    ImageFeatures as ImageFeatures,
    RegistrationHints as RegistrationHints,
    features_of as features_of,
    find_features as find_features,
    homography_pose as homography_pose,
    leaving_out as leaving_out,
    match_features as match_features,
    parse_points as parse_points,
)
from ._pair import (
    Registration as Registration,
    RegistrationReference as RegistrationReference,
    register_images as register_images,
)
from ._refinement import RefinedPose as RefinedPose
from ._tracking import TrackedPose as TrackedPose, TrackingReference as TrackingReference
