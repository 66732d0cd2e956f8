"""Two photographs in the roles that their comparison gives them, and how they are compared."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np

from acquisition.photographs import CodedSteps
from analysis.changes._colour import PairColours
from analysis.changes._ends import (
    Ends,
    clipped_at_black,
    clipped_at_white,
    is_of_two_levels,
    mostly,
)
from analysis.changes.matching import (
    KERNEL_RADIUS_PX,
    PixelPositions,
    RelativeBlur,
    Smoothing,
    ToneCurve,
    WhiteNoiseGain,
    away_from,
    relative_blur,
    rounding_variance,
    smoothed,
    smoothing_for,
)
from analysis.choices import FALSE_ALARMS, SPOT_SIGMA_PX
from calibration.registration import DistortedPose, RegistrationHints
from simulation.arrays import AnyArray, BoolArray, Float32Array
from simulation.capture_noise import CaptureNoise

if TYPE_CHECKING:
    from analysis.changes._prediction import LimitCurve


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CodedAlike:
    """Reference and follow-up, grey, as files that are coded alike hold them; and their colours."""

    photographs: tuple[AnyArray, AnyArray]
    colours: PairColours | None = None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ChangeCriteria:
    """What counts as a change, as whoever compares decides.

    It is carried as a whole from the caller to the comparison, and is part of what a series does.
    ``false_alarms``: follow-up pixels flagged by chance, expected in a frame.
    ``false_discovery_rate``: share of false ones among the changes listed, which then decides
    instead; None for the rate of false alarms. ``least_dn``: amplitude below which what is
    significant is counted and not listed; None for the step of the files, at each place.
    ``count_moved``: whether what a shift explains is listed among the changes. ``flat``: whether a
    plane is all that is looked for, and no parallax of a scene with depth.
    """

    false_alarms: float = FALSE_ALARMS
    false_discovery_rate: float | None = None
    least_dn: float | None = None
    count_moved: bool = False
    flat: bool = False


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ChangeOptions(ChangeCriteria):
    """Options for comparing two photographs, besides what counts as a change.

    ``pose``: pose of the follow-up in the reference; None registers them, with the lens's
    distortion. ``hints``: what is known of the pose where none is given. ``noise``: noise of both
    captures; None fits it. ``spot_sigma_px``: width of the spots that the map of the detection
    limit is for, in follow-up pixels. ``limit_contrast_dn``: amplitude for
    which the detection limit says where it would have been found. ``expected``: limits that were
    predicted, to hold against the one that is shown. ``left_out, reference_left_out``: pixels of
    the follow-up and of the reference that do not count, in their shapes. ``white_level_dn``:
    levels at which the reference and the follow-up are clipped, where they are known; a plateau at
    the top counts anyway. ``variance_dn2``: variance of each pixel of the reference and the
    follow-up, where it is known, as of captures merged from several exposures; it comes before
    ``noise``. ``step_variance_dn2``: variance of each pixel of the reference and the follow-up by
    the steps of their files, where those are known; otherwise they are looked for among the levels.
    ``step_dn``: steps of the levels of reference and follow-up, at each pixel, where they are
    known. ``coded_steps``: those of coefficients, of the files that are JPEGs: of most
    blocks nothing is seen of them, of a few all. ``coded_alike``: gives reference and follow-up as
    they would be in files that are coded alike, for photographs whose pixels lie upon each other.
    ``colours``: of photographs in colour; without them the levels are compared alone.
    ``limit_rgb``: direction in linear levels of red, green and blue of the changes that the limit
    is for, the largest of them 1; of photographs in colour.
    """

    pose: DistortedPose | None = None
    hints: RegistrationHints | None = None
    noise: CaptureNoise | None = None
    spot_sigma_px: float = SPOT_SIGMA_PX
    limit_contrast_dn: float | None = None
    expected: "LimitCurve | None" = None
    left_out: BoolArray | None = None
    reference_left_out: BoolArray | None = None
    white_level_dn: tuple[float | None, float | None] = (None, None)
    variance_dn2: tuple[Float32Array | None, Float32Array | None] = (None, None)
    step_variance_dn2: tuple[Float32Array | None, Float32Array | None] = (None, None)
    step_dn: tuple[Float32Array | None, Float32Array | None] = (None, None)
    coded_steps: tuple[CodedSteps, ...] = ()
    coded_alike: Callable[[], CodedAlike] | None = None
    colours: PairColours | None = None
    limit_rgb: tuple[float, float, float] = (1.0, 1.0, 1.0)


_COMMON_PSF_PX2 = 0.64
"""Variance of a common camera's PSF, for a first guess of how blurry one is against the other."""

