"""Matched image features: pairs of points that a pose must agree with."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from calibration.errors import RegistrationError
from calibration.registration.feature_matches import FeatureMatches
from simulation.arrays import AnyArray, BoolArray, Float32Array, FloatArray
from simulation.pose import project, projection_depth

_FEATURES = 4000
_RATIO_TEST = 0.8  # D. Lowe, "Distinctive image features from scale-invariant keypoints", 2004
_MATCH_TOLERANCE_PX = 3.0
_INLIERS_MIN = 12
_REACH = 0.08
"""How far from its expected position to look for a feature, relative to the longer side."""

_LONELY_DISTANCE_MAX = 200.0
"""Distance of descriptors (of length 512) up to which a match without a rival is accepted."""

_ROLES = {"reference": "the reference", "followup": "the follow-up", None: "it"}


@dataclass(frozen=True, slots=True, eq=False)
class ImageFeatures:
    """SIFT features of an image of ``shape``: points ``(x, y)``, shape (n, 2), and descriptors."""

    points_px: FloatArray
    descriptors: Float32Array
    shape: tuple[int, ...]

    def matched_with(self, followup: Self, expected: FloatArray | None = None) -> FeatureMatches:
        """Pair the features of a reference with a follow-up's, as ``match_features`` does."""
        mask = None
        if expected is not None:
            x, y = project(expected, *followup.points_px.T)
            own_x, own_y = self.points_px.T
            away_px = np.hypot(x[:, None] - own_x, y[:, None] - own_y)
            mask = (away_px < _REACH * max(self.shape)).astype(np.uint8)
        candidates = cv2.BFMatcher(cv2.NORM_L2).knnMatch(
            followup.descriptors, self.descriptors, 2, mask
        )
        pairs = [found[0] for found in candidates if _is_distinct(found)]
        if len(pairs) < _INLIERS_MIN:
            raise RegistrationError(
                f"only {len(pairs)} features of the images match",
                reason="no_matches",
                count=len(pairs),
            )
        return FeatureMatches(
            followup.points_px[[pair.queryIdx for pair in pairs]],
            self.points_px[[pair.trainIdx for pair in pairs]],
        )


def match_features(
    reference: AnyArray,
    followup: AnyArray,
    expected: FloatArray | None = None,
) -> FeatureMatches:
    """SIFT features that the follow-up and the reference share.

    Parameters
    ----------
    reference, followup
        Grey images.
    expected
        Shape (3, 3): approximate map from follow-up pixels ``(x, y, 1)`` to the reference. Features
        are then looked for only near there, so that a repeating pattern is not matched with a
        neighbouring copy of itself.

    Raises
    ------
    RegistrationError
        If an image has too few features, or too few of them match.
    """
    near, far = find_features(reference, "reference"), find_features(followup, "followup")
    return near.matched_with(far, expected)


def find_features(
    image: AnyArray, role: Literal["reference", "followup"] | None = None
) -> ImageFeatures:
    """SIFT features of a grey image; ``role`` names the image in errors.

    Raises
    ------
    RegistrationError
        If it has too few features.
    ValueError
        If it is not a grey image with finite values.
    """
    # Without precise upscaling every keypoint is shifted by 0.25 px towards the origin.
    sift = cv2.SIFT.create(nfeatures=_FEATURES, enable_precise_upscale=True)
    found, descriptors = sift.detectAndCompute(_as_bytes(image), None)
    if len(found) < _INLIERS_MIN:
        raise RegistrationError(
            f"{_ROLES[role]} has only {len(found)} features to align by; "
            "photograph something with more detail",
            reason="no_detail",
            at_fault=role,
            count=len(found),
        )
    points = np.array([point.pt for point in found], dtype=np.float64)
    return ImageFeatures(points, np.asarray(descriptors, dtype=np.float32), image.shape)


def _is_distinct(found: Sequence[cv2.DMatch]) -> bool:
    """Whether the best of the candidates is much better than the next."""
    if len(found) == 2:
        return found[0].distance < _RATIO_TEST * found[1].distance
    return len(found) == 1 and found[0].distance < _LONELY_DISTANCE_MAX


def homography_pose(matches: FeatureMatches) -> tuple[FloatArray, BoolArray]:
    """Homography, shape (3, 3), from follow-up to reference, and the matches that agree with it.

    Raises
    ------
    RegistrationError
        If too few agree, or only on a pose that turns the scene inside out.
    """
    found, mask = cv2.findHomography(
        matches.followup_px, matches.reference_px, cv2.USAC_MAGSAC, _MATCH_TOLERANCE_PX
    )
    # If it finds nothing, OpenCV returns an empty matrix or None.
    count = int(np.count_nonzero(mask)) if np.shape(found) == (3, 3) else 0
    if count < _INLIERS_MIN:
        raise RegistrationError(
            f"only {count} feature matches agree on a pose", reason="no_common_pose", count=count
        )
    matrix: FloatArray = np.asarray(found, dtype=np.float64)
    inlier: BoolArray = mask.ravel().astype(np.bool_)
    depth = projection_depth(matrix, *matches.followup_px[inlier].T)
    # Local area and orientation are det / depth^3. A scene seen from its front is not mirrored.
    if not np.all(np.linalg.det(matrix) * depth > 0):
        raise RegistrationError(
            "the features agree only on a pose that is not possible for a camera (mirrored or "
            "beyond the horizon)",
            reason="inside_out",
        )
    return matrix, inlier


def _as_bytes(image: AnyArray) -> NDArray[np.uint8]:
    values = np.asarray(image, dtype=np.float64)
    if values.ndim != 2 or values.size == 0 or not np.isfinite(values).all():
        raise ValueError(f"alignment needs grey images with finite values, got shape {image.shape}")
    low, high = values.min(), values.max()
    if low == high:
        return np.zeros(values.shape, dtype=np.uint8)
    return np.asarray((values - low) * (255.0 / (high - low)) + 0.5, dtype=np.float64).astype(
        np.uint8
    )
