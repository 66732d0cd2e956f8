"""Homographies between two pictures from OpenCV's features, as its users find them."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.peers.program import PeerError
from simulation.arrays import FloatArray

_EVERYWHERE: Any = None
"""Of a mask that OpenCV's types ask for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Matching:
    """How features are matched and a homography is found.

    ``ratio`` is the most of the distances of a match and the next one (Lowe 2004), ``least`` the
    matches, and those that agree within the tolerance, below which a pair is refused.
    """

    ratio: float = 0.8
    tolerance_px: float = 1.0
    least: int = 12


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Matches:
    """Pairs of points (x, y), shape ``(n, 2)`` each."""

    followup_px: FloatArray
    reference_px: FloatArray


def detector_of(name: str) -> cv2.Feature2D:
    """One of OpenCV's, with settings for many features."""
    if name == "sift":
        return cv2.SIFT.create()
    if name == "orb":
        return cv2.ORB.create(nfeatures=5000)
    # These moved to the contributed modules in OpenCV 5.
    home: Any = cv2 if hasattr(cv2, "AKAZE") else cv2.xfeatures2d
    made: cv2.Feature2D = {"akaze": home.AKAZE, "brisk": home.BRISK}[name].create()
    return made


def matches_of(
    reference: NDArray[np.uint8],
    followup: NDArray[np.uint8],
    detector: cv2.Feature2D,
    matching: Matching,
) -> Matches:
    """Match features of two pictures by the ratio test; PeerError if there are too few."""
    (at_reference, of_reference), (at_followup, of_followup) = (
        detector.detectAndCompute(image, _EVERYWHERE) for image in (reference, followup)
    )
    if min(len(at_reference), len(at_followup)) < matching.least:
        raise PeerError("too few features")
    norm = cv2.NORM_L2 if of_followup.dtype == np.float32 else cv2.NORM_HAMMING
    pairs = cv2.BFMatcher(norm).knnMatch(of_followup, of_reference, k=2)
    kept = [
        two[0]
        for two in pairs
        if len(two) > 1 and two[0].distance < matching.ratio * two[1].distance
    ]
    if len(kept) < matching.least:
        raise PeerError(f"only {len(kept)} matches")
    return Matches(
        followup_px=np.array([at_followup[match.queryIdx].pt for match in kept]),
        reference_px=np.array([at_reference[match.trainIdx].pt for match in kept]),
    )


def magsac(matches: Matches, matching: Matching) -> FloatArray:
    """Homography from follow-up to reference by USAC_MAGSAC; PeerError if too few matches agree."""
    matrix, agreeing = cv2.findHomography(
        matches.followup_px,
        matches.reference_px,
        cv2.USAC_MAGSAC,
        matching.tolerance_px,
        maxIters=10_000,
        confidence=0.999,
    )
    if np.shape(matrix) != (3, 3):
        raise PeerError("no homography")
    if (count := int(np.count_nonzero(agreeing))) < matching.least:
        raise PeerError(f"only {count} matches agree")
    return np.asarray(matrix, dtype=np.float64)