_BORDER_SD = 3.0
_LEAST_SHARE, _LEAST_PIXELS = 0.2, 1000
"""Of the pixels within the border, between the ends of the scale, for models to be fitted there."""

_UNLIKE_OUTLINES = 0.02
"""Share of the pixels beside outlines that differ, from which on these were drawn anew."""

_BETWEEN_LEVELS = np.float32(3.0)
"""Light half-way between two levels takes either by chance: a quarter of the squared step, where a
twelfth is the mean over all light. Of a smooth surface whole places lie there."""

_CLIPPED_BY_CHANCE_SD = np.float32(4.0)
"""How far below its end a level of a bracket may have been clipped by the noise of one exposure."""

_HIDDEN_SD = 1.0
"""Reach of a pixel that is hidden in one photograph, in widths of the smoothing: both show about
the same there, as what is in front has its own outline in both."""

_CLIPPED_SD, _CLIPPED_PX = 2.0, 3.0
"""Reach of a clipped pixel: so many widths of the smoothing, and pixels."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PhotographPair:
    """The two photographs in the roles that the comparison gives them.

    ``is_on_followup``: whether the target is the follow-up. ``source, target``: the nearer
    photograph and the other one. ``positions``: where the target's pixels lie in the source.
    ``source_ends, target_ends``: those at black and those at white. ``is_drawn``: whether both are
    drawings of two levels, each with outlines of its own: the ends of the scale are the scene, and
    beside an outline the step of the levels is that between them. ``tone_slope``: slope of the tone
    curve that took the target to the source's levels, at its pixels; None if it is as it was.
    ``tone_variance_dn2``: variance of that curve at the pixels. ``source_variance_dn2,
    target_variance_dn2``: variance of their pixels, where it is known. ``source_steps_dn2,
    target_steps_dn2``: their variance by the steps of their files, where it is known. ``is_seen``:
    target's pixels of which both show the same, of scenes with depth; ``place_err_px``: how far
    they may be from their places in the source, in the target's pixels. ``pages``: whether source
    and target are drawings of two levels beside a photograph: their ends are the scene.
    """

    is_on_followup: bool
    source: Float32Array = field(repr=False)
    target: Float32Array = field(repr=False)
    positions: PixelPositions = field(repr=False)
    source_finite: BoolArray = field(repr=False)
    target_finite: BoolArray = field(repr=False)
    source_ends: Ends = field(repr=False)
    target_ends: Ends = field(repr=False)
    is_drawn: bool = False
    tone_slope: Float32Array | None = None
    tone_variance_dn2: Float32Array | None = None
    source_variance_dn2: Float32Array | None = field(default=None, repr=False)
    target_variance_dn2: Float32Array | None = field(default=None, repr=False)
    source_steps_dn2: Float32Array | None = field(default=None, repr=False)
    target_steps_dn2: Float32Array | None = field(default=None, repr=False)
    is_seen: BoolArray | None = field(default=None, repr=False)
    place_err_px: Float32Array | None = field(default=None, repr=False)
    pages: tuple[bool, bool] = (False, False)

    @classmethod
    def of(
        cls, reference: AnyArray, followup: AnyArray, pose: DistortedPose, options: ChangeOptions
    ) -> "PhotographPair":
        """Give the photographs their roles: the coarser one is the target."""
        is_on_followup = pose.zoom >= 1
        images, usable, ends, variances = [], [], [], []
        for image, white, known in zip(
            (reference, followup), options.white_level_dn, options.variance_dn2, strict=True
        ):
            levels = np.asarray(image, dtype=np.float32)
            finite = np.isfinite(levels)
            levels = np.where(finite, levels, np.float32(0))
            clipped = clipped_at_white(levels, white)
            if known is not None:
                levels, known, clipped = _least_light(levels, known, clipped)
            images.append(levels)
            variances.append(known)
            usable.append(finite)
            ends.append((clipped_at_black(levels), clipped))
        for own, left_out in zip(
            usable, (options.reference_left_out, options.left_out), strict=True
        ):
            if left_out is not None:
                own &= ~left_out
        steps = [
            rounding_variance(image) if known is None else known
            for image, known in zip(images, options.step_variance_dn2, strict=True)
        ]
        if not is_on_followup:
            images, usable = images[::-1], usable[::-1]
            ends = ends[::-1]
            variances, steps = variances[::-1], steps[::-1]
        shapes = [(image.shape[0], image.shape[1]) for image in images]
        of_target = pose if is_on_followup else pose.inverse()
        pair = cls(
            is_on_followup=is_on_followup,
            source=images[0],
            target=images[1],
            positions=positions_of(of_target, shapes[1], shapes[0]),
            source_finite=usable[0],
            target_finite=usable[1],
            source_ends=ends[0],
            target_ends=ends[1],
            source_variance_dn2=variances[0],
            target_variance_dn2=variances[1],
            source_steps_dn2=steps[0],
            target_steps_dn2=steps[1],
            is_seen=of_target.followup_seen(),
            place_err_px=None
            if of_target.parallax is None or of_target.parallax.photograph != "followup"
            else of_target.parallax.error_px,
        )
        if not pair._is_of_two_levels:
            return pair._with_the_ends_of_a_page()
        if pair._has_like_outlines:
            return pair
        drawn = [_drawn_variance(image) for image in images]
        return replace(pair, is_drawn=True, source_steps_dn2=drawn[0], target_steps_dn2=drawn[1])

    def channel(self, number: int, options: ChangeOptions) -> "PhotographPair":
        """Return the pair with one channel of the photographs' colours instead of their luma."""
        colours = options.colours
        assert colours is not None, "photographs in colour"
        images, ends, steps = [], [], []
        for image, known, white in zip(
            (colours.reference_dn, colours.followup_dn),
            colours.step_variance_dn2,
            options.white_level_dn,
            strict=True,
        ):
            levels = np.asarray(image[..., number], dtype=np.float32)
            levels = np.where(np.isfinite(levels), levels, np.float32(0))
            images.append(levels)
            ends.append((mostly(clipped_at_black(levels)), mostly(clipped_at_white(levels, white))))
            step_dn2 = rounding_variance(levels) if known is None else known[..., number]
            steps.append(_drawn_variance(levels) if self.is_drawn else step_dn2)
        if not self.is_on_followup:
            images, ends, steps = images[::-1], ends[::-1], steps[::-1]
        return replace(
            self,
            source=images[0],
            target=images[1],
            source_ends=ends[0],
            target_ends=ends[1],
            source_variance_dn2=None,
            target_variance_dn2=None,
            source_steps_dn2=steps[0],
            target_steps_dn2=steps[1],
        )._without_ends_of_pages()

    @property
    def guessed_blur_px2(self) -> float:
        """How much blurrier the target is if one camera took both."""
        return _COMMON_PSF_PX2 * (1 - 1 / self.positions.zoom**2)

    def blur(self, valid: BoolArray, expected_px2: float) -> RelativeBlur:
        """Measure how much blurrier the target is, on the pixels ``valid``, from a first guess."""
        steps = tuple(
            0.0 if one is None else float(np.mean(one))
            for one in (self.source_steps_dn2, self.target_steps_dn2)
        )
        return relative_blur(
            self.source, self.target, self.positions, valid, expected_px2, (steps[0], steps[1])
        )

    def rounding_variance_dn2(
        self, gains: WhiteNoiseGain, smoothing: Smoothing
    ) -> Float32Array | None:
        """Most that the steps of the files give the difference; None where these are not known."""
        own, other = self.target_steps_dn2, self.source_steps_dn2
        total = None if own is None else np.float32(gains.target) * own
        if other is not None:
            brought = np.float32(gains.source) * np.nan_to_num(self.positions.seen(other))
            total = brought if total is None else total + brought
        return None if total is None else smoothed(total * _BETWEEN_LEVELS, smoothing.target_px)

    def with_tone(self, curve: ToneCurve) -> "PhotographPair":
        """Return the pair with the target in the source's levels; its variance is fitted then."""
        return replace(
            self,
            source_variance_dn2=None,
            target_variance_dn2=None,
            target=curve.of(self.target),
            target_steps_dn2=None
            if self.target_steps_dn2 is None
            else self.target_steps_dn2 * np.square(curve.slope(self.target)),
            tone_slope=smoothed(curve.slope(self.target), 1.0),
            tone_variance_dn2=smoothed(curve.variance(self.target), 1.0),
        )

    def valid(self, smoothing: Smoothing) -> BoolArray:
        """Pixels of the target that models are fitted to.

        Neither a border nor a pixel at an end of the scale reaches them, unless that leaves next to
        nothing: of drawings and scans, the ends are the scene.
        """
        inside = self._inside(smoothing)
        sound = self._away(inside, smoothing, [source | target for source, target in self._ends])
        least = max(_LEAST_SHARE * np.count_nonzero(inside), _LEAST_PIXELS)
        return sound if np.count_nonzero(sound) >= least else inside

    def compared(self, smoothing: Smoothing) -> tuple[BoolArray, BoolArray, BoolArray]:
        """Pixels that are compared, and those whose difference may be larger, or smaller.

        What is at white may be brighter, what is at black darker. Where both photographs are at
        one end, nothing is known.
        """
        inside = self._inside(smoothing)
        if self.is_drawn:
            none = np.zeros_like(inside)
            return inside, none, none
        (source_black, target_black), (source_white, target_white) = self._ends
        may_be_more, may_be_less = (
            ~self._away(inside, smoothing, ends)
            for ends in ((target_white | source_black,), (target_black | source_white,))
        )
        return inside & ~(may_be_more & may_be_less), may_be_more, may_be_less

    @property
    def _is_of_two_levels(self) -> bool:
        """Whether both are drawings of black and white."""
        return is_of_two_levels(self.source) and is_of_two_levels(self.target)

    def _with_the_ends_of_a_page(self) -> "PhotographPair":
        """Return the pair in which the ends of a drawing of two levels are what it shows.

        A page beside its photograph or scan: paper is white and print black, and neither is cut
        off, though all print is beside both ends.
        """
        pages = is_of_two_levels(self.source), is_of_two_levels(self.target)
        return replace(self, pages=pages)._without_ends_of_pages()

    def _without_ends_of_pages(self) -> "PhotographPair":
        source, target = (
            (np.zeros_like(ends[0]), np.zeros_like(ends[1])) if is_page else ends
            for is_page, ends in zip(self.pages, (self.source_ends, self.target_ends), strict=True)
        )
        return replace(self, source_ends=source, target_ends=target)

    @property
    def _has_like_outlines(self) -> bool:
        """Whether the outlines of a drawing lie pixel upon pixel in both, as in a copy."""
        shift = self.positions.whole_shift
        if shift is None:
            return False
        outlines = _drawn_variance(self.target) > 0
        apart = np.abs(self.target - self.positions.seen(self.source))[outlines]
        step_dn = float(np.ptp(self.target))
        return bool(np.mean(apart > step_dn / 2) < _UNLIKE_OUTLINES)

    @property
    def _ends(self) -> tuple[tuple[BoolArray, BoolArray], tuple[BoolArray, BoolArray]]:
        """Of source and target, the target's pixels at black; and those at white."""
        brought = [
            self.positions.inside(end, 0.0) if end.any() else np.zeros_like(self.target_finite)
            for end in self.source_ends
        ]
        return (brought[0], self.target_ends[0]), (brought[1], self.target_ends[1])

    def _away(
        self, inside: BoolArray, smoothing: Smoothing, ends: Sequence[BoolArray]
    ) -> BoolArray:
        """Pixels that none at an end reaches, by the smoothing and by what lenses scatter.

        Of one view, both photographs scatter alike.
        """
        reach_px = 0.0
        if self.positions.whole_shift is None:
            reach_px = _CLIPPED_PX + _CLIPPED_SD * max(smoothing.source_px, smoothing.target_px)
        sound = inside.copy()
        for end in ends:
            sound &= away_from(end, reach_px)
        return sound

    def _inside(self, smoothing: Smoothing) -> BoolArray:
        zoom = self.positions.zoom
        source_px, target_px = smoothing.source_px, smoothing.target_px
        border_px = KERNEL_RADIUS_PX + _BORDER_SD * max(source_px, target_px)
        sound = away_from(~self.source_finite, _CLIPPED_PX + _CLIPPED_SD * source_px * zoom)
        inside = self.positions.inside(sound, border_px * zoom)
        inside &= away_from(~self.target_finite, _CLIPPED_PX + _CLIPPED_SD * target_px)
        if self.is_seen is not None:
            inside &= away_from(~self.is_seen, _HIDDEN_SD * max(source_px, target_px))
        width = int(np.ceil(border_px))
        inside[:width] = inside[-width:] = False
        inside[:, :width] = inside[:, -width:] = False
        return inside

    def known_variances(self, smoothing: Smoothing) -> tuple[Float32Array | None, ...]:
        """Variances of target and source at the target's pixels, where known.

        A smoothed image has the variance smoothed by the square of the kernel: of a Gaussian, one
        narrower by sqrt(2).
        """
        target, source = self.target_variance_dn2, self.source_variance_dn2
        if target is not None:
            target = smoothed(target, smoothing.target_px * 0.5**0.5)
        if source is not None:
            width_px = smoothing.source_px * self.positions.zoom * 0.5**0.5
            seen = self.positions.seen(self.positions.coefficients(source, width_px))
            source = np.maximum(np.nan_to_num(seen, copy=False, nan=float(np.mean(source))), 0)
        return target, source

    def seen(self, smoothing_px: float) -> Float32Array:
        """The source on the target's pixels, smoothed; its mean where it shows nothing."""
        width_px = smoothing_px * self.positions.zoom
        seen = self.positions.seen(self.positions.coefficients(self.source, width_px))
        return np.nan_to_num(seen, copy=False, nan=float(np.mean(self.source)))


