"""Hypotheses refined at a coarse resolution and judged by the whole overlap."""

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from calibration.registration.dense import (
    Agreement,
    AlignedPhotograph,
    LevelPair,
    agreement_at,
    comparison_factor,
    correlation_at,
    refined_at,
    strays,
)
from calibration.registration.distorted_pose import DistortedPose
from calibration.registration.feature_matches import FeatureMatches
from calibration.registration.hypotheses import PoseHypothesis, is_plausible
from simulation import GaussianPsf
from simulation.arrays import FloatArray

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
    def is_clear(self) -> bool:
        """Whether no other hypothesis needs to be asked."""
        is_clear = self.agreement.significance >= _CLEAR_SIGNIFICANCE
        return self.is_significant and (is_clear or self.hypothesis.is_expected)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Choice:
    """The best candidate, whether it is significant, and its rival if the scene repeats."""

    best: Candidate
    rival: Candidate | None = None


def judged(
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
        if finer is not None and finer.agreement.significance > found.agreement.significance:
            found = finer
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
    """The hypothesis with most evidence; None if none leaves an overlap.

    ``best`` is one that is known already; from one that is clear on no other is judged.
    """
    if best is not None and best.is_clear:
        return best
    for hypothesis in hypotheses:
        candidate = judged(pair, hypothesis)
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
    other = judged(pair, PoseHypothesis(matrix=matrix), least)
    if other is None or not other.is_significant or other.agreement.evidence < least:
        return Choice(best=best)
    is_told = best.hypothesis.is_given or best.hypothesis.is_expected
    if not is_told and other.agreement.evidence > agreement.evidence:
        best, other = other, best
    return Choice(best=best, rival=other)
