"""A chosen pose refined from coarse to fine, with as many degrees of freedom as it needs.

A homography as a rule; with the lens's distortion where whole frames of one camera determine it;
with a smooth displacement where that predicts parts of the frame to which it was not fitted.
"""

from dataclasses import dataclass, replace
from math import hypot, sqrt

import numpy as np

from calibration.registration.dense.agreement import comparison_factor, correlation_at
from calibration.registration.dense.bending import bend_of, bent
from calibration.registration.dense.level_pair import LevelPair
from calibration.registration.dense.motions import PoseMotions
from calibration.registration.dense.photograph import AlignedPhotograph
from calibration.registration.dense.place_errors import PlaceErrors, place_errors
from calibration.registration.dense.refinement import PoseDescent, Residuals
from calibration.registration.distorted_pose import DistortedPose
from calibration.registration.feature_matches import FeatureMatches
from simulation import GaussianPsf
from simulation.arrays import FloatArray

_SAMPLES = 60_000
"""Pixels compared: with the smoothing of 1 px, neighbours tell hardly anything new."""

_K1_SIGNIFICANT = 1.4
"""Standard errors from which a distortion is kept: from sqrt(2) on it predicts better than 0 does
(H. Akaike, "A new look at the statistical model identification", 1974)."""

_JUDGED_PX = 300_000
_CORRELATION_LOSS = 0.02
"""Of the locally normalised photographs: a descent that loses more went astray."""

_TRUSTED_MATCHES = 20
_STRAY = 1.3
_STRAY_PX = 0.1
"""So many features or more scatter about the true pose by at most 1.3 times what they scatter about
their own, and 0.1 px of the coarser photograph more; a descent that leaves them further behind was
drawn away by what is not in their plane. In nine simulated pairs 1.02 times at most, in a real one
that went astray 2 to 5 times."""

_NOISY = 1.1
"""Ratio of errors from which a finer resolution is left out."""

_UNMOVED_PX = 3.0
"""Largest motion of a follow-up in two levels that may be no motion: an edge of such a drawing lies
at a whole pixel, and all of an edge lies off together."""

_STEPS = 15
_BEND_ROUNDS = 3
_BEND_STEPS = 2
_STEPS_BETWEEN = 4
"""Of the homography, between changes of the displacement."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class RefinedPose:
    """A pose from the coarser photograph to the finer one, with its errors.

    ``correlation`` and ``residual_rms`` are of the coarser photograph with its prediction, after
    fitting the light, without outliers; in units of the photograph's prepared levels.
    """

    pose: DistortedPose
    errors: PlaceErrors
    correlation: float
    residual_rms: float


def refined_at(
    level: LevelPair,
    pose: DistortedPose,
    *,
    fits_distortion: bool = False,
    steps: int = _STEPS,
) -> tuple[PoseMotions, Residuals | None]:
    """Refine a pose at one resolution; None where nothing is in common."""
    motions = PoseMotions(
        level.y_px, level.x_px, level.target_shape, fits_distortion=fits_distortion
    )
    return motions, PoseDescent(level, motions).refined(pose, steps)


def refined_pose(
    photographs: tuple[AlignedPhotograph, AlignedPhotograph],
    start: DistortedPose,
    psf: GaussianPsf | None,
    matches: FeatureMatches | None = None,
    *,
    is_one_camera: bool,
) -> RefinedPose | None:
    """Refine a pose that is right at a coarse resolution; None where nothing is in common.

    Parameters
    ----------
    photographs
        The finer one, the source, and the coarser one, the target.
    start
        Target to source.
    psf
        Total PSF of the camera.
    matches
        Features of the target and of the source that agree with the start, if it is of features.
    is_one_camera
        Whether both are whole frames of one camera, whose distortion may be fitted.
    """
    factor = 2 * comparison_factor(start)
    best: RefinedPose | None = None
    pose = start
    while factor > 1:
        factor //= 2
        level = LevelPair(photographs, pose, psf, factor, _SAMPLES)
        found = _best_fit(level, pose, is_one_camera=is_one_camera)
        if found is None or strays(found.pose, start, matches):
            continue
        if not found.pose.zoom * factor < min(photographs[0].shape):
            continue  # went astray: one pixel of the target covers the source; or no number
        if _is_worse(photographs, found.pose, pose, factor):
            continue
        # Noise alone makes a finer resolution tell less; a scene that is not planar need not
        # scatter less there.
        most = _NOISY * best.errors.place_err_px if best is not None else np.inf
        if found.errors.place_err_px < most or found.pose.displacement is not None:
            best = found
        pose = best.pose if best is not None else pose
    if best is not None and is_one_camera and _may_be_unmoved(photographs, best.pose, psf):
        return replace(best, pose=_unmoved(best.pose))
    return best


def _unmoved(pose: DistortedPose) -> DistortedPose:
    return pose.with_(np.eye(3), 0.0)


def _may_be_unmoved(
    photographs: tuple[AlignedPhotograph, AlignedPhotograph],
    pose: DistortedPose,
    psf: GaussianPsf | None,
) -> bool:
    """Whether drawings in two levels agree no better at a pose than unmoved.

    A pose is fitted to either pair of opposite quarters of the frame and judged by the others.
    """
    source, target = photographs
    if not target.is_drawing:
        return False
    rows, cols = target.shape
    corners = np.array([0.0, 0.0, rows - 1, rows - 1]), np.array([0.0, cols - 1, 0.0, cols - 1])
    moved_px = np.hypot(
        *(a - b for a, b in zip(pose.to_reference_px(*corners), corners, strict=True))
    )
    if not moved_px.max() <= _UNMOVED_PX:
        return False
    y, x = np.mgrid[:rows, :cols]
    start = _unmoved(pose)
    quarters = (y < rows / 2) == (x < cols / 2)
    gained = 0.0
    for part in (quarters, ~quarters):
        fitted, judged = (target.where(one) for one in (part, ~part))
        found = start
        for factor in (2, 1):
            _, fit = refined_at(LevelPair((source, fitted), found, psf, factor, _SAMPLES), found)
            found = found if fit is None else fit.pose
        after, before = (correlation_at(source, judged, one, 1) for one in (found, start))
        gained += after - before
    return gained <= 0


def strays(found: DistortedPose, start: DistortedPose, matches: FeatureMatches | None) -> bool:
    """Whether a descent has left behind the matched features from which it started."""
    if matches is None or len(matches.followup_px) < _TRUSTED_MATCHES:
        return False
    after, before = (float(np.median(pose.distances_px(matches))) for pose in (found, start))
    return after > _STRAY * before + _STRAY_PX * start.zoom


def _is_worse(
    photographs: tuple[AlignedPhotograph, AlignedPhotograph],
    found: DistortedPose,
    start: DistortedPose,
    factor: int,
) -> bool:
    """Whether the photographs agree less at a pose than where its refinement started.

    In finer detail than it was refined by, as far as that costs little.
    """
    rows, cols = photographs[1].shape
    seen_at = max(factor // 2, 1)
    seen_at *= max(round(sqrt(rows * cols / seen_at**2 / _JUDGED_PX)), 1)
    after, before = (correlation_at(*photographs, pose, seen_at) for pose in (found, start))
    return after < before - _CORRELATION_LOSS


def _best_fit(level: LevelPair, pose: DistortedPose, *, is_one_camera: bool) -> RefinedPose | None:
    """Fit with a displacement or with the lens's distortion where the photographs tell of it."""
    if pose.displacement is not None:
        return _bent_fit(level, pose)
    fit = _unbent_fit(level, pose, is_one_camera=is_one_camera)
    if fit is None:
        return None
    made, found = fit
    return _bent_fit(level, made.pose) if bend_of(level, found).is_significant() else made


