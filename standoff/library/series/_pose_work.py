"""Poses of follow-ups: each is registered to the reference and judged."""

import os
from dataclasses import dataclass, replace
from functools import lru_cache
from math import hypot, sqrt
from typing import TYPE_CHECKING, Any

from acquisition.files import FIGURES, Provenance
from acquisition.photographs import Photograph, ReadOptions
from acquisition.printable import on_one_line
from analysis.changes import ChangeOptions
from analysis.choices import Criterion
from analysis.detectability import STATED, CurveChoice, DetectabilityCurve
from analysis.detection_limits import DetectionLimit
from analysis.errors import AnalysisError
from analysis.followup_series import FollowupWork, Written
from analysis.pose import (
    JudgedFollowup,
    PoseDecision,
    PoseParallax,
    PoseQuality,
    PoseSummary,
    parallax_cost,
    pose_quality,
    quality_with_depth,
)
from analysis.reports import plot_pose, write_figure
from calibration.errors import CalibrationError
from calibration.registration import (
    DistortedPose,
    RegistrationHints,
    RegistrationReference,
    leaving_out,
    register_images,
)
from simulation import GaussianPsf
from simulation.arguments import checked
from simulation.by_value import ByValue
from simulation.notebook import Shown
from standoff.library.call import Call, FilePath, ImageLike, Progress, PsfLike, output_path
from standoff.library.changes import ComparisonRules, compared
from standoff.library.detectability import CurveLike, given_curve
from standoff.library.psf import camera_psf
from standoff.library.registration import AlignmentHints, hint_files, hint_settings
from standoff.library.swept_photographs import refusing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseDemand:
    """What a pose must allow.

    Parameters
    ----------
    curve
        d' against zoom.
    min_d_prime, criterion
        Threshold of d', and in how much of the overlap d' must reach it.
    psf
        The camera's PSF, for a finer registration.
    hints
        What the operator knows of the pose.
    """

    curve: DetectabilityCurve
    min_d_prime: float
    criterion: Criterion
    psf: GaussianPsf | None
    hints: AlignmentHints | RegistrationHints | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, repr=False)
class JudgedPose(Shown, ByValue):
    """A verdict on a pose, how well the photographs agreed on that pose, and what to check.

    ``pose`` is the result of the registration, ``place_err_px`` the standard error of a position by
    it, in reference pixels. ``detection_limit`` is what a comparison of the two
    photographs would have found; None if no comparison was made. ``parallax`` is what the depth of
    the scene costs; None where a plane explains the photographs, or was asked for.
    """

    quality: PoseQuality
    followup: Photograph
    pose: DistortedPose
    correlation: float
    place_err_px: float
    detection_limit: DetectionLimit | None = None
    parallax: PoseParallax | None = None
    warnings: tuple[str, ...] = ()
    provenance: Provenance | None = None
    notes: tuple[str, ...] = ()

    def __repr__(self) -> str:
        return f"<JudgedPose: {repr(self.quality).removeprefix('<PoseQuality: ')}"

    def _repr_html_(self) -> str:
        return self.summary._repr_html_()

    @property
    def is_accepted(self) -> bool:
        """Whether d' reaches the threshold."""
        return self.quality.is_accepted

    @property
    def decision(self) -> PoseDecision:
        """The verdict, go, no go or unsure, with its probability and what decides it."""
        return self.quality.decision

    @property
    def summary(self) -> PoseSummary:
        """The verdict in figures."""
        return self.quality.summary.model_copy(
            update={
                "registration_correlation": self.correlation,
                "warnings": self.warnings,
                "detection_limit": self.detection_limit,
                "parallax": self.parallax,
                "provenance": self.provenance,
            }
        )

    def to_json(self, picture: FilePath | None = None) -> dict[str, Any]:
        """Return the verdict as ``standoff pose --json`` prints it; ``picture`` names its map."""
        shown = None if picture is None else os.fspath(picture)
        return self.summary.model_copy(update={"picture": shown}).model_dump(mode="json")

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return a map of d' over the follow-up."""
        said = None if self.parallax is None else self.parallax.short_sentence
        return plot_pose(self.followup.shown_dn, self.quality, ax, said)

    def write_picture(self, path: FilePath) -> None:
        """Write the map of d', PNG or SVG.

        Raises
        ------
        ApplicationError
            If the file cannot be written.
        """
        write_figure(output_path(path, "path", FIGURES), self.plot())


