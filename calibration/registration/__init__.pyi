from .acceptance import OVERLAP_MIN_PX as OVERLAP_MIN_PX
from .distorted_pose import DistortedPose as DistortedPose
from .document import HOMOGRAPHY_SCHEMA as HOMOGRAPHY_SCHEMA, Homography as Homography
from .features import (
    ImageFeatures as ImageFeatures,
    find_features as find_features,
    homography_pose as homography_pose,
    match_features as match_features,
)
from .pair import (
    DistortedRegistration as DistortedRegistration,
    Registration as Registration,
    register as register,
    register_distorted as register_distorted,
)
from .refinement import zoom_at_centre as zoom_at_centre
from .tracking import TrackedPose as TrackedPose, TrackingReference as TrackingReference

__all__ = [
    "HOMOGRAPHY_SCHEMA",
    "OVERLAP_MIN_PX",
    "DistortedPose",
    "DistortedRegistration",
    "Homography",
    "ImageFeatures",
    "Registration",
    "TrackedPose",
    "TrackingReference",
    "find_features",
    "homography_pose",
    "match_features",
    "register",
    "register_distorted",
    "zoom_at_centre",
]
