"""Registration of a follow-up in its reference.

Hints, matched features and, where these fail, a search over thumbnails give hypotheses; each is
refined coarsely and judged by the whole overlap. The best is refined on all pixels from coarse to
fine. What cannot be told from chance is refused; what may be one of several is warned of.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from itertools import chain, islice
from typing import TYPE_CHECKING, Self

import numpy as np

from calibration.errors import RegistrationError
from calibration.registration._agreement import AlignedPhotograph, block_votes
from calibration.registration._candidates import (
    ELSEWHERE_MOST,
    Candidate,
    Choice,
    DirectedPose,
    MirrorImage,
    PhotographPair,
    best_of,
    looked_again,
    mirrored,
    not_mirrored,
    refuse_contradiction,
    second_look,
    with_rival,
)
from calibration.registration._distorted_pose import DistortedPose, mirrored_matrix
from calibration.registration._features import (
    ImageFeatures,
    Look,
    RegistrationHints,
    features_of,
)
from calibration.registration._hypotheses import (
    PoseHypothesis,
    feature_poses,
    given_poses,
    searched_poses,
    tilted_poses,
)
from calibration.registration._refinement import RefinedPose, refined_pose
from simulation import GaussianPsf
from simulation.arrays import AnyArray, BoolArray, FloatArray
from simulation.by_value import ByValue
from simulation.notebook import Shown

if TYPE_CHECKING:
    from calibration.parallax import Parallax


@dataclass(frozen=True, slots=True, eq=False)
class RegistrationReference:
    """A photograph, not changed meanwhile, whose features are looked for once, and no sooner."""

    photograph: AlignedPhotograph
    _features: dict[Look, ImageFeatures] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, image: AnyArray, left_out: BoolArray | None = None) -> Self:
        """Take a grey image, shape ``(rows, cols)``; what is ``left_out`` does not count."""
        return cls(AlignedPhotograph.of(image, left_out))

    def features(self, look: Look) -> ImageFeatures:
        """Features of the photograph, as `features_of` finds them."""
        if look not in self._features:
            self._features[look] = features_of(self.photograph.levels, self.photograph.usable, look)
        return self._features[look]


Photographs = tuple[RegistrationReference, RegistrationReference]
"""The reference and the follow-up."""

_PLACE_ERR_WARN_PX = 0.25
_PLACE_ERR_MAX_PX = 3.0
"""Standard errors of a place from which a result warns, and from which it is refused."""

_GIVEN_ERR_PX = 3.0
"""Standard error of a hint that could not be refined: what the operator is asked for."""

_ASIDE_WARN_PX = 1.0
"""Of a flat scene, details match to .3 to .9 px of the coarser photograph."""

_INLIER_PX = 3.0

_REMEDIES = (
    "give the approximate ratio of the distances (--expect-zoom), the approximate pose "
    "(--homography) or at least four pairs of points (--points), and leave out what differs "
    "(--mask)"
)
_SMALLEST_SIDE_PX = 16
"""Of less than two blocks of JPEG nothing can be told apart, and no pyramid made."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class Registration(Shown, ByValue):
    """Pose of a follow-up in its reference; the follow-up may be nearer or further away.

    Parameters
    ----------
    pose
        Position of every follow-up pixel in the reference.
    zoom
        Reference pixels per follow-up pixel at the follow-up's centre.
    place_err_px
        Standard error of a follow-up pixel's position in the reference, in reference px; root mean
        square over the overlap.
    k1_err
        Standard error of ``pose.k1``; 0 if no distortion was fitted.
    feature_matrix
        Shape (3, 3): the homography from which the refinement started, usually that of the matched
        features.
    inlier_count, match_rms_px
        Number of feature matches that agree with the pose, and their root mean square distance from
        it in reference px; both are 0 if the pose was found without features.
    correlation
        Correlation of the two photographs at the resolution of the coarser one, without slow
        changes of the light.
    residual_rms_dn
        Root mean square of the remaining difference between them, in the levels of the coarser one.
    warnings
        Sentences on what an operator should check.
    parallax
        Of a scene with depth: parallax of each pixel of the coarser photograph beside a plane,
        and in ``parallax.pose`` the position of every follow-up pixel at its own depth. None where
        ``pose`` explains the photographs, or parallax was not looked for.
    """

    pose: DistortedPose = field(repr=False)
    zoom: float
    place_err_px: float
    k1_err: float
    feature_matrix: FloatArray = field(repr=False)
    inlier_count: int
    match_rms_px: float
    correlation: float
    residual_rms_dn: float
    warnings: tuple[str, ...] = ()
    parallax: "Parallax | None" = field(default=None, repr=False)

    @property
    def matrix(self) -> FloatArray:
        """Homography (3, 3) from follow-up to reference pixel centres, both of an ideal lens."""
        return self.pose.matrix

    def mirrored(self) -> Self:
        """Return the registration of the follow-up with its columns reversed."""
        matrix = mirrored_matrix(self.feature_matrix, self.pose.followup_shape)
        return replace(
            self, pose=self.pose.mirrored(), feature_matrix=np.asarray(matrix / matrix[2, 2])
        )