def positions_of(
    pose: DistortedPose, shape: tuple[int, int], source_shape: tuple[int, int]
) -> PixelPositions:
    """Where the pixels of a pose's follow-up lie in its reference, each at its depth."""
    positions = PixelPositions.of(pose.plane.to_reference_px, shape, source_shape)
    return positions if pose.parallax is None else positions.with_depth(pose.to_reference_px)


def _least_light(
    levels_dn: Float32Array, variance_dn2: Float32Array, clipped: BoolArray
) -> tuple[Float32Array, Float32Array, BoolArray]:
    """Levels of a bracket that end where chance may clip them, their variance, and where they end.

    A bracket says white of a pixel, and no variance, where any of its exposures was clipped; the
    levels below end where an exposure does, less its black.
    """
    if not clipped.any() or clipped.all():
        return levels_dn, variance_dn2, clipped
    top_dn, most_dn2 = levels_dn[~clipped].max(), variance_dn2[~clipped].max()
    least_dn = top_dn - _CLIPPED_BY_CHANCE_SD * np.sqrt(most_dn2)
    clipped = levels_dn >= least_dn
    return (
        np.where(clipped, least_dn, levels_dn),
        np.where(clipped, most_dn2, variance_dn2),
        clipped,
    )


def _drawn_variance(image_dn: Float32Array) -> Float32Array:
    """Twelfth of the squared step that a drawing of two levels takes beside each pixel."""
    around = np.ones((3, 3), dtype=np.uint8)
    return np.asarray((cv2.dilate(image_dn, around) - cv2.erode(image_dn, around)) ** 2 / 12)


