"""Changes between two photographs that pose, blur and light do not explain."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from analysis.changes._change_list import large_enough, list_changes
from analysis.changes._comparison import Comparison, compare
from analysis.changes._depth import ParallaxMap, with_depth
from analysis.changes._document import Change, ChangeSummary
from analysis.changes._ends import clipped_at_white, is_of_two_levels
from analysis.changes._levels import LimitMaps, detection_levels, detection_limit
from analysis.changes._photograph_pair import (
    ChangeOptions,
    CodedAlike,
    nearest_shift,
    one_view,
    positions_of,
    view_rather,
)
from analysis.changes._prediction import meet
from analysis.changes._regions import (
    FoundChanges,
    beyond_outlines,
    discovery_threshold,
    link_levels,
    pixels_of,
)
from analysis.changes._significance import FilterWidth, significance_threshold
from analysis.changes._things import ToldApart, as_things, moved_apart
from analysis.changes.matching import PixelPositions, RelativeBlur, spline_coefficients
from analysis.errors import AnalysisError
from calibration.errors import RegistrationError
from calibration.registration import (
    DistortedPose,
    RegistrationHints,
    RegistrationReference,
    register_images,
)
from simulation import GaussianPsf, Psf, PsfField
from simulation.arrays import AnyArray, BoolArray, FloatImage
from simulation.by_value import ByValue
from simulation.notebook import html_table
from simulation.pose import projection_depth

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class _FollowupGrid:
    """Brings images of a comparison to the follow-up's pixels.

    ``positions``: of the follow-up's pixels on the comparison's grid; None if they are the same.
    ``valid``: follow-up pixels that were compared. ``followup_px``: follow-up pixels to one of the
    grid, along a line.
    """

    positions: PixelPositions | None
    valid: BoolArray
    followup_px: float

    @classmethod
    def of(cls, compared: Comparison, pose: DistortedPose) -> "_FollowupGrid":
        """Find where the pixels of both lie."""
        if compared.is_on_followup:
            return cls(positions=None, valid=compared.valid, followup_px=1.0)
        positions = positions_of(pose, pose.followup_shape, pose.reference_shape)
        valid = positions.inside(compared.valid, 0.0)
        seen = pose.followup_seen()
        if seen is not None:
            valid &= seen
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


_STRIP_PX: Final = 8
"""Depth along the border of what was compared within which changes make a strip."""

_STRIP_SHARE: Final = 0.5
_STRIP_LENGTH: Final = 0.15
"""Share of the side of the frame along which a strip's changes lie: a blob at the border has
less."""

_LEAST_STRIP_PX: Final = 30

_GLOSS_REACH_PX: Final = 10
"""Distance from a clipped pixel: its glare around it, the mask's own margin included."""

_MOST_GLOSS_SHARE: Final = 0.01
"""Share of the frame of a highlight; what is larger is no gloss but a wrong exposure."""

_LEAST_GLOSS_PX: Final = 4
_LEAST_OVERLAP: Final = 1 / 3
_SIDES: Final = ("top", "left", "bottom", "right")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ChangeMasks:
    """Masks on the follow-up's pixels, shape ``(rows, cols)`` each.

    ``is_change``: pixels beyond the threshold. ``valid``: pixels that were compared. ``clipped``:
    pixels at which the follow-up is clipped at white. ``reference_clipped``: pixels at which the
    reference is, as the follow-up would see it.
    """

    is_change: BoolArray
    valid: BoolArray
    clipped: BoolArray
    reference_clipped: BoolArray


def change_warnings(changes: Sequence[Change], masks: ChangeMasks) -> tuple[str, ...]:
    """Return one sentence each on flagged borders, likely gloss and a small overlap, if any."""
    said = (_strips(masks), _gloss(changes, masks), _overlap(masks))
    return tuple(sentence for sentence in said if sentence)