def register_images(
    reference: AnyArray | RegistrationReference,
    followup: AnyArray,
    psf: GaussianPsf | None = None,
    hints: RegistrationHints | None = None,
) -> Registration:
    """Pose of ``followup`` in ``reference``, both grey, ``(rows, cols)``; either may be nearer.

    If their shapes agree they are taken for whole frames of one camera, whose distortion is fitted.
    A reference of several follow-ups is best prepared once. Without the total ``psf``, one of 0.65
    px is assumed. A `RegistrationError` names the ways on.
    """
    hints = hints or RegistrationHints()
    if not isinstance(reference, RegistrationReference):
        reference = RegistrationReference.of(reference)
    photograph = AlignedPhotograph.of(followup, hints.left_out)
    refuse_contradiction(hints, photograph.shape)
    if not hints.mirrored:
        return _registered(reference, photograph, psf, hints, mirrored())
    hints = hints.with_columns_reversed(photograph.shape)
    return _registered(reference, photograph.mirrored(), psf, hints, not_mirrored()).mirrored()


def _registered(
    reference: RegistrationReference,
    photograph: AlignedPhotograph,
    psf: GaussianPsf | None,
    hints: RegistrationHints,
    of_mirror_image: RegistrationError,
) -> Registration:
    """Pose of a photograph that is not mirrored; an error where its mirror image agrees better."""
    pair = PhotographPair(reference=reference.photograph, followup=photograph, psf=psf)
    _refuse_without_detail(pair)
    given = list(given_poses(hints))
    best = best_of(pair, given)
    if best is not None and best.is_significant:
        # Of several periods the operator has chosen one.
        choice = Choice(best=best)
        return _refined(pair, choice, _refinement(pair, choice))
    if given:
        if best is None:
            raise RegistrationError(
                "at the given pose the photographs do not overlap; check its direction: it takes "
                "follow-up pixels to reference pixels",
                reason="little_overlap",
            )
        return _as_given(pair, best)
    # A follow-up's features are wanted several times, too.
    both = reference, RegistrationReference(photograph)
    glanced = best_of(pair, islice(_matched_poses(both, "quick", hints.zoom), 1))
    if glanced is not None and glanced.is_beyond_doubt:
        mirror_image = _mirror_image(pair, both, "quick", hints.zoom)
        if mirror_image.is_matched_better(glanced):
            raise of_mirror_image
        choice = with_rival(pair, glanced)
        refined = _refinement(pair, choice)
        if refined is not None:
            return _refined(pair, choice, refined)
    choice = _chosen(pair, both, hints.zoom, of_mirror_image)
    return _refined(pair, choice, _refinement(pair, choice))