@dataclass(frozen=True, slots=True, kw_only=True)
class _OneView:
    """The pose of two photographs of one view, and how much blurrier one is."""

    pose: DistortedPose
    blur: RelativeBlur


_LEAST_VIEW_PIXELS: Final = 1000
_MOST_UNLIKE: Final = 0.25
"""Mean square of what differs over that of the scene: 2 for two unrelated ones, 0.2 at a noise as
large as the scene."""

_ALIKE: Final = 0.1
"""The same of two photographs that surely show one scene from one place."""

_NEAR_PX: Final = 0.5
"""A pose so near to a shift by whole pixels may be one."""

_NEARBY_PX: Final = 4.0
"""A pose so near to one may be an error of the registration, where what differs is irregular."""

_MOST_PX, _SURELY, _MOST_ERR_PX = 0.03, 3.0, 0.1
"""Displacement at a corner that does not matter, the standard errors up to which it is none, and
the error beyond which nothing is known of it. Registration is no better than 0.01 to 0.03 px."""


def one_view(
    reference: AnyArray,
    followup: AnyArray,
    options: ChangeOptions,
    shift_px: tuple[int, int] = (0, 0),
    *,
    is_last_resort: bool = False,
) -> _OneView | None:
    """Return the pose of one view, if the photographs are such; None if they are to be aligned.

    A camera that stood still is not to be aligned: the errors of that would be the only ones.
    ``reference, followup``: grey, shape ``(rows, cols)`` each. ``shift_px``: ``(y, x)`` of the
    follow-up's first pixel in the reference. ``is_last_resort``: nothing aligns them: of long lines
    no displacement can be told, and that they are alike is enough.
    """
    pose = _shifted(reference, followup, shift_px)
    found = _blur_at(reference, followup, options, pose)
    if found is None or (is_last_resort and not found.unlike < _ALIKE):
        return None
    apart_px, err_px = found.most_displaced
    most_px = max(_MOST_PX, _SURELY * err_px)  # NaN is no view
    stood_still = found.unlike < _MOST_UNLIKE and err_px < _MOST_ERR_PX and apart_px <= most_px
    return _OneView(pose=pose, blur=found) if is_last_resort or stood_still else None