@checked
def judge_pose(
    reference: ImageLike,
    followup: ImageLike,
    curve: CurveLike,
    min_d_prime: float,
    *,
    choice: CurveChoice | None = None,
    criterion: Criterion = "min",
    psf: PsfLike | None = None,
    hints: AlignmentHints | RegistrationHints | None = None,
    focus_scatter_px2: float | None = None,
    white_level: float | None = None,
    flat: bool = False,
    reading: ReadOptions | None = None,
    progress: Progress | None = None,
) -> JudgedPose:
    """Accept or reject a follow-up's pose by the d' that it allows over the frame.

    Parameters
    ----------
    reference, followup
        The earlier, nearer photograph, and the one whose pose is judged: arrays or files.
    curve
        Curves of ``d_prime_curves`` or one of them, or the path of a curves.json or an
        evaluation.json.
    min_d_prime
        Threshold of d'; 2 corresponds to an AUC of 0.92.
    choice
        Selects one curve, if there are several.
    criterion
        Where d' must reach the threshold: ``min``: everywhere in the overlap; ``quantile``: in all
        but 5 % of it.
    psf
        The camera's PSF, for a finer registration.
    hints
        What is known of the pose beforehand, as in ``find_changes``.
    focus_scatter_px2
        Standard deviation of the PSF's variance from capture to capture, instead of the curve's.
    white_level
        Level at which both are clipped, as in ``find_changes``.
    flat
        Whether the scene is taken as a plane; by default parallax of a scene with depth is looked
        for as in ``find_changes``, and what it hides is not judged.
    reading
        How files are read; see ``standoff.reading``.
    progress
        Shows the progress of the call, see `Progress`; by default nothing is shown.

    Returns
    -------
    JudgedPose
        ``quality`` holds the verdict and d' over the frame, ``decision`` how sure the verdict is,
        and ``summary`` the figures, with the detection limit of the two photographs if they could
        be compared.

    Raises
    ------
    ArgumentError
        If not exactly one curve is selected, or the threshold is not positive.
    AnalysisError, CalibrationError
        If the two cannot be registered, or the pose cannot be judged.
    HintError
        If a hint does not fit the photographs.

    Examples
    --------
    >>> standoff.judge_pose("before.tif", "after.tif", "curves.json", 2).is_accepted
    True
    """
    files = curve, psf, *hint_files(hints)
    call = Call("judge_pose", progress, reading, files, white_level)
    demand = PoseDemand(
        curve=given_curve(curve, min_d_prime, choice, focus_scatter_px2),
        min_d_prime=min_d_prime,
        criterion=criterion,
        psf=registration_psf(call, psf),
        hints=hints,
    )
    near = call.photograph(reference, "reference")
    judged = judged_pose(near, call.photograph(followup, "followup"), demand)
    found = _as_compared(call, near, judged, demand, is_flat=flat)
    for warning in found.warnings:
        call.announce(warning)
    if found.quality.beyond_curve:
        call.note(found.quality.beyond_curve_sentence)
    return replace(found, provenance=call.provenance(), notes=call.notes)


def _as_compared(
    call: Call, near: Photograph, judged: JudgedPose, demand: PoseDemand, *, is_flat: bool
) -> JudgedPose:
    """Compare the photographs; keep what would have been found, and what the depth costs."""
    options = ChangeOptions(pose=judged.pose, flat=is_flat)
    rules = ComparisonRules(options=options, hints=demand.hints)
    try:
        found = compared(near, judged.followup, None, rules)
    except AnalysisError as error:
        call.note(f"no detection limit: {error}")
        return judged
    judged = replace(judged, detection_limit=found.summary.detection_limit)
    seen, figures = found.parallax, found.summary.parallax
    if seen is None or figures is None:
        return judged
    cost = parallax_cost(found.pose, seen, figures)
    place_err_px = hypot(judged.place_err_px, cost.figures.place_err_px)
    curve = demand.curve.knowing(registration_err_px=place_err_px / sqrt(2))
    quality = quality_with_depth(judged.quality, curve, cost)
    return replace(judged, quality=quality, parallax=cost.figures)


