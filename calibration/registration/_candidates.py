"""Hypotheses refined at a coarse resolution and judged by the whole overlap.

Photographs of which one shows the scene as in a mirror. No pose of a camera aligns them, yet
symmetric parts and repeated ones agree by chance well enough to pass for one. Whether the mirror
image explains the follow-up better is therefore asked of every pair. A scene that is its own mirror
image is explained as well by either, and is not mirrored.

Features looked for again where a pose that few of them speak for puts them. Steep views, and views
of which features tell little, leave a pose to the outlines of things, which need not lie in the
plane of what they show. Seen by the pose the two photographs are nearly alike: of their features
many more match, each near the place where it is expected. They say where the plane is, and whether
the pose is right.

References
----------
D. Mishkin, J. Matas and M. Perdoch, "MODS: fast and robust method for two-view matching", 2015, for
features that are detected again in views made for the purpose.
"""

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from math import sqrt

import cv2
import numpy as np

from calibration.errors import RegistrationError
from calibration.registration._agreement import (
    Agreement,
    AlignedPhotograph,
    agreement_at,
    comparison_factor,
    correlation_at,
    seen_by,
)
from calibration.registration._descent import LevelPair
from calibration.registration._distorted_pose import DistortedPose, FeatureMatches
from calibration.registration._features import (
    ImageFeatures,
    RegistrationHints,
    features_of,
    homography_pose,
)
from calibration.registration._hypotheses import (
    PoseHypothesis,
    feature_poses,
    is_plausible,
    points_homography,
    searched_poses,
    within,
)
from calibration.registration._refinement import refined_at, strays
from simulation import GaussianPsf
from simulation.arrays import FloatArray
from simulation.pose import project, projection_slopes

OVERLAP_MIN_PX = 16
"""Follow-up pixels needed along each axis."""

ELSEWHERE_MOST = 0.35
"""Largest share of the recognised blocks that may lie elsewhere than a pose puts them, of a pose
that few features spoke for. Of the right poses of ten such pairs of real photographs .27 at most,
in noise of 20 DN .07; of the wrong ones that twelve mirrored pairs were given .44 to .72, but for a
page (.05), a moon of which 3 % overlap (0), and two scenes that repeat, which is warned of."""

_SURE_MATCHES = 100
"""Matched features that agree on a pose from which blocks are not asked."""


_SIGNIFICANCE_MIN = 6.0
"""Standard deviations. Of 180 pairs of unrelated scenes none exceeded 3, of related ones none fell
below 13."""

_CORRELATION_MIN = 0.4
_CLEAR_SIGNIFICANCE = 10.0
"""From there on no other hypothesis is asked."""

_TILTED_CORRELATION = 0.5
"""What is foreshortened a lot agrees by chance in stripes, and then at other shifts as well: two
wrong poses had .41 and .47 with rivals of .8 and .67 of that, true ones .61 and more with rivals of
.3 at most."""

_OPEN_SIGNIFICANCE = 3.5
_OPEN_MATCHES = 12
"""Standard deviations, or matched features, from which a closer look may show more."""

_GROWTH = 1.2
"""Least ratio of the significance to that at half the resolution for a still closer look. With four
times the pixels it doubles where the photographs agree: by 1.5 and more at the poses of real pairs
that needed a closer look. By chance it stays: 3.6 to 4.5 at each of five resolutions."""

_TRUSTED_MATCHES = 20
_RIVAL_CORRELATION = 0.6
_RIVAL_EVIDENCE = 0.3
"""Of the best pose's: shares of its correlation and evidence with which another is its rival."""

_STRETCH_MAX = 8.0
"""Of the zoom: a plane is then seen at less than a degree, and its blur fills the photograph."""