def view_rather(
    reference: AnyArray, followup: AnyArray, options: ChangeOptions, pose: DistortedPose
) -> _OneView | None:
    """Return the pose of one view, if the photographs agree better at it than as registered.

    Where next to nothing is seen, registration may be far off. A drawing of which each line was
    moved a little, by itself, has no pose: registration then follows some of the lines.
    ``reference, followup``: grey, shape ``(rows, cols)`` each.
    """
    nearest = nearest_shift(pose, _NEARBY_PX) or (0, 0)
    registered = _seen_from(reference, pose)
    for shift_px in sorted({(0, 0), nearest}):
        shifted = _shifted(reference, followup, shift_px)
        # Interpolation makes noise less, smoothing what a line displaced by itself adds.
        both = registered, _seen_from(reference, shifted)
        if not any(_is_nearer(both, followup, options, smoothing_px) for smoothing_px in (0, 1)):
            continue
        blur = _blur_at(reference, followup, options, shifted)
        if blur is not None:
            return _OneView(pose=shifted, blur=blur)
    return None


def _blur_at(
    reference: AnyArray, followup: AnyArray, options: ChangeOptions, pose: DistortedPose
) -> RelativeBlur | None:
    """How much blurrier one is at a pose; None where they share too little."""
    pair = PhotographPair.of(reference, followup, pose, options)
    valid = pair.valid(smoothing_for(0.0))
    return None if np.count_nonzero(valid) < _LEAST_VIEW_PIXELS else pair.blur(valid, 0.0)