def _chosen(
    pair: PhotographPair, both: Photographs, zoom: float | None, of_mirror_image: RegistrationError
) -> Choice:
    """The best of all hypotheses."""
    matched = chain.from_iterable(_matched_poses(both, look, zoom) for look in ("plain", "closer"))
    best = best_of(pair, matched)
    mirror_image = _mirror_image(pair, both, "plain", zoom)
    if mirror_image.is_matched_better(best):
        raise of_mirror_image
    searched = searched_poses(pair.reference, pair.followup, zoom)
    tilted = tilted_poses((pair.reference, pair.followup), mirror_image.features, zoom)
    best = best_of(pair, chain(searched, tilted), best)
    if mirror_image.is_searched_better(best):
        raise of_mirror_image
    if best is None or not best.is_significant:
        raise _not_found(best)
    return with_rival(pair, looked_again(pair, best))


def _mirror_image(
    pair: PhotographPair, both: Photographs, look: Look, zoom: float | None
) -> MirrorImage:
    return MirrorImage(pair, (both[0].features(look), both[1].features(look)), zoom)


def _matched_poses(both: Photographs, look: Look, zoom: float | None) -> Iterator[PoseHypothesis]:
    near, far = (one.features(look) for one in both)
    yield from feature_poses(near, far, zoom)


def _refuse_without_detail(pair: PhotographPair) -> None:
    if pair.reference.scale_dn == 0 or min(pair.reference.shape) < _SMALLEST_SIDE_PX:
        raise _no_detail("reference")
    if pair.followup.scale_dn == 0 or min(pair.followup.shape) < _SMALLEST_SIDE_PX:
        raise _no_detail("followup")


def _no_detail(role: str) -> RegistrationError:
    is_reference = role == "reference"
    return RegistrationError(
        f"{'the reference' if is_reference else 'the follow-up'} has no detail to align by; "
        "photograph something with more detail",
        reason="no_detail",
        at_fault="reference" if is_reference else "followup",
        count=0,
    )


def _not_found(best: Candidate | None) -> RegistrationError:
    if best is None:
        return RegistrationError(
            f"the photographs overlap too little to be aligned; {_REMEDIES}",
            reason="little_overlap",
        )
    agreement = best.agreement
    return RegistrationError(
        f"no pose was found at which the photographs agree (best correlation "
        f"{agreement.correlation:.2f}, {best.missing}): if they show the same thing, {_REMEDIES}",
        reason="low_correlation",
        correlation=agreement.correlation,
    )


def _refinement(pair: PhotographPair, choice: Choice) -> RefinedPose | None:
    """Refine the chosen pose down to single pixels."""
    directed = choice.best.directed
    return refined_pose(
        directed.photographs,
        directed.pose,
        pair.psf,
        directed.matches_of(choice.best.hypothesis),
        is_one_camera=pair.reference.shape == pair.followup.shape,
    )