_SAMPLES = 30_000
_COARSER = 4
_COARSE_SIDE_MIN_PX = 40


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PhotographPair:
    """Two photographs to align and the PSF of their camera."""

    reference: AlignedPhotograph
    followup: AlignedPhotograph
    psf: GaussianPsf | None

    def directed(self, pose: DistortedPose) -> "DirectedPose":
        """A pose of the follow-up, from the coarser of the two photographs to the finer one."""
        if pose.zoom >= 1:
            return DirectedPose(self.reference, self.followup, pose, is_swapped=False)
        return DirectedPose(self.followup, self.reference, pose.inverse(), is_swapped=True)

    def pose_of(self, matrix: FloatArray) -> DistortedPose:
        """A homography from the follow-up to the reference as a pose without distortion."""
        return DistortedPose(
            matrix=matrix / matrix[2, 2],
            k1=0.0,
            reference_shape=self.reference.shape,
            followup_shape=self.followup.shape,
        )


@dataclass(frozen=True, slots=True, eq=False)
class DirectedPose:
    """A pose from the coarser photograph, the target, to the finer one, the source.

    ``is_swapped`` where the follow-up is the source.
    """

    source: AlignedPhotograph
    target: AlignedPhotograph
    pose: DistortedPose
    is_swapped: bool

    def with_pose(self, pose: DistortedPose) -> "DirectedPose":
        """Return the same with another pose, target to source."""
        return DirectedPose(self.source, self.target, pose, self.is_swapped)

    @property
    def photographs(self) -> tuple[AlignedPhotograph, AlignedPhotograph]:
        """The source and the target."""
        return self.source, self.target

    def matches_of(self, hypothesis: PoseHypothesis) -> FeatureMatches | None:
        """Matched features of a hypothesis, of the target and of the source."""
        matches = hypothesis.matches
        return matches.swapped() if matches is not None and self.is_swapped else matches

    @property
    def of_followup(self) -> DistortedPose:
        """The pose from the follow-up to the reference."""
        return self.pose.inverse() if self.is_swapped else self.pose


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Candidate:
    """A hypothesis after its coarse refinement, and how well the photographs agree there."""

    hypothesis: PoseHypothesis
    directed: DirectedPose
    agreement: Agreement

    @property
    def is_significant(self) -> bool:
        """Whether chance does not explain the agreement."""
        return not self.missing

    @property
    def missing(self) -> str:
        """What the agreement lacks, in words; empty where chance does not explain it."""
        found, is_tilted = self.agreement, self.hypothesis.is_tilted
        needed = _CLEAR_SIGNIFICANCE if is_tilted else _SIGNIFICANCE_MIN
        least = _TILTED_CORRELATION if is_tilted else _CORRELATION_MIN
        if not found.significance >= needed:
            sigmas = f"{found.significance:.1f} standard deviations above chance"
            return f"{sigmas}, {needed:g} are needed"
        if not found.correlation >= least:
            return f"{least:g} is needed"
        if is_tilted and not found.rival_correlation < _RIVAL_CORRELATION * found.correlation:
            return f"{found.rival_correlation:.2f} at another shift"
        return ""

    @property
    def rank(self) -> tuple[bool, float]:
        """Significant ones first, then those of most evidence."""
        return self.is_significant, self.agreement.evidence

    @property
    def is_open(self) -> bool:
        """Whether a closer look may show more."""
        is_matched = self.hypothesis.match_count >= _OPEN_MATCHES
        return self.agreement.significance >= _OPEN_SIGNIFICANCE or is_matched

    @property
    def is_well_matched(self) -> bool:
        """Whether so many features agree on the pose that it needs no second look."""
        made = self.hypothesis
        is_found_at_once = not (made.is_tilted or made.is_second_look)
        return made.match_count >= _TRUSTED_MATCHES and is_found_at_once

    @property
    def is_surely_matched(self) -> bool:
        """Whether so many agree that it is not asked where blocks of the photographs lie."""
        return self.is_well_matched and self.hypothesis.match_count >= _SURE_MATCHES

    @property
    def is_beyond_doubt(self) -> bool:
        """Whether a quick look at features is enough."""
        return self.is_clear and self.is_surely_matched

    @property
    def is_clear(self) -> bool:
        """Whether no other hypothesis needs to be asked."""
        is_clear = self.agreement.significance >= _CLEAR_SIGNIFICANCE
        return self.is_significant and (is_clear or self.hypothesis.is_expected)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Choice:
    """The best candidate, whether it is significant, and its rival if the scene repeats."""

    best: Candidate
    rival: Candidate | None = None


