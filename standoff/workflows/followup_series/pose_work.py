"""Poses of follow-ups: each is registered to the reference and judged."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from acquisition.printable import on_one_line
from analysis.choices import Criterion
from analysis.detectability import DetectabilityCurve
from analysis.errors import AnalysisError
from analysis.pose import JudgedFollowup, PoseQuality, judge_pose
from calibration.errors import CalibrationError
from calibration.registration import register
from simulation import GaussianPsf
from simulation.arrays import FloatArray
from standoff.photographs import Photograph
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
    """

    curve: DetectabilityCurve
    min_d_prime: float
    criterion: Criterion
    psf: GaussianPsf | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RegisteredPose:
    """A verdict on a pose, and how well the photographs agreed on it."""

    quality: PoseQuality
    correlation: float


def judged_pose(
    near: FloatArray, far: FloatArray, demand: PoseDemand, followup: Path
) -> RegisteredPose:
    """Register the grey levels of two photographs and judge the pose; errors name the follow-up.

    Raises
    ------
    AnalysisError, CalibrationError
        If they cannot be registered, or the pose not be judged.
    """
    sizes = (far.shape[1], far.shape[0]), (near.shape[1], near.shape[0])
    try:
        found = register(near, far, demand.psf)
        quality = judge_pose(
            found.matrix, *sizes, demand.curve, demand.min_d_prime, demand.criterion
        )
    except CalibrationError as error:
        raise CalibrationError(f"{followup}: {error}") from error
    except AnalysisError as error:
        raise AnalysisError(f"{followup}: {error}") from error
    return RegisteredPose(quality=quality, correlation=found.correlation)


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
        }

    def find(self, near: FloatArray, photograph: Photograph) -> RegisteredPose:
        """Judge one follow-up."""
        return judged_pose(near, photograph.grey_dn, self.demand, photograph.path)

    def write(self, photograph: Photograph, found: RegisteredPose) -> Written:
        """Return the verdict; there is nothing but the commit to write."""
        name, quality = on_one_line(photograph.path), found.quality
        judged = quality.summary.model_copy(update={"registration_correlation": found.correlation})
        notes = {}
        if quality.beyond_curve:
            notes["beyond"] = f"{name}: {beyond_curve_sentence(quality)}"
        row = JudgedFollowup.of(name, photograph.sha256, judged)
        return Written(row=row.model_dump(mode="json"), notes=notes)


def beyond_curve_sentence(quality: PoseQuality) -> str:
    """Say how much of the overlap the curve does not reach."""
    return (
        f"{100 * quality.beyond_curve:.0f} % of the overlap lies beyond the curve's zoom of "
        f"{quality.curve.zoom[-1]:g}; its d' is taken as 0"
    )