def _strips(masks: ChangeMasks) -> str:
    """Changes along the border of the overlap, whose side is told."""
    flagged = masks.is_change
    if np.count_nonzero(flagged) < _LEAST_STRIP_PX:
        return ""
    # Holes that are masked inside the overlap are no border of it.
    seen = _without_holes(masks.valid)
    depth = cv2.distanceTransform(np.pad(seen, 1).astype(np.uint8), cv2.DIST_L2, 3)[1:-1, 1:-1]
    strip = flagged & (depth <= _STRIP_PX)
    count = int(np.count_nonzero(strip))
    if count < max(_LEAST_STRIP_PX, _STRIP_SHARE * np.count_nonzero(flagged)):
        return ""
    rows, cols = np.nonzero(seen)
    ends = rows.min(), cols.min(), rows.max(), cols.max()
    y, x = np.nonzero(strip)
    distance = np.abs([y - ends[0], x - ends[1], y - ends[2], x - ends[3]])
    side_of = np.argmin(distance, axis=0)
    lined = []
    for index, side in enumerate(_SIDES):
        along = (x if index % 2 == 0 else y)[side_of == index]
        length = flagged.shape[1 if index % 2 == 0 else 0]
        if len(np.unique(along)) > _STRIP_LENGTH * length:
            lined.append(side)
    if not lined:
        return ""
    return (
        f"{count} of {np.count_nonzero(flagged)} changed pixels lie along the "
        f"{' and '.join(lined)} of what both photographs show: a mount, a shadow or the lens may "
        "differ there; mask the border with --mask to see the rest"
    )


def _without_holes(mask: BoolArray) -> BoolArray:
    outside = np.pad((~mask).astype(np.uint8), 1, constant_values=1)
    cv2.floodFill(outside, None, (0, 0), 2)
    return np.asarray(outside[1:-1, 1:-1] != 2)


def _gloss(changes: Sequence[Change], masks: ChangeMasks) -> str:
    """Compact highlights that only one photograph shows clipped, and bright changes around one."""
    single = []
    for name, own, other in (
        ("follow-up", masks.clipped, masks.reference_clipped),
        ("reference", masks.reference_clipped, masks.clipped),
    ):
        blobs = _compact_blobs(own, _within(other, _GLOSS_REACH_PX))
        if blobs:
            single.append(f"{blobs} in the {name} alone")
    rims = _rims(changes, masks)
    if not single and not rims:
        return ""
    found = ""
    if single:
        found = f"clipped highlights: {', '.join(single)}"
    if rims:
        beside = f"{rims} of {len(changes)} changes lie beside clipped pixels"
        found = f"{found}; {beside}" if found else beside
    return f"{found}: likely gloss, which moves with the light and the camera"


def _compact_blobs(clipped: BoolArray, beside_other: BoolArray) -> int:
    if not clipped.any():
        return 0
    count, labels, stats, _ = cv2.connectedComponentsWithStats(clipped.astype(np.uint8))
    area = stats[:, cv2.CC_STAT_AREA]
    is_compact = (area >= _LEAST_GLOSS_PX) & (area <= _MOST_GLOSS_SHARE * clipped.size)
    is_compact[0] = False
    is_compact[np.unique(labels[beside_other])] = False
    return int(np.count_nonzero(is_compact[:count]))


def _rims(changes: Sequence[Change], masks: ChangeMasks) -> int:
    """Changes beside pixels that one photograph alone shows clipped, of the highlight's sign."""
    brighter, darker = (
        _within(own & ~_within(other, _GLOSS_REACH_PX), _GLOSS_REACH_PX)
        for own, other in (
            (masks.clipped, masks.reference_clipped),
            (masks.reference_clipped, masks.clipped),
        )
    )
    count = 0
    for change in changes:
        row, col = (
            min(max(round(at), 0), most - 1)
            for at, most in zip((change.y_px, change.x_px), brighter.shape, strict=True)
        )
        count += bool((brighter if change.amplitude_dn > 0 else darker)[row, col])
    return count


def _within(mask: BoolArray, reach_px: int) -> BoolArray:
    """Pixels so near to one of the mask."""
    if not mask.any():
        return np.zeros_like(mask)
    distance = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, 3)
    return np.asarray(distance <= reach_px)


def _overlap(masks: ChangeMasks) -> str:
    share = float(np.mean(masks.valid))
    if share >= _LEAST_OVERLAP:
        return ""
    return (
        f"only {100 * share:.0f} % of the follow-up was compared: check in compared.png whether "
        "this is what both photographs show"
    )


_LISTED = ("x_px", "y_px", "area_px", "amplitude_dn", "significance", "q_value")


