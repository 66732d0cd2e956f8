"""Changes between two photographs that pose, blur and light do not explain."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from analysis.changes.chance import significance_threshold
from analysis.changes.change_list import list_changes
from analysis.changes.comparison import Comparison, compare
from analysis.changes.document import ChangeSummary
from analysis.changes.false_discovery import discovery_threshold
from analysis.changes.matching import PixelPositions, spline_coefficients
from analysis.changes.moved_changes import moved_apart
from analysis.changes.options import ChangeOptions
from analysis.changes.unusable import clipped_at_white
from analysis.changes.warning_sentences import ChangeMasks, change_warnings
from analysis.errors import AnalysisError
from calibration.notebook import html_table
from calibration.registration import DistortedPose, RegistrationHints, register
from simulation import Psf, PsfField
from simulation.arrays import AnyArray, BoolArray, Float32Array, FloatImage
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
        Difference over its standard deviation.
    is_change
        Where the significance exceeds the threshold in absolute value.
    valid
        Pixels that were compared.
    pose
        Position of every follow-up pixel in the reference.
    masks
        Changed, compared and clipped pixels.
    """

    summary: ChangeSummary
    followup_dn: FloatImage
    difference_dn: FloatImage
    plain_difference_dn: FloatImage
    pose_difference_dn: FloatImage
    variance_dn2: FloatImage
    significance: FloatImage
    is_change: BoolArray
    valid: BoolArray
    pose: DistortedPose
    masks: ChangeMasks

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
    maps = _Maps.of(compared, pose)
    threshold = _threshold(compared, maps, options)
    is_change = np.abs(maps.significance) > threshold
    listed = list_changes(compared, pose, threshold)
    apart = moved_apart(compared, pose, threshold, listed)
    changes, moved = apart.changes, apart.moved
    if options.count_moved:
        changes = tuple(sorted((*changes, *moved), key=lambda change: -change.significance))
        moved = ()
    masks = _masks(reference, followup, pose, options, (is_change, maps.valid))
    return ChangeResult(
        summary=ChangeSummary(
            homography=pose.matrix.tolist(),
            distortion_k1=pose.k1,
            distortion_k1_err=k1_err,
            zoom=pose.zoom,
            changed_px=int(is_change.sum()),
            compared_px=int(maps.valid.sum()),
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
            moved=moved,
            saturated_px=int(np.count_nonzero(masks.clipped | masks.reference_clipped)),
            kernel=compared.kernel,
            warnings=(*warnings, *compared.warnings, *change_warnings(changes, masks)),
        ),
        followup_dn=np.asarray(followup, dtype=np.float32),
        difference_dn=maps.difference_dn,
        plain_difference_dn=maps.plain_difference_dn,
        pose_difference_dn=maps.plain_difference_dn - maps.difference_dn,
        variance_dn2=maps.sd_dn**2,
        significance=maps.significance,
        is_change=is_change,
        valid=maps.valid,
        pose=pose,
        masks=masks,
    )


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _Maps:
    """Images of a comparison on the follow-up's pixels."""

    difference_dn: FloatImage
    plain_difference_dn: FloatImage
    sd_dn: FloatImage
    significance: FloatImage
    valid: BoolArray

    @classmethod
    def of(cls, compared: Comparison, pose: DistortedPose) -> "_Maps":
        """Bring the images there: they are smooth, and a spline does it."""
        valid = compared.valid
        images = [compared.difference_dn, compared.plain_difference_dn, compared.sd_dn,
                  compared.significance]  # fmt: skip
        if not compared.is_on_followup:
            positions = PixelPositions.of(
                pose.to_reference_px, pose.followup_shape, pose.reference_shape
            )
            valid = positions.inside(valid, 0.0)
            images = [_brought(image, positions, valid) for image in images]
        return cls(
            difference_dn=images[0],
            plain_difference_dn=images[1],
            sd_dn=images[2],
            significance=images[3],
            valid=valid,
        )


def _brought(image: FloatImage, positions: PixelPositions, valid: BoolArray) -> Float32Array:
    seen = positions.seen(spline_coefficients(np.asarray(image, dtype=np.float32), 0.0))
    return np.where(valid & np.isfinite(seen), seen, np.float32(0))


def _threshold(compared: Comparison, maps: _Maps, options: ChangeOptions) -> float:
    if options.false_discovery_rate is not None:
        return discovery_threshold(compared, options.false_discovery_rate)
    return significance_threshold(options.false_alarms / max(int(maps.valid.sum()), 1))


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