def _unbent_fit(
    level: LevelPair, pose: DistortedPose, *, is_one_camera: bool
) -> tuple[RefinedPose, Residuals] | None:
    if is_one_camera and pose.k1 != 0:
        lens = _distorted_fit(level, pose)
        if lens is not None:
            return lens
    straight = _fit(level, pose.with_(pose.matrix, 0.0), fits_distortion=False)
    if straight is None or not is_one_camera or pose.k1 != 0:
        return straight
    # What was fitted without a distortion is a nearer start, as it makes up for none.
    return _distorted_fit(level, straight[0].pose) or straight


def _distorted_fit(level: LevelPair, pose: DistortedPose) -> tuple[RefinedPose, Residuals] | None:
    """Fit with the lens's distortion; None where it does not stand out."""
    lens = _fit(level, pose, fits_distortion=True)
    if lens is None or not abs(lens[0].pose.k1) > _K1_SIGNIFICANT * lens[0].errors.k1_err:
        return None
    return lens


def _fit(
    level: LevelPair, pose: DistortedPose, *, fits_distortion: bool
) -> tuple[RefinedPose, Residuals] | None:
    motions, found = refined_at(level, pose, fits_distortion=fits_distortion)
    return None if found is None else (_with_errors(level, motions, found), found)


def _bent_fit(level: LevelPair, pose: DistortedPose) -> RefinedPose | None:
    """Fit the displacement and the homography in turns."""
    best: tuple[PoseMotions, Residuals] | None = None
    for _ in range(_BEND_ROUNDS):
        motions, found = refined_at(level, pose, steps=_STEPS_BETWEEN)
        if found is None or (best is not None and found.cost > best[1].cost):
            break
        best = motions, found
        pose = found.pose
        for _ in range(_BEND_STEPS):
            state = PoseDescent(level, motions).at(pose)
            if state is None:
                break
            pose = bent(pose, bend_of(level, state))
    if best is None:
        return None
    made = _with_errors(level, *best)
    own_px = bend_of(level, best[1]).place_err_px() * made.pose.zoom
    errors = replace(made.errors, place_err_px=hypot(made.errors.place_err_px, own_px))
    return replace(made, errors=errors)


def _with_errors(level: LevelPair, motions: PoseMotions, found: Residuals) -> RefinedPose:
    kept = found.inside & (np.abs(found.relative) < 1)
    measured, residual = level.measured[kept], found.residual[kept]
    offset = found.light_columns[kept, 6:12] @ found.light[6:12]
    return RefinedPose(
        pose=found.pose,
        errors=place_errors(level, motions, found),
        correlation=_correlation(measured - residual - offset, measured - offset),
        residual_rms=float(np.sqrt(np.mean(residual**2))),
    )


def _correlation(ours: FloatArray, theirs: FloatArray) -> float:
    return float(np.corrcoef(ours, theirs)[0, 1])