def _seen_from(reference: AnyArray, pose: DistortedPose) -> Float32Array:
    """The reference on the follow-up's pixels, NaN outside: for a mean, not for a comparison."""
    levels = np.asarray(reference, dtype=np.float32)
    rows, cols = pose.followup_shape
    if pose.k1 == 0:
        return np.asarray(
            cv2.warpPerspective(
                levels,
                pose.matrix,
                (cols, rows),
                flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP,
                borderValue=(np.nan,) * 4,
            ),
            dtype=np.float32,
        )
    y, x = np.indices((rows, cols), dtype=np.float64)
    to_y, to_x = (one.astype(np.float32) for one in pose.to_reference_px(y, x))
    seen = cv2.remap(levels, to_x, to_y, cv2.INTER_CUBIC, borderValue=(np.nan,) * 4)
    return np.asarray(seen, dtype=np.float32)


def _is_nearer(
    both: tuple[Float32Array, Float32Array],
    followup: AnyArray,
    options: ChangeOptions,
    smoothing_px: float,
) -> bool:
    """Whether the second of two images differs less from the follow-up, in one light each."""
    own = np.asarray(followup, dtype=np.float32)
    if smoothing_px > 0:
        both = smoothed(both[0], smoothing_px), smoothed(both[1], smoothing_px)
        own = smoothed(own, smoothing_px)
    valid = np.isfinite(both[0]) & np.isfinite(both[1]) & np.isfinite(own)
    if options.left_out is not None:
        valid &= ~options.left_out
    if np.count_nonzero(valid) < _LEAST_VIEW_PIXELS:
        return False
    levels = own[valid]
    levels -= np.median(levels)
    apart = []
    for image in both:
        others = image[valid]
        others -= np.median(others)
        # Not the slope of a regression, which is less where they differ more.
        gain = np.mean(np.abs(levels)) / max(float(np.mean(np.abs(others))), 1e-30)
        apart.append(float(np.mean(np.abs(levels - np.float32(gain) * others))))
    return apart[1] < apart[0]


