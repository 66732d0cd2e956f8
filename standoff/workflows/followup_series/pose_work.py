"""Poses of follow-ups: each is registered to the reference and judged."""

from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

from acquisition.printable import on_one_line
from analysis.choices import Criterion
from analysis.detectability import DetectabilityCurve
from analysis.errors import AnalysisError
from analysis.pose import JudgedFollowup, PoseQuality, PoseSummary, judge_pose
from calibration.errors import CalibrationError
from calibration.registration import RegistrationReference, register
from simulation import GaussianPsf
from standoff.photographs import Photograph
from standoff.workflows.comparison import AlignmentHints
from standoff.workflows.followup_series.work import FollowupWork, Written


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseDemand:
    """What a pose must allow.

    Parameters
    ----------
    curve
        d' against zoom.
    min_d_prime, criterion
        Threshold, and where d' must reach it.
    psf
        Of the camera, for a finer registration.
    hints
        What the operator knows of the pose.
    """

    curve: DetectabilityCurve
    min_d_prime: float
    criterion: Criterion
    psf: GaussianPsf | None
    hints: AlignmentHints = field(default_factory=AlignmentHints)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RegisteredPose:
    """A verdict on a pose, how well the photographs agreed on it, and what to check."""

    quality: PoseQuality
    correlation: float
    warnings: tuple[str, ...] = ()

    @property
    def summary(self) -> PoseSummary:
        """The verdict in figures."""
        return self.quality.summary.model_copy(
            update={
                "registration_correlation": self.correlation,
                "warnings": self.warnings,
            }
        )


def judged_pose(near: Photograph, far: Photograph, demand: PoseDemand) -> RegisteredPose:
    """Register two photographs and judge the pose; errors name the follow-up.

    Raises
    ------
    AnalysisError, CalibrationError
        If they cannot be registered, or the pose not be judged.
    HintError
        If a hint does not belong to them.
    """
    shapes = near.stored.shape[:2], far.stored.shape[:2]
    (near_rows, near_cols), (rows, cols) = shapes
    hints = demand.hints.of_pair(*shapes, far.name)
    try:
        found = register(_prepared(near), far.grey_dn, demand.psf, hints)
        quality = judge_pose(
            # Of the whole pose, with the lens's distortion and the scene's departure from a plane.
            found.pose.nearest_homography(),
            (cols, rows),
            (near_cols, near_rows),
            demand.curve,
            demand.min_d_prime,
            demand.criterion,
        )
    except CalibrationError as error:
        raise CalibrationError(f"{far.path}: {error}") from error
    except AnalysisError as error:
        raise AnalysisError(f"{far.path}: {error}") from error
    return RegisteredPose(quality=quality, correlation=found.correlation, warnings=found.warnings)


@lru_cache(maxsize=1)
def _prepared(near: Photograph) -> RegistrationReference:
    """Return the reference prepared once, where all follow-ups share it."""
    return RegistrationReference.of(near.grey_dn)


@dataclass(frozen=True, kw_only=True)
class PoseWork(FollowupWork[RegisteredPose]):
    """Judges the poses of follow-ups by one curve."""

    listed = JudgedFollowup

    demand: PoseDemand

    @property
    def settings(self) -> dict[str, Any]:
        """What is done, apart from the contents of curves.json and psf.json."""
        return {
            "command": "pose",
            "min_dprime": self.demand.min_d_prime,
            "criterion": self.demand.criterion,
            "curve": self.demand.curve.choice.model_dump(),
            "hints": self.demand.hints.settings,
        }

    def find(self, near: Photograph, photograph: Photograph) -> RegisteredPose:
        """Judge one follow-up."""
        return judged_pose(near, photograph, self.demand)

    def write(self, photograph: Photograph, found: RegisteredPose) -> Written:
        """Return the verdict; there is nothing but the commit to write."""
        name, quality = on_one_line(photograph.path), found.quality
        notes = {f"warning {k}": f"{name}: {text}" for k, text in enumerate(found.warnings)}
        if quality.beyond_curve:
            notes["beyond"] = f"{name}: {beyond_curve_sentence(quality)}"
        row = JudgedFollowup.of(name, photograph.sha256, found.summary)
        return Written(row=row.model_dump(mode="json"), notes=notes)


def beyond_curve_sentence(quality: PoseQuality) -> str:
    """Say how much of the overlap the curve does not reach."""
    return (
        f"{100 * quality.beyond_curve:.0f} % of the overlap lies beyond the curve's zoom of "
        f"{quality.curve.zoom[-1]:g}; its d' is taken as 0"
    )
