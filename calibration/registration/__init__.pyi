from .acceptance import OVERLAP_MIN_PX as OVERLAP_MIN_PX
from .dense import zoom_at_centre as zoom_at_centre
from .displacement import SmoothDisplacement as SmoothDisplacement
from .distorted_pose import DistortedPose as DistortedPose
from .document import HOMOGRAPHY_SCHEMA as HOMOGRAPHY_SCHEMA, Homography as Homography
from .feature_matches import FeatureMatches as FeatureMatches
from .features import (
    ImageFeatures as ImageFeatures,
    find_features as find_features,
    homography_pose as homography_pose,
    match_features as match_features,
)
from .hints import RegistrationHints as RegistrationHints, leaving_out as leaving_out
from .pair import Registration as Registration, register as register
from .point_table import POINT_COLUMNS as POINT_COLUMNS, parse_points as parse_points
from .reference import RegistrationReference as RegistrationReference
from .tracking import TrackedPose as TrackedPose, TrackingReference as TrackingReference
