from .distorted_pose import DistortedPose as DistortedPose
from .features import (
    ImageFeatures as ImageFeatures,
    find_features as find_features,
    homography_pose as homography_pose,
    match_features as match_features,
)
from .overlap import OVERLAP_MIN_PX as OVERLAP_MIN_PX
from .pair import (
    AxialRegistration as AxialRegistration,
    DistortedRegistration as DistortedRegistration,
    Registration as Registration,
    register as register,
    register_axial as register_axial,
    register_distorted as register_distorted,
)
from .refinement import zoom_at_centre as zoom_at_centre
from .tracking import TrackedPose as TrackedPose, TrackingReference as TrackingReference

__all__ = [
    "OVERLAP_MIN_PX",
    "AxialRegistration",
    "DistortedPose",
    "DistortedRegistration",
    "ImageFeatures",
    "Registration",
    "TrackedPose",
    "TrackingReference",
    "find_features",
    "homography_pose",
    "match_features",
    "register",
    "register_axial",
    "register_distorted",
    "zoom_at_centre",
]
