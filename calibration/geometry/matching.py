"""Matched points over the captures of one target: which belong together, and about where.

Neighbours in height are matched by their features, and one further apart where that fails. The
largest group that hangs together is kept; every capture outside it is named with the reason.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import atan2, log

import numpy as np
from numpy.typing import NDArray

from calibration.errors import RegistrationError
from calibration.geometry.bundle_adjustment import PlaneMatches
from calibration.geometry.camera import CapturePose
from calibration.registration import ImageFeatures, find_features, homography_pose
from simulation.pose import project, projection_slopes

__all__ = ["SeriesPoints", "match_series", "pose_of_homography"]

FloatArray = NDArray[np.float64]

_FEATURE_ERROR_PX = 0.4
_REACH = 2
"""A capture is matched with the next one, and where that fails with the one after it."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SeriesPoints:
    """Matches of a series by features, and what follows from them.

    ``kept`` are the places in the series of the captures that hang together, ``poses`` about where
    they were taken (in units of the first kept one's distance), ``matches`` number them by their
    place in ``kept``, ``refused`` says of every other capture why (of all where no two belong
    together).
    """

    kept: tuple[int, ...]
    poses: tuple[CapturePose, ...]
    matches: tuple[PlaneMatches, ...]
    refused: dict[int, str]


def match_series(images: Sequence[NDArray[np.generic]], focal_length_px: float) -> SeriesPoints:
    """Match the captures of one target.

    Parameters
    ----------
    images
        Grey, of one size, from the nearest to the furthest.
    focal_length_px
        Focal length, for the poses; a guess will do.
    """
    features: dict[int, ImageFeatures] = {}
    reasons: dict[int, str] = {}
    for number, image in enumerate(images):
        try:
            features[number] = find_features(image)
        except RegistrationError as error:
            reasons[number] = str(error)
    links: dict[tuple[int, int], tuple[FloatArray, PlaneMatches]] = {}
    for near in features:
        for far in range(near + 1, near + 1 + _REACH):
            if far not in features:
                continue
            try:
                links[near, far] = _link(features, near, far)
            except RegistrationError as error:
                reasons.setdefault(near, str(error))
                reasons.setdefault(far, str(error))
            else:
                break
    kept = _largest_group(len(images), list(links))
    place = {capture: number for number, capture in enumerate(kept)}
    middle = (np.array(images[0].shape[1::-1]) - 1) / 2
    to_first: dict[int, FloatArray] = {kept[0]: np.eye(3)}
    waiting = {pair: matrix for pair, (matrix, _) in links.items() if pair[0] in place}
    while waiting:
        near, far = next(p for p in waiting if p[0] in to_first or p[1] in to_first)
        matrix = waiting.pop((near, far))
        # No capture has two links to further ones: the links make no circle.
        if near in to_first:
            to_first[far] = to_first[near] @ matrix
        else:
            to_first[near] = to_first[far] @ np.linalg.inv(matrix)
    return SeriesPoints(
        kept=kept,
        poses=tuple(pose_of_homography(to_first[c], middle, focal_length_px) for c in kept),
        matches=tuple(
            PlaneMatches(
                capture=place[far],
                seen_px=found.seen_px,
                other=place[near],
                other_points=found.other_points,
                covariance_px2=found.covariance_px2,
            )
            for (near, far), (_, found) in links.items()
            if near in place
        ),
        refused={
            capture: reasons.get(capture, "it matches no other capture")
            for capture in range(len(images))
            if capture not in place or len(kept) == 1
        },
    )


def pose_of_homography(
    matrix: FloatArray, middle_px: FloatArray, focal_length_px: float
) -> CapturePose:
    """Pose of an upright camera whose pixels ``matrix`` takes to those of the first capture."""
    middle_x, middle_y = middle_px.tolist()
    x, y = project(matrix, middle_x, middle_y)
    a, b, c, d = projection_slopes(matrix, middle_x, middle_y)
    return CapturePose(
        log_distance=log(abs(a * d - b * c)) / 2,
        turn_rad=atan2(c - b, a + d),
        x=(x - middle_x) / focal_length_px,
        y=(y - middle_y) / focal_length_px,
    )


def _link(
    features: dict[int, ImageFeatures], near: int, far: int
) -> tuple[FloatArray, PlaneMatches]:
    found = features[near].matched_with(features[far])
    matrix, agreeing = homography_pose(found)
    count = int(np.count_nonzero(agreeing))
    return matrix, PlaneMatches(
        capture=far,
        seen_px=found.followup_px[agreeing],
        other=near,
        other_points=found.reference_px[agreeing],
        covariance_px2=np.tile(np.eye(2) * _FEATURE_ERROR_PX**2, (count, 1, 1)),
    )


def _largest_group(count: int, pairs: list[tuple[int, int]]) -> tuple[int, ...]:
    group = list(range(count))
    for near, far in pairs:
        old, new = group[far], group[near]
        group = [new if g == old else g for g in group]
    largest = max(set(group), key=lambda g: (group.count(g), -g))
    return tuple(capture for capture in range(count) if group[capture] == largest)