def _judged(
    pair: PhotographPair, hypothesis: PoseHypothesis, least_evidence: float = 0.0
) -> Candidate | None:
    """Refine and judge a hypothesis; None where it leaves nothing in common.

    At a coarse resolution, from there or from a coarser one; where that leaves it open whether the
    agreement is chance, at a finer one: the more detail agrees, the less it can be. What has less
    than ``least_evidence`` at the coarse resolution is not looked at any closer.
    """
    start = pair.directed(pair.pose_of(hypothesis.matrix))
    factor = comparison_factor(start.pose)
    coarse_to_fine = _coarse_to_fine(start.target, factor)
    zoom = start.pose.zoom
    if not (zoom * coarse_to_fine[0] < min(start.source.shape)):
        return None  # one pixel of the target covers the source; or no number
    if not start.pose.stretch <= _STRETCH_MAX * zoom:
        return None
    found = _refined_and_judged(pair, hypothesis, start, [factor])
    if found is not None and found.agreement.evidence < least_evidence:
        return found
    if found is None or not found.is_clear:
        other = _refined_and_judged(pair, hypothesis, start, coarse_to_fine)
        if found is None or (
            other is not None and other.agreement.evidence > found.agreement.evidence
        ):
            found = other
    if found is None or found.is_clear or not found.is_open:
        return found
    while factor > 1:
        factor //= 2
        finer = _refined_and_judged(pair, hypothesis, found.directed, [factor])
        if finer is None:
            continue
        before, now = (one.agreement.significance for one in (found, finer))
        if now > before:
            found = finer
        if now < _GROWTH * before and not found.is_significant:
            break
    return found


