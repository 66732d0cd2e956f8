"""Changes between two photographs that pose, blur and light do not explain."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from analysis.changes.chance import FilterWidth, significance_threshold
from analysis.changes.change_list import list_changes
from analysis.changes.comparison import Comparison, compare
from analysis.changes.detection_limit import LimitMaps, detection_limit
from analysis.changes.document import ChangeSummary
from analysis.changes.false_discovery import discovery_threshold
from analysis.changes.levels import detection_levels
from analysis.changes.linked_regions import link_levels
from analysis.changes.matching import PixelPositions, spline_coefficients
from analysis.changes.options import ChangeOptions
from analysis.changes.prediction import meet
from analysis.changes.unusable import clipped_at_white
from analysis.changes.warning_sentences import ChangeMasks, change_warnings
from analysis.errors import AnalysisError
from calibration.notebook import html_table
from calibration.registration import DistortedPose, RegistrationHints, register
from simulation import Psf, PsfField
from simulation.arrays import AnyArray, BoolArray, FloatImage
from simulation.pose import projection_depth

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_LISTED = ("x_px", "y_px", "area_px", "amplitude_dn", "significance", "q_value")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class ChangeResult:
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
    is_change
        Pixels of the changes.
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

    def plot(self) -> "Figure":
        """Return a figure of the follow-up with its changes, both differences, significance."""
        from analysis.changes.plot import changes_figure  # matplotlib, for whoever looks

        return changes_figure(self)


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
    pose, k1_err = options.pose, None
    warnings: tuple[str, ...] = ()
    if pose is None:
        hints = options.hints or RegistrationHints()
        if hints.left_out is None:
            hints = replace(hints, left_out=options.left_out)
        aligned = register(reference, followup, None if psf is None else psf.gaussian, hints)
        pose, k1_err, warnings = aligned.pose, aligned.k1_err, aligned.warnings
    _refuse_horizon(pose)
    compared = compare(reference, followup, psf, pose, options)
    grid = _FollowupGrid.of(compared, pose)
    compared_px = int(np.count_nonzero(grid.valid))
    false_share = options.false_alarms / max(compared_px, 1)
    levels = detection_levels(compared, false_share)
    widths = tuple(level.filter_width for level in levels)
    if options.false_discovery_rate is None:
        threshold = significance_threshold(false_share, widths)
    else:
        threshold = discovery_threshold(levels, options.false_discovery_rate)
    found = link_levels(levels, threshold)
    changes = list_changes(found.regions, levels, pose, is_on_followup=compared.is_on_followup)
    limits = LimitMaps.of(compared, levels, threshold, grid.followup_px)
    met = None if options.expected is None else meet(options.expected, pose.zoom, compared, limits)
    difference, plain, sd = map(
        grid.brought, (compared.difference_dn, compared.plain_difference_dn, compared.sd_dn)
    )
    is_change = grid.marked(found.is_change)
    masks = _masks(reference, followup, pose, options, (is_change, grid.valid))
    return ChangeResult(
        summary=ChangeSummary(
            homography=pose.matrix.tolist(),
            distortion_k1=pose.k1,
            distortion_k1_err=k1_err,
            zoom=pose.zoom,
            changed_px=int(np.count_nonzero(is_change)),
            compared_px=compared_px,
            threshold_sd=threshold,
            false_alarms_px=options.false_alarms,
            false_discovery_rate=options.false_discovery_rate,
            gain=compared.gain,
            extra_blur_px2=compared.extra_blur_px2,
            extra_blur_err_px2=compared.extra_blur_err_px2,
            noise_factor=compared.noise_factor,
            is_noise_known=options.noise is not None
            or any(one is not None for one in options.variance_dn2),
            registration_err_px=compared.registration_err_px,
            width_err_px2=compared.width_err_px2,
            psf_form=None if psf is None else psf.form,
            changes=changes,
            saturated_px=int(np.count_nonzero(masks.clipped | masks.reference_clipped)),
            kernel=compared.kernel,
            detection_limit=detection_limit(
                limits, options.spot_sigma_px, options.limit_contrast_dn
            ).model_copy(update={"predicted": met}),
            frame_px=grid.valid.size,
            warnings=(*warnings, *compared.warnings, *change_warnings(changes, masks)),
        ),
        followup_dn=np.asarray(followup, dtype=np.float32),
        difference_dn=difference,
        plain_difference_dn=plain,
        pose_difference_dn=plain - difference,
        variance_dn2=sd**2,
        significance=grid.brought(found.significance),
        limit_dn=grid.brought(limits.limit_dn(options.spot_sigma_px), np.nan),
        is_change=is_change,
        valid=grid.valid,
        pose=pose,
        masks=masks,
        filter_widths=widths,
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _FollowupGrid:
    """Brings images of a comparison to the follow-up's pixels.

    Parameters
    ----------
    positions
        Of the follow-up's pixels on the comparison's grid; None if they are the same.
    valid
        Follow-up pixels that were compared.
    followup_px
        Follow-up pixels to one of the grid, along a line.
    """

    positions: PixelPositions | None
    valid: BoolArray
    followup_px: float

    @classmethod
    def of(cls, compared: Comparison, pose: DistortedPose) -> "_FollowupGrid":
        """Find where the pixels of both lie."""
        if compared.is_on_followup:
            return cls(positions=None, valid=compared.valid, followup_px=1.0)
        positions = PixelPositions.of(
            pose.to_reference_px, pose.followup_shape, pose.reference_shape
        )
        valid = positions.inside(compared.valid, 0.0)
        return cls(positions=positions, valid=valid, followup_px=1 / positions.zoom)

    def brought(self, image: FloatImage, outside: float = 0.0) -> FloatImage:
        """Interpolate a smooth image; ``outside`` where it was not compared."""
        if self.positions is None:
            return np.where(self.valid, image, np.float32(outside))
        known = np.isfinite(image)
        # What is not known must not ring into what is.
        whole = np.where(known, image, np.float32(np.median(image[known])) if known.any() else 0)
        coefficients = spline_coefficients(np.asarray(whole, dtype=np.float32), 0.0)
        seen = self.positions.seen(coefficients)
        return np.where(self.valid & np.isfinite(seen), seen, np.float32(outside))

    def marked(self, mask: BoolArray) -> BoolArray:
        """Bring a mask."""
        return mask if self.positions is None else self.positions.inside(mask, 0.0)


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
