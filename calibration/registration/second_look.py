"""Features looked for again where a pose that few of them speak for puts them.

Steep views, and views of which features tell little, leave a pose to the outlines of things, which
need not lie in the plane of what they show. Seen by the pose the two photographs are nearly alike:
of their features many more match, each near the place where it is expected. They say where the
plane is, and whether the pose is right.

References
----------
D. Mishkin, J. Matas and M. Perdoch, "MODS: fast and robust method for two-view matching", 2015, for
features that are detected again in views made for the purpose.
"""

from dataclasses import dataclass, replace
from math import sqrt

import cv2
import numpy as np

from calibration.errors import RegistrationError
from calibration.registration.candidates import (
    Candidate,
    DirectedPose,
    PhotographPair,
    judged,
)
from calibration.registration.dense import seen_by
from calibration.registration.distorted_pose import DistortedPose
from calibration.registration.feature_matches import FeatureMatches
from calibration.registration.features import features_of, homography_pose
from calibration.registration.hypotheses import within
from simulation.arrays import FloatArray
from simulation.pose import project

_WORKED_ON_PX = 1.0e6
_RATIO = 0.8
_REACH = 0.05
"""Of the longer side: how far from its place a feature is looked for."""

_BORDER_PX = 9
_LEAST_MATCHES = 20
_ROUNDS = 2
_SIGNIFICANT = 4.0
"""Standard errors of the number of matches by chance that the others must exceed."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SecondLook:
    """Matches of the target with the source as a pose shows it.

    Parameters
    ----------
    matches
        Of the target and of the source.
    factor
        Target pixels to one of the view.
    chance_count
        Matches by chance, which lie anywhere within reach: twice those of the outer half of it.
    """

    matches: FeatureMatches
    factor: int
    chance_count: int

    def displacement_px(self, found: DistortedPose) -> float | None:
        """Median distance of matches from where a pose puts them, px of the target.

        Of the nearest ones, as many as are beyond chance; None for too few to tell.
        """
        if not self._tells:
            return None
        return float(np.median(np.sort(self._apart_px(found))[: self._count]))

    def _apart_px(self, found: DistortedPose) -> FloatArray:
        return found.inverse().distances_px(self.matches.swapped())

    @property
    def _count(self) -> int:
        return len(self.matches.followup_px) - self.chance_count

    @property
    def _tells(self) -> bool:
        # The number by chance is uncertain by the root of them all.
        least = _SIGNIFICANT * sqrt(len(self.matches.followup_px))
        return self._count >= max(_LEAST_MATCHES, least)


def looked_again(pair: PhotographPair, candidate: Candidate) -> Candidate:
    """Return the candidate, or a better one by features that are found where it puts them.

    A candidate that many features speak for is returned as it is.
    """
    best = candidate
    if best.is_well_matched:
        return best
    for _ in range(_ROUNDS):
        found = second_look(best.directed)
        made = None if found is None else _improved(pair, best, found)
        if made is None or not made.is_significant:
            break
        best = made
    return best


def second_look(directed: DirectedPose) -> SecondLook | None:
    """Match features near the places where a pose puts them; None where there are none."""
    target = directed.target
    factor = max(round(sqrt(target.levels.size / _WORKED_ON_PX)), 1)
    far = target.reduced(factor)
    seen, inside = seen_by(directed.source, directed.pose, factor, far.shape)
    if far.usable is not None:
        inside &= far.usable
    square = np.ones((_BORDER_PX, _BORDER_PX), dtype=np.uint8)
    inside = np.asarray(cv2.erode(inside.astype(np.uint8), square), dtype=np.bool_)
    ours, theirs = features_of(seen, inside), features_of(far.levels, inside)
    reach_px = _REACH * max(far.shape)
    mask = within(theirs.points_px, ours.points_px, reach_px)
    pairs = ours.pairs_with(theirs, _RATIO, mask)
    if len(pairs) == 0:
        return None
    away = theirs.points_px[pairs[:, 0]] - ours.points_px[pairs[:, 1]]
    is_outer = np.hypot(*away.T) > reach_px / sqrt(2)
    at, where = (
        (points[chosen] + 0.5) * factor - 0.5
        for points, chosen in ((theirs.points_px, pairs[:, 0]), (ours.points_px, pairs[:, 1]))
    )
    y, x = directed.pose.to_reference_px(where[:, 1], where[:, 0])
    return SecondLook(
        matches=FeatureMatches(at, np.column_stack([x, y])),
        factor=factor,
        chance_count=2 * int(np.count_nonzero(is_outer)),
    )


def _improved(pair: PhotographPair, best: Candidate, found: SecondLook) -> Candidate | None:
    """A candidate of the matches that agree on a pose; None where too few do."""
    directed, matches = best.directed, found.matches
    if len(matches.followup_px) < _LEAST_MATCHES:
        return None
    # In pixels of the view that the pose gives, so that a match counts the same in any direction.
    back = np.asarray(np.linalg.inv(directed.pose.matrix))
    size = 1 / found.factor
    expected = np.column_stack(project(back, *matches.reference_px.T))
    try:
        motion, inlier = homography_pose(
            FeatureMatches(matches.followup_px * size, expected * size), _LEAST_MATCHES
        )
    except RegistrationError:
        return None
    scale = np.diag([size, size, 1.0])
    matrix: FloatArray = directed.pose.matrix @ np.linalg.inv(scale) @ motion @ scale
    agreeing = FeatureMatches(matches.followup_px[inlier], matches.reference_px[inlier])
    if directed.is_swapped:
        matrix, agreeing = np.asarray(np.linalg.inv(matrix)), agreeing.swapped()
    hypothesis = replace(best.hypothesis, matrix=matrix, matches=agreeing, is_second_look=True)
    return judged(pair, hypothesis)