@dataclass(frozen=True, slots=True, eq=False, kw_only=True, repr=False)
class ChangeResult(ByValue):
    """A comparison of two photographs: images on the follow-up's pixels, and figures.

    The images have shape ``(rows, cols)`` and are 0 where not ``valid``.

    Parameters
    ----------
    summary
        Figures of the comparison, with the list of changes.
    followup_dn
        The follow-up.
    difference_dn
        After minus before, without what pose, blur and light explain, at the sharpness of the
        blurrier photograph and in the follow-up's levels; smoothed, like the other differences.
    plain_difference_dn
        The same, but with the nearer photograph merely resampled; in the same light.
    pose_difference_dn
        The part of the plain difference that the pose explains.
    variance_dn2
        Variance of ``difference_dn``.
    significance
        Difference over its standard deviation, after the filter width at which it stands out most.
    limit_dn
        Least amplitude at which a spot would have been found; NaN where not compared.
    is_change, is_moved
        Pixels of the changes, and of the movements.
    valid
        Pixels that were compared.
    pose
        Position of every follow-up pixel in the reference.
    masks
        Changed, compared and clipped pixels.
    filter_widths
        Filter widths with which changes were looked for, in pixels of the coarser photograph.
    parallax
        Parallax of each pixel of a scene with depth; None where a plane explains the pair.
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
    parallax: ParallaxMap | None = None

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
        """Return a figure of the follow-up with its changes, both differences and significance."""
        from analysis.changes._plot import changes_figure  # matplotlib, for whoever looks

        return changes_figure(self, ax=ax)


def changes_between(
    reference: AnyArray,
    followup: AnyArray,
    psf: Psf | PsfField | None = None,
    options: ChangeOptions | None = None,
) -> ChangeResult:
    """Find changes between two photographs that pose, blur and light do not explain.

    ``reference, followup``: grey, shape ``(rows, cols)``; the follow-up is the later one, nearer or
    further away. ``psf``: total PSF of the camera that took both, if it is known: the blur between
    them is then compared with what it says. ``options``: pose, noise, masks and allowed false
    alarms, if not the defaults.
    """
    options = options or ChangeOptions()
    aligned = _aligned(reference, followup, psf, options)
    options = replace(options, colours=aligned.given.colours)
    compared = compare(*aligned.given.photographs, psf, aligned.pose, options, aligned.blur)
    pose, k1_err, depth = aligned.pose, aligned.k1_err, None
    if aligned.blur is None:
        depth = with_depth(aligned.given.photographs, psf, pose, options, compared)
    if depth is not None:
        # What was fitted as the lens's distortion may have been parallax.
        k1_err = k1_err if depth.pose.k1 == pose.k1 else None
        pose, compared = depth.pose, depth.compared
    grid = _FollowupGrid.of(compared, pose)
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
            "distortion_k1_err": k1_err,
            "is_noise_known": known,
            "parallax": None if depth is None else depth.figures,
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
        parallax=None if depth is None else depth.parallax,
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
    try:
        made = register_images(near, followup, psf, hints)
    except RegistrationError:
        view = None if alike is None else one_view(*alike.photographs, options, is_last_resort=True)
        if alike is None or view is None:
            raise
        return _Alignment(pose=view.pose, given=alike, blur=view.blur)
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

    ``pose``: of the follow-up in the reference. ``compared_px, frame_px``: follow-up pixels that
    were compared, and all. ``widths, threshold_sd``: of the filters, and their common threshold.
    ``found, apart, below_least``: all that exceeds it; changes and movements in it; and how many
    are too small to be listed.
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
        cls, compared: Comparison, grid: _FollowupGrid, pose: DistortedPose, options: ChangeOptions
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
        large = large_enough(every, options, compared.gain)
        kept = large & beyond_outlines(found.regions, compared.drawn_apart)
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
            below_least=int(np.count_nonzero(~large)),
            limits=LimitMaps.of(compared, levels, threshold, grid.followup_px, options.limit_rgb),
        )

    def summary(
        self, compared: Comparison, masks: ChangeMasks, options: ChangeOptions
    ) -> ChangeSummary:
        """Return it in figures; what only the caller knows is left open."""
        limit = detection_limit(self.limits, options.spot_sigma_px, options.limit_contrast_dn)
        limit = limit.model_copy(update={"full_scale_dn": options.white_level_dn[1]})
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
        # The white of a page is its paper.
        np.zeros(image.shape[:2], dtype=np.bool_)
        if is_of_two_levels(image)
        else clipped_at_white(np.asarray(image, dtype=np.float32), white)
        for image, white in zip((reference, followup), options.white_level_dn, strict=True)
    )
    positions = positions_of(pose, pose.followup_shape, pose.reference_shape)
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