def _refined_and_judged(
    pair: PhotographPair, hypothesis: PoseHypothesis, start: DirectedPose, factors: list[int]
) -> Candidate | None:
    directed = start
    for one in factors:
        level = LevelPair(directed.photographs, directed.pose, pair.psf, one, _SAMPLES)
        _, fit = refined_at(level, directed.pose)
        if fit is None or not is_plausible(fit.pose.matrix, directed.target.shape, None):
            break
        directed = directed.with_pose(fit.pose)
    # Where little detail survives the reduction, or the scene is not planar, the start is better.
    finer = max(factors[-1] // 2, 1)
    before, after = (
        correlation_at(*made.photographs, made.pose, finer) for made in (start, directed)
    )
    if before > after:
        directed = start
    if strays(directed.pose, start.pose, start.matches_of(hypothesis)):
        directed = start
    agreement = agreement_at(*directed.photographs, directed.pose, factors[-1])
    if agreement is None:
        return None
    return Candidate(hypothesis=hypothesis, directed=directed, agreement=agreement)


def _coarse_to_fine(target: AlignedPhotograph, factor: int) -> list[int]:
    factors = [factor]
    while len(factors) <= _COARSER and min(target.shape) / (2 * factors[0]) >= _COARSE_SIDE_MIN_PX:
        factors.insert(0, 2 * factors[0])
    return factors


def best_of(
    pair: PhotographPair, hypotheses: Iterable[PoseHypothesis], best: Candidate | None = None
) -> Candidate | None:
    """The hypothesis with most evidence, or ``best``; from a clear one on no other is judged."""
    if best is not None and best.is_clear:
        return best
    for hypothesis in hypotheses:
        candidate = _judged(pair, hypothesis)
        if candidate is None:
            continue
        if best is None or candidate.rank > best.rank:
            best = candidate
        if best.is_clear:
            break
    return best


def with_rival(pair: PhotographPair, best: Candidate) -> Choice:
    """Look for another shift at which the photographs agree nearly as well."""
    agreement = best.agreement
    if agreement.rival_correlation < _RIVAL_CORRELATION * agreement.correlation:
        return Choice(best=best)
    shift = np.eye(3)
    shift[:2, 2] = [-along for along in agreement.rival_shift_px]
    matrix = np.asarray(best.directed.pose.matrix @ shift)
    if best.directed.is_swapped:
        matrix = np.asarray(np.linalg.inv(matrix))
    least = _RIVAL_EVIDENCE * agreement.evidence
    other = _judged(pair, PoseHypothesis(matrix=matrix), least)
    if other is None or not other.is_significant or other.agreement.evidence < least:
        return Choice(best=best)
    is_told = best.hypothesis.is_given or best.hypothesis.is_expected
    if not is_told and other.agreement.evidence > agreement.evidence:
        best, other = other, best
    return Choice(best=best, rival=other)


_FAR_BETTER = 2.0
"""Ratio of evidence. Of 82 mirrored pairs of photographs the mirror image had 9 times as much or
more, of 41 ordinary ones at most .15 times as much."""

_BEYOND_DOUBT = 0.5
"""Evidence of a pose whose mirror image is not searched for without features. The poses on which
twelve mirrored pairs agreed by chance had .37 at most."""

_TRIED = 400
_CHANCE_MATCHES = 8
"""Features whose mirror images are matched at first, and matches of them that agree by chance."""

_LEAST_MATCHES = 12
_RATIO = 0.8
"""Matches of a mirrored pose that is judged; ratio test as for the poses that are not."""

_SENTENCE = (
    "one photograph is the mirror image of the other (viewers show FITS files top to bottom); flip "
    "one of them, or give --mirrored to align them as they are, mirrored"
)


def refuse_contradiction(hints: RegistrationHints, shape: tuple[int, int]) -> None:
    """Check that what is given is mirrored as the hints say, in a follow-up of this shape."""
    given: list[tuple[str, FloatArray, tuple[float, float]]] = []
    if hints.matrix is not None:
        given.append(("pose", hints.matrix, ((shape[1] - 1) / 2, (shape[0] - 1) / 2)))
    if hints.points is not None:
        matrix = points_homography(hints.points)
        if matrix is not None:
            x, y = hints.points.followup_px.mean(axis=0).tolist()
            given.append(("points", matrix, (x, y)))
    for name, matrix, (x, y) in given:
        a, b, c, d = projection_slopes(matrix, x, y)
        if (a * d - b * c < 0) != hints.mirrored:
            says = f"by the given {name}, "
            raise not_mirrored(says) if hints.mirrored else mirrored(says)


def mirrored(says: str = "") -> RegistrationError:
    """Return the error of a pair that is mirrored; ``says`` who says so."""
    return RegistrationError(says + _SENTENCE, reason="mirrored")


def not_mirrored(says: str = "") -> RegistrationError:
    """Return the error of a pair that was said to be mirrored and is not."""
    return RegistrationError(
        f"{says}the photographs are not mirrored; leave out --mirrored", reason="not_mirrored"
    )


class MirrorImage:
    """The mirror image of a follow-up, to be compared with the reference like the follow-up.

    ``features`` are those of the reference and of the follow-up; the zoom is the expected ratio of
    distances, follow-up over reference, None for any.
    """

    def __init__(
        self,
        pair: PhotographPair,
        features: tuple[ImageFeatures, ImageFeatures],
        zoom: float | None,
    ) -> None:
        self.features = self._near, self._far = features
        self._seen, self._zoom = pair, zoom

    @cached_property
    def _pair(self) -> PhotographPair:
        return replace(self._seen, followup=self._seen.followup.mirrored())

    def is_matched_better(self, best: Candidate | None) -> bool:
        """Whether matched features speak far more for it than for the follow-up's best pose."""
        if best is not None and best.is_clear and best.is_well_matched:
            some = self._far.some(_TRIED)
            share = len(some.points_px) / max(len(self._far.points_px), 1)
            least = max(share * best.hypothesis.match_count, _CHANCE_MATCHES)
            if _agreeing(self._near, some.mirrored()) <= least:
                return False
        hypotheses = feature_poses(self._near, self._far.mirrored(), self._zoom)
        first = [one for one in islice(hypotheses, 1) if one.match_count >= _LEAST_MATCHES]
        return _is_better(best_of(self._pair, first), best)

    def is_searched_better(self, best: Candidate | None) -> bool:
        """Whether it agrees far better where features tell nothing."""
        if (best is not None and best.is_significant) and (
            best.is_well_matched or best.agreement.evidence >= _BEYOND_DOUBT
        ):
            return False
        pair = self._pair
        found = best_of(pair, searched_poses(pair.reference, pair.followup, self._zoom))
        return _is_better(found, best)


def _is_better(found: Candidate | None, best: Candidate | None) -> bool:
    if found is None or not found.is_clear:
        return False
    known = best.agreement.evidence if best is not None and best.is_significant else 0.0
    return found.agreement.evidence > _FAR_BETTER * known


def _agreeing(near: ImageFeatures, far: ImageFeatures) -> int:
    """Matches that agree on one pose."""
    pairs = near.pairs_with(far, _RATIO)
    if len(pairs) <= _CHANCE_MATCHES:
        return 0
    matches = FeatureMatches(far.points_px[pairs[:, 0]], near.points_px[pairs[:, 1]])
    try:
        _, inlier = homography_pose(matches, _CHANCE_MATCHES)
    except RegistrationError:
        return 0
    return int(inlier.sum())


_WORKED_ON_PX = 1.0e6
_REACH = 0.05
"""Of the longer side: how far from its place a feature is looked for."""

_BORDER_PX = 9
_LEAST_NEW_MATCHES = 20
_ROUNDS = 2
_SIGNIFICANT = 4.0
"""Standard errors of the number of matches by chance that the others must exceed."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _SecondLook:
    """Matches of the target with the source as a pose shows it, ``factor`` to a target pixel.

    Those by chance lie anywhere within reach: they are twice those of the outer half of it.
    """

    matches: FeatureMatches
    factor: int
    chance_count: int

    def displacement_px(self, found: DistortedPose) -> float | None:
        """Median distance in px of the target of the matches beyond chance; None for too few."""
        if not self._tells:
            return None
        apart_px = found.inverse().distances_px(self.matches.swapped())
        return float(np.median(np.sort(apart_px)[: self._count]))

    @property
    def _count(self) -> int:
        return len(self.matches.followup_px) - self.chance_count

    @property
    def _tells(self) -> bool:
        # The number by chance is uncertain by the root of them all.
        least = _SIGNIFICANT * sqrt(len(self.matches.followup_px))
        return self._count >= max(_LEAST_NEW_MATCHES, least)


def looked_again(pair: PhotographPair, candidate: Candidate) -> Candidate:
    """Return the candidate, or a better one by features found where it puts them."""
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


def second_look(directed: DirectedPose) -> _SecondLook | None:
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
    return _SecondLook(
        matches=FeatureMatches(at, np.column_stack([x, y])),
        factor=factor,
        chance_count=2 * int(np.count_nonzero(is_outer)),
    )


def _improved(pair: PhotographPair, best: Candidate, found: _SecondLook) -> Candidate | None:
    """A candidate of the matches that agree on a pose; None where too few do."""
    directed, matches = best.directed, found.matches
    if len(matches.followup_px) < _LEAST_NEW_MATCHES:
        return None
    # In pixels of the view that the pose gives, so that a match counts the same in any direction.
    back = np.asarray(np.linalg.inv(directed.pose.matrix))
    size = 1 / found.factor
    expected = np.column_stack(project(back, *matches.reference_px.T))
    try:
        motion, inlier = homography_pose(
            FeatureMatches(matches.followup_px * size, expected * size), _LEAST_NEW_MATCHES
        )
    except RegistrationError:
        return None
    scale = np.diag([size, size, 1.0])
    matrix: FloatArray = directed.pose.matrix @ np.linalg.inv(scale) @ motion @ scale
    agreeing = FeatureMatches(matches.followup_px[inlier], matches.reference_px[inlier])
    if directed.is_swapped:
        matrix, agreeing = np.asarray(np.linalg.inv(matrix)), agreeing.swapped()
    hypothesis = replace(best.hypothesis, matrix=matrix, matches=agreeing, is_second_look=True)
    return _judged(pair, hypothesis)