def _shifted(reference: AnyArray, followup: AnyArray, shift_px: tuple[int, int]) -> DistortedPose:
    matrix = np.array([[1.0, 0.0, shift_px[1]], [0.0, 1.0, shift_px[0]], [0.0, 0.0, 1.0]])
    shapes = [
        (int(one.shape[0]), int(one.shape[1])) for one in map(np.asarray, (reference, followup))
    ]
    return DistortedPose(matrix=matrix, k1=0.0, reference_shape=shapes[0], followup_shape=shapes[1])


def nearest_shift(pose: DistortedPose, near_px: float = _NEAR_PX) -> tuple[int, int] | None:
    """Whole pixels ``(y, x)`` by which a pose moves the frame; None if it is no such shift.

    ``near_px``: how far the corners may be from where the shift puts them.
    """
    rows, cols = pose.followup_shape
    y, x = (
        np.array([0.0, 0.0, rows - 1.0, rows - 1.0]),
        np.array([0.0, cols - 1.0, 0.0, cols - 1.0]),
    )
    to_y, to_x = pose.to_reference_px(y, x)
    shift_y, shift_x = round(float(np.mean(to_y - y))), round(float(np.mean(to_x - x)))
    apart = np.hypot(to_y - y - shift_y, to_x - x - shift_x)
    return (shift_y, shift_x) if float(apart.max()) < near_px else None