def _refined(pair: PhotographPair, choice: Choice, found: RefinedPose | None) -> Registration:
    """The registration of a refined pose, or as it was given; an error where it may be wrong."""
    directed = choice.best.directed
    if found is None:
        return _as_given(pair, choice.best)
    is_weak = not (choice.best.is_well_matched or choice.best.hypothesis.is_given)
    if choice.rival is None and _is_elsewhere(choice.best, found.pose):
        raise RegistrationError(
            "the photographs agree best at a pose that misplaces many of their details; "
            f"{_REMEDIES}",
            reason="contradiction",
        )
    pose = directed.with_pose(found.pose).of_followup
    place_err_px = found.errors.place_err_px * (pose.zoom if directed.is_swapped else 1.0)
    if not place_err_px <= _PLACE_ERR_MAX_PX and pose.displacement is None:
        raise RegistrationError(
            f"the pose is uncertain by {place_err_px:.2f} px, but only {_PLACE_ERR_MAX_PX} px are "
            f"allowed; photograph more detail, or {_REMEDIES}",
            reason="uncertain",
            error_px=place_err_px,
        )
    warnings = []
    if choice.rival is not None:
        rival = choice.rival.directed.of_followup
        rows, cols = pair.followup.shape
        middle = np.array([(rows - 1) / 2]), np.array([(cols - 1) / 2])
        apart = np.hypot(
            *(
                a - b
                for a, b in zip(
                    pose.to_reference_px(*middle), rival.to_reference_px(*middle), strict=True
                )
            )
        )
        warnings.append(
            f"the scene repeats: shifted by {float(apart[0]):.0f} px the photographs agree nearly "
            "as well, so the alignment may be off by a period; check it, or " + _REMEDIES
        )
    if place_err_px > _PLACE_ERR_WARN_PX:
        warnings.append(f"the pose is uncertain by {place_err_px:.2f} px")
    look = second_look(directed) if is_weak else None
    aside_px = None if look is None else look.displacement_px(found.pose)
    if aside_px is not None and aside_px > _ASIDE_WARN_PX:
        warnings.append(
            f"matching details lie {aside_px:.1f} px from where the pose puts them: the scene is "
            "not quite flat, or the pose not quite right"
        )
    return _registration(choice.best.hypothesis, pose, found, place_err_px, directed, warnings)


def _is_elsewhere(best: Candidate, found: DistortedPose) -> bool:
    """Whether too much of the photographs is recognised elsewhere than a refined pose puts it."""
    if best.hypothesis.is_given or best.is_surely_matched:
        return False
    return block_votes(*best.directed.photographs, found).share_elsewhere > ELSEWHERE_MOST


def _registration(
    hypothesis: PoseHypothesis,
    pose: DistortedPose,
    found: RefinedPose,
    place_err_px: float,
    directed: DirectedPose,
    warnings: list[str],
) -> Registration:
    count, rms_px = 0, 0.0
    if hypothesis.matches is not None:
        apart = pose.distances_px(hypothesis.matches)
        agreeing = apart[apart < _INLIER_PX * max(pose.zoom, 1.0)]
        count = len(agreeing)
        rms_px = float(np.sqrt(np.mean(agreeing**2))) if count else 0.0
    return Registration(
        pose=pose,
        zoom=pose.zoom,
        place_err_px=place_err_px,
        k1_err=found.errors.k1_err,
        feature_matrix=hypothesis.matrix / hypothesis.matrix[2, 2],
        inlier_count=count,
        match_rms_px=rms_px,
        correlation=found.correlation,
        residual_rms_dn=found.residual_rms * directed.target.scale_dn,
        warnings=tuple(warnings),
    )


def _as_given(pair: PhotographPair, candidate: Candidate) -> Registration:
    """The pose of a hint or of matched features where the pixels do not refine it."""
    hypothesis = candidate.hypothesis
    pose = pair.pose_of(hypothesis.matrix)
    source = "given pose" if hypothesis.is_given else "pose of the matched features"
    text = (
        f"the {source} is kept as it is: the photographs do not agree well enough to refine it "
        f"(correlation {candidate.agreement.correlation:.2f})"
    )
    return Registration(
        pose=pose,
        zoom=pose.zoom,
        place_err_px=_GIVEN_ERR_PX,
        k1_err=0.0,
        feature_matrix=pose.matrix,
        inlier_count=0 if hypothesis.matches is None else len(hypothesis.matches.followup_px),
        match_rms_px=_match_rms_px(hypothesis),
        correlation=candidate.agreement.correlation,
        residual_rms_dn=candidate.directed.target.scale_dn,
        warnings=(text,),
    )


def _match_rms_px(hypothesis: PoseHypothesis) -> float:
    if hypothesis.matches is None:
        return 0.0
    every = np.ones(len(hypothesis.matches.followup_px), dtype=np.bool_)
    return hypothesis.matches.rms_px(hypothesis.matrix, every)
