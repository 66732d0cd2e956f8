"""Changes between two photographs that pose, blur and light do not explain."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from analysis.changes.change_list import list_changes
from analysis.changes.comparison import Comparison, compare
from analysis.changes.detection import (
    FilterWidth,
    FoundChanges,
    LimitMaps,
    detection_levels,
    detection_limit,
    discovery_threshold,
    link_levels,
    pixels_of,
    significance_threshold,
)
from analysis.changes.document import ChangeSummary
from analysis.changes.followup_grid import FollowupGrid
from analysis.changes.least import large_enough
from analysis.changes.matching import PixelPositions, RelativeBlur
from analysis.changes.moved_changes import ToldApart, moved_apart
from analysis.changes.one_view import nearest_shift, one_view, view_rather
from analysis.changes.options import ChangeOptions, CodedAlike
from analysis.changes.prediction import meet
from analysis.changes.things import as_things
from analysis.changes.unusable import clipped_at_white
from analysis.changes.warning_sentences import ChangeMasks, change_warnings
from analysis.errors import AnalysisError
from calibration.registration import (
    DistortedPose,
    RegistrationHints,
    RegistrationReference,
    register,
)
from simulation import GaussianPsf, Psf, PsfField
from simulation.arrays import AnyArray, BoolArray, FloatImage
from simulation.by_value import ByValue
from simulation.notebook import html_table
from simulation.pose import projection_depth

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_LISTED = ("x_px", "y_px", "area_px", "amplitude_dn", "significance", "q_value")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class ChangeResult(ByValue):
    """Images on the follow-up's pixels, shape ``(rows, cols)`` each; 0 where not ``valid``.

    Parameters
    ----------
    summary
        What the comparison found, in figures.
    followup_dn
        The follow-up itself.
    difference_dn
        After minus before, pose, blur and light explained, at the sharpness of the blurrier
        photograph and in the follow-up's levels; smoothed, as are the others.
    plain_difference_dn
        The same with the nearer photograph merely resampled, in the same light.
    pose_difference_dn
        The part of the plain difference that the pose explains.
    variance_dn2
        Variance of the difference.
    significance
        Difference over its standard deviation, behind the width of filter at which it stands out
        most.
    limit_dn
        Amplitude at which a spot would have been found; NaN where not compared.
    is_change, is_moved
        Pixels of the changes, and of what moved.
    valid
        Pixels that were compared.
    pose
        Position of every follow-up pixel in the reference.
    masks
        Changed, compared and clipped pixels.
    filter_widths
        Behind which changes were looked for, in pixels of the coarser photograph.
    """

    summary: ChangeSummary
    followup_dn: FloatImage
    difference_dn: FloatImage
    plain_difference_dn: FloatImage
    pose_difference_dn: FloatImage
    variance_dn2: FloatImage
    significance: FloatImage
    limit_dn: FloatImage
    is_change: BoolArray
    is_moved: BoolArray
    valid: BoolArray
    pose: DistortedPose
    masks: ChangeMasks
    filter_widths: tuple[FilterWidth, ...]

    def __repr__(self) -> str:
        found = self.summary
        return (
            f"<ChangeResult: {len(found.changes)} changes, {found.changed_px} of "
            f"{found.compared_px} px beyond {found.threshold_sd:.2f} standard deviations, "
            f"zoom {found.zoom:.3f}>"
        )

    def _repr_html_(self) -> str:
        rows = [
            [str(number), *(f"{getattr(change, name):.4g}" for name in _LISTED)]
            for number, change in enumerate(self.summary.changes, 1)
        ]
        return html_table(repr(self)[1:-1], ("", *_LISTED), rows)

    def plot(self, ax: "Axes | None" = None) -> "Figure":
        """Return a figure of the follow-up with its changes, both differences, significance."""
        from analysis.changes.plot import changes_figure  # matplotlib, for whoever looks

        return changes_figure(self, ax=ax)


def find_changes(
    reference: AnyArray,
    followup: AnyArray,
    psf: Psf | PsfField | None = None,
    options: ChangeOptions | None = None,
) -> ChangeResult:
    """Find changes between two photographs that pose, blur and light do not explain.

    Parameters
    ----------
    reference, followup
        Grey, shape ``(rows, cols)``; the follow-up is the later one, nearer or further away.
    psf
        Total PSF of the camera that took both, if it is known: the blur between them is then
        compared with what it says.
    options
        Pose, noise, masks and allowed false alarms, if not the defaults.

    Raises
    ------
    RegistrationError
        If no pose is given and the two cannot be aligned.
    OverlapError
        If the images share too little.
    AnalysisError
        If the pose is not that of a plane in front of the camera.
    """
    options = options or ChangeOptions()
    aligned = _aligned(reference, followup, psf, options)
    pose, options = aligned.pose, replace(options, colours=aligned.given.colours)
    compared = compare(*aligned.given.photographs, psf, pose, options, aligned.blur)
    grid = FollowupGrid.of(compared, pose)
    detected = _Detected.of(compared, grid, pose, options)
    difference, plain, sd = map(
        grid.brought, (compared.difference_dn, compared.plain_difference_dn, compared.sd_dn)
    )
    is_change, is_moved = (
        grid.marked(pixels_of(regions, compared.valid.shape))
        for regions in (detected.apart.changed_regions, detected.apart.moved_regions)
    )
    masks = _masks(reference, followup, pose, options, (is_change, grid.valid))
    known = options.noise is not None or any(one is not None for one in options.variance_dn2)
    summary = detected.summary(compared, masks, options).model_copy(
        update={
            "distortion_k1_err": aligned.k1_err,
            "is_noise_known": known,
            "psf_form": None if psf is None else psf.form,
            "moved_px": int(np.count_nonzero(is_moved)),
            "warnings": (
                *aligned.warnings,
                *compared.warnings,
                *change_warnings(detected.apart.changes, masks),
            ),
        }
    )
    return ChangeResult(
        summary=summary,
        followup_dn=np.asarray(followup, dtype=np.float32),
        difference_dn=difference,
        plain_difference_dn=plain,
        pose_difference_dn=plain - difference,
        variance_dn2=sd**2,
        significance=grid.brought(detected.found.significance),
        limit_dn=grid.brought(detected.limits.limit_dn(options.spot_sigma_px), np.nan),
        is_change=is_change,
        is_moved=is_moved,
        valid=grid.valid,
        pose=pose,
        masks=masks,
        filter_widths=detected.widths,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class _Alignment:
    """A pose, the photographs, the error of its distortion if that was fitted, and what to check.

    Of one view the blur is known already, and the photographs are as files that are coded alike
    have them, in their colours too.
    """

    pose: DistortedPose
    given: CodedAlike
    blur: RelativeBlur | None = None
    k1_err: float | None = None
    warnings: tuple[str, ...] = ()


def _aligned(
    reference: AnyArray, followup: AnyArray, psf: Psf | PsfField | None, options: ChangeOptions
) -> _Alignment:
    """The pose that is given, or found."""
    given = CodedAlike(photographs=(reference, followup), colours=options.colours)
    if options.pose is not None:
        found = _Alignment(pose=options.pose, given=given)
    else:
        found = _found(given, None if psf is None else psf.gaussian, options)
    _refuse_horizon(found.pose)
    return found


def _found(given: CodedAlike, psf: GaussianPsf | None, options: ChangeOptions) -> _Alignment:
    """One view, before anything is aligned, or the pose of two; or one view after all."""
    reference, followup = given.photographs
    alike = None
    is_open = options.hints is None or not options.hints.is_of_pose
    if is_open and np.shape(reference) == np.shape(followup):
        alike = given if options.coded_alike is None else options.coded_alike()
        view = one_view(*alike.photographs, options)
        if view is not None:
            return _Alignment(pose=view.pose, given=alike, blur=view.blur)
    hints = options.hints or RegistrationHints()
    if hints.left_out is None:
        hints = replace(hints, left_out=options.left_out)
    near = RegistrationReference.of(reference, options.reference_left_out)
    made = register(near, followup, psf, hints)
    shift = nearest_shift(made.pose)
    view = None if shift is None else one_view(reference, followup, options, shift)
    if view is not None:
        return _Alignment(pose=view.pose, given=given, blur=view.blur, warnings=made.warnings)
    if alike is not None:
        view = view_rather(*alike.photographs, options, made.pose)
        if view is not None:
            return _Alignment(pose=view.pose, given=alike, blur=view.blur)
    return _Alignment(pose=made.pose, given=given, k1_err=made.k1_err, warnings=made.warnings)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Detected:
    """What stands out of a comparison, and what would have.

    Parameters
    ----------
    pose
        Of the follow-up in the reference.
    compared_px, frame_px
        Follow-up pixels that were compared, and all.
    widths, threshold_sd
        Of the filters, and their common threshold.
    found, apart, below_least
        All that exceeds it; changes and movements in it; and how many are too small to be listed.
    limits
        Of detection.
    """

    pose: DistortedPose
    compared_px: int
    frame_px: int
    widths: tuple[FilterWidth, ...]
    threshold_sd: float
    found: FoundChanges
    apart: ToldApart
    below_least: int
    limits: LimitMaps

    @classmethod
    def of(
        cls, compared: Comparison, grid: FollowupGrid, pose: DistortedPose, options: ChangeOptions
    ) -> "_Detected":
        """Look for changes at all widths."""
        compared_px = int(np.count_nonzero(grid.valid))
        false_share = options.false_alarms / max(compared_px, 1)
        levels = detection_levels(compared, false_share)
        widths = tuple(level.filter_width for level in levels)
        if options.false_discovery_rate is None:
            threshold = significance_threshold(false_share, widths)
        else:
            threshold = discovery_threshold(levels, options.false_discovery_rate)
        found = link_levels(levels, threshold)
        every = list_changes(found.regions, levels, compared, pose)
        kept = large_enough(every, options, compared.gain)
        regions = [found.regions[index] for index in np.flatnonzero(kept).tolist()]
        listed = [every[index] for index in np.flatnonzero(kept).tolist()]
        moved = moved_apart(compared, pose, regions, listed)
        apart = as_things(moved, compared, options.colours)
        if options.count_moved:
            apart = apart.together()
        return cls(
            pose=pose,
            compared_px=compared_px,
            frame_px=grid.valid.size,
            widths=widths,
            threshold_sd=threshold,
            found=found,
            apart=apart,
            below_least=len(every) - len(listed),
            limits=LimitMaps.of(compared, levels, threshold, grid.followup_px, options.limit_rgb),
        )

    def summary(
        self, compared: Comparison, masks: ChangeMasks, options: ChangeOptions
    ) -> ChangeSummary:
        """Return it in figures; what only the caller knows is left open."""
        limit = detection_limit(self.limits, options.spot_sigma_px, options.limit_contrast_dn)
        if options.expected is not None:
            met = meet(options.expected, self.pose.zoom, compared, self.limits)
            limit = limit.model_copy(update={"predicted": met})
        return ChangeSummary(
            homography=self.pose.matrix.tolist(),
            distortion_k1=self.pose.k1,
            distortion_k1_err=None,
            zoom=self.pose.zoom,
            changed_px=int(np.count_nonzero(masks.is_change)),
            compared_px=self.compared_px,
            threshold_sd=self.threshold_sd,
            false_alarms_px=options.false_alarms,
            false_discovery_rate=options.false_discovery_rate,
            gain=compared.gain,
            gain_err=compared.gain_err,
            extra_blur_px2=compared.extra_blur_px2,
            extra_blur_err_px2=compared.extra_blur_err_px2,
            noise_factor=compared.noise_factor,
            is_noise_known=False,
            registration_err_px=compared.registration_err_px,
            width_err_px2=compared.width_err_px2,
            changes=self.apart.changes,
            moved=self.apart.moved,
            least_dn=options.least_dn,
            below_least=self.below_least,
            saturated_px=int(np.count_nonzero(masks.clipped | masks.reference_clipped)),
            kernel=compared.kernel,
            detection_limit=limit,
            frame_px=self.frame_px,
        )


def _masks(
    reference: AnyArray,
    followup: AnyArray,
    pose: DistortedPose,
    options: ChangeOptions,
    found: tuple[BoolArray, BoolArray],
) -> ChangeMasks:
    before, after = (
        clipped_at_white(np.asarray(image, dtype=np.float32), white)
        for image, white in zip((reference, followup), options.white_level_dn, strict=True)
    )
    positions = PixelPositions.of(pose.to_reference_px, pose.followup_shape, pose.reference_shape)
    return ChangeMasks(
        is_change=found[0],
        valid=found[1],
        clipped=after,
        reference_clipped=positions.inside(before, 0.0) if before.any() else np.zeros_like(after),
    )


def _refuse_horizon(pose: DistortedPose) -> None:
    rows, cols = pose.followup_shape
    x, y = np.array([0.0, cols, 0.0, cols]) - 0.5, np.array([0.0, 0.0, rows, rows]) - 0.5
    depth = projection_depth(pose.matrix, x, y)
    if not (np.isfinite(depth).all() and (depth > 0).all() | (depth < 0).all()):
        raise AnalysisError(
            "the pose is not that of a plane in front of the camera: the plane's horizon is in the "
            "follow-up"
        )