def registration_psf(call: Call, psf: PsfLike | None) -> GaussianPsf | None:
    """Return the PSF that a registration takes, if the camera's is known."""
    return None if psf is None else camera_psf(call, psf).gaussian


def judged_pose(near: Photograph, far: Photograph, demand: PoseDemand) -> JudgedPose:
    """Register two photographs and judge the pose; errors name the follow-up.

    Raises
    ------
    AnalysisError, CalibrationError
        If they cannot be registered, or the pose cannot be judged.
    HintError
        If a hint does not fit the photographs.
    """
    shapes = near.stored.shape[:2], far.stored.shape[:2]
    (near_rows, near_cols), (rows, cols) = shapes
    hints = demand.hints
    if isinstance(hints, AlignmentHints):
        hints = hints.of_pair(*shapes, far.name)
    try:
        found = register_images(
            _prepared(near), far.filled.grey_dn, demand.psf, leaving_out(hints, far.masked)
        )
        quality = pose_quality(
            # Of the whole pose, with the lens's distortion and the scene's departure from a plane.
            found.pose.nearest_homography(),
            (cols, rows),
            (near_cols, near_rows),
            demand.curve.knowing(registration_err_px=found.place_err_px / sqrt(2)),
            demand.min_d_prime,
            demand.criterion,
        )
    except CalibrationError as error:
        raise CalibrationError(f"{far.path}: {error}") from error
    except AnalysisError as error:
        raise AnalysisError(f"{far.path}: {error}") from error
    return JudgedPose(
        quality=quality,
        followup=far,
        pose=found.pose,
        correlation=found.correlation,
        place_err_px=found.place_err_px,
        warnings=found.warnings,
    )


@lru_cache(maxsize=1)
def _prepared(near: Photograph) -> RegistrationReference:
    """Return the reference prepared once, where all follow-ups share it."""
    return RegistrationReference.of(near.filled.grey_dn, near.masked)


@dataclass(frozen=True, kw_only=True)
class PoseWork(FollowupWork[JudgedPose]):
    """Judges the poses of follow-ups by one curve."""

    listed = JudgedFollowup

    demand: PoseDemand

    @property
    def settings(self) -> dict[str, Any]:
        """Settings of the work, without the contents of curves.json and psf.json."""
        return {
            "command": "pose",
            "min_dprime": self.demand.min_d_prime,
            "criterion": self.demand.criterion,
            "curve": self.demand.curve.choice.model_dump(),
            "hints": hint_settings(self.demand.hints),
            **self._focus,
        }

    @property
    def _focus(self) -> dict[str, Any]:
        """The scatter of the focus, where it is not the curves' own."""
        uncertainty = self.demand.curve.uncertainty
        if uncertainty is None or uncertainty.sources.focus_from != STATED:
            return {}
        return {"focus_scatter_px2": uncertainty.sources.focus_scatter_px2}

    def find(self, near: Photograph, photograph: Photograph) -> JudgedPose:
        """Judge one follow-up."""
        with refusing():
            return judged_pose(near, photograph, self.demand)

    def write(self, photograph: Photograph, found: JudgedPose) -> Written:
        """Return the verdict; a pose has no files of its own to write."""
        name, quality = on_one_line(photograph.path), found.quality
        notes = {f"warning {k}": f"{name}: {text}" for k, text in enumerate(found.warnings)}
        if quality.beyond_curve:
            notes["beyond"] = f"{name}: {quality.beyond_curve_sentence}"
        row = JudgedFollowup.of(name, photograph.sha256, found.summary)
        return Written(row=row.model_dump(mode="json"), notes=notes)
