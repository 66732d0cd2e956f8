"""Two photographs compared on the pixels of the coarser one.

The nearer photograph is the source, the other the target. Both are smoothed, by Gaussians that
bring them to one sharpness; the source is resampled on the target's pixels and a kernel fitted to
the pair takes it to the target. What remains is compared with its own scatter.
"""

from dataclasses import dataclass, field, replace
from math import hypot, inf, isfinite, sqrt

import cv2
import numpy as np

from acquisition.photographs import CodedSteps
from analysis.changes._colour import Bounds, ChannelDifference, ColourPlanes, colour_planes
from analysis.changes._document import KernelOrigin
from analysis.changes._photograph_pair import ChangeOptions, PhotographPair
from analysis.changes.matching import (
    GRADIENT,
    LAPLACIAN,
    SAMPLE_PX,
    FitRules,
    FittedScatter,
    PairFit,
    PairModel,
    RelativeBlur,
    Smoothing,
    VarianceTerms,
    WhiteNoiseGain,
    calibrated_blur_px2,
    calibrated_factor,
    fit_pair,
    fit_tone_curve,
    smoothed,
    smoothing_for,
)
from analysis.errors import AnalysisError, OverlapError
from calibration.registration import DistortedPose
from simulation import Psf, PsfField
from simulation.arrays import AnyArray, BoolArray, Float32Array, FloatImage
from simulation.capture_noise import CaptureNoise

_LEAST_PIXELS = 1000
_ARITHMETIC = 1e-7
"""Of the largest level: what float32 holds of it."""
_FOCUS_PX2, _SURE = 0.15, 3.0
"""Extra blur that is said, and the standard errors by which it must differ from none: a width of
0.39 px on top of the other. Correlated noise, as of strong compression, may pass for less."""

_CODING_ERR_PX2, _CODING_GAIN_ERR = 0.02, 0.001
"""What a JPEG's steps do to sharpness and to light beyond what chance does, by 142 pairs of files
in which neither differs."""

_MOST_STRUCTURE = 0.18
"""Share of the predicted variance beside noise, as a mean over the pixels, beyond which false
alarms are more than stated: 6 for 1 at 0.2 to 0.5 (rectangles through a lens of f/4 that aliases,
noise of 0.3 DN), 3 for 1 at 0.1 to 0.28 (0.6 DN), as stated at up to 0.13 (other lenses and JPEG,
noise of 0.3 to 1.2 DN)."""

_MOST_NOISE = 100.0
"""Variance of noise that is given, over that of all levels, which hold it."""

_NOT_IN_COLOUR = (
    "the levels of the photographs are not in proportion, as with two tone curves: they were "
    "compared in grey, so a change of colour at equal lightness is not found"
)

_CHANNEL_PX = 8_000
"""Pixels that light and kernel of a channel are fitted to; three take the time of one luma."""

_BLUR_ERR_PX2 = 1.0
"""How far the relative blur may be from that guess."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison:
    """What is left between two photographs once pose, blur and light are explained.

    Images are on the grid of the coarser photograph, shape ``(rows, cols)`` each; 0 where not
    ``valid``. ``is_on_followup``: whether the grid is that of the follow-up's pixels; the
    reference's if not. ``difference_dn``: after minus before in the follow-up's levels, smoothed.
    ``plain_difference_dn``: the same with the nearer photograph merely resampled. ``sd_dn``:
    standard deviation of the difference. ``valid``: pixels that were compared. ``smoothing_px``:
    width of the Gaussian that smoothed the photograph whose pixels the grid has. ``smoothing``: of
    the photograph with the grid's pixels, the target, and of the other one. ``target_dn``: the
    photograph whose pixels the grid has, smoothed, in the levels that were matched: its own, or
    those that a tone curve made of them. ``matched_scale``: what takes the target less the other
    photograph to ``difference_dn``: 1, or an image. ``kernel``: where the blur between the
    photographs is known from. ``extra_blur_px2, extra_blur_err_px2``: variance by which the
    follow-up is softer than the calibration says, or than the reference where there is none, in
    follow-up pixels; and its standard error, infinite without detail. ``gain, gain_err``: mean gain
    of light, follow-up over reference, and its standard error. ``noise_factor``: fitted noise
    variance over that of the noise model; over 1 DN^2 where none was given. ``registration_err_px,
    width_err_px2``: standard deviations of the registration along the gradient, and of the variance
    by which the fitted blur is wrong. ``scatter``: of what the difference consists. ``warnings``:
    sentences on what makes the comparison doubtful. ``colours``: what the channels say together, of
    photographs in colour. ``drawn_apart``: of drawings of two levels, where they differ, and where
    by more than an outline that is a pixel away. ``bounds``: of the difference, where an end of
    the scale hides a part of it; the difference itself is what is surely there. ``steps_dn2``:
    of JPEG files, its variance by their steps. ``coded_steps``: see `ChangeOptions`.
    """

    is_on_followup: bool
    difference_dn: FloatImage
    plain_difference_dn: FloatImage
    sd_dn: FloatImage
    valid: BoolArray
    smoothing_px: float
    smoothing: Smoothing
    target_dn: Float32Array = field(repr=False)
    matched_scale: Float32Array | float = field(repr=False)
    kernel: KernelOrigin
    extra_blur_px2: float
    extra_blur_err_px2: float
    gain: float
    gain_err: float
    noise_factor: float
    registration_err_px: float
    width_err_px2: float
    scatter: FittedScatter
    warnings: tuple[str, ...] = ()
    colours: ColourPlanes | None = field(default=None, repr=False)
    drawn_apart: tuple[BoolArray, BoolArray] | None = field(default=None, repr=False)
    bounds: Bounds | None = field(default=None, repr=False)
    steps_dn2: Float32Array | None = field(default=None, repr=False)
    coded_steps: tuple[CodedSteps, ...] = field(default=(), repr=False)

    @property
    def followup_smoothing_px(self) -> float:
        """Width of the Gaussian that smoothed the follow-up, in pixels of the grid."""
        return self.smoothing.target_px if self.is_on_followup else self.smoothing.source_px

    @property
    def significance(self) -> FloatImage:
        """Difference over its standard deviation."""
        none = np.zeros_like(self.difference_dn)
        return np.divide(self.difference_dn, self.sd_dn, out=none, where=self.valid)


def compare(
    reference: AnyArray,
    followup: AnyArray,
    psf: Psf | PsfField | None,
    pose: DistortedPose,
    options: ChangeOptions,
    blur: RelativeBlur | None = None,
) -> Comparison:
    """Compare two aligned photographs.

    ``reference, followup``: grey, shape ``(rows, cols)``. ``options``: noise, masks and white
    levels; and the colours of both. ``blur``: how much blurrier the coarser one is, if that was
    measured.
    """
    pair = PhotographPair.of(reference, followup, pose, options)
    rough = pair.valid(smoothing_for(pair.guessed_blur_px2))
    shared = int(np.count_nonzero(rough))
    if shared < _LEAST_PIXELS:
        raise OverlapError(
            "the photographs overlap too little; retake the follow-up with more overlap",
            shared_px=shared,
        )
    blur = blur or pair.blur(rough, pair.guessed_blur_px2)
    matched = _Matched.of(pair, blur, options.noise)
    curved = matched.with_tone()
    if curved is not None:
        again = _Matched.of(curved, curved.blur(rough, curved.guessed_blur_px2), None)
        # Where something large is new, the levels before it tell of no curve.
        if again.loss < matched.loss:
            matched = again
    stated = matched.as_coded() if options.coded_steps else matched
    compared = _compared(stated, _focus(stated, psf), options.coded_steps)
    if options.colours is None:
        return compared
    colours = _in_colour(matched, pair, options)
    said = () if colours is not None else (_NOT_IN_COLOUR,)
    return replace(compared, colours=colours, warnings=(*compared.warnings, *said))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Matched:
    """A pair at one sharpness, with the kernel that was fitted to it.

    ``blur, smoothing``: how much blurrier the target is, and the Gaussians that make up for it.
    ``valid``: pixels of the target that count. ``seen, target``: source and target, smoothed, on
    the target's pixels.
    """

    pair: PhotographPair
    blur: RelativeBlur
    smoothing: Smoothing
    valid: BoolArray = field(repr=False)
    seen: Float32Array = field(repr=False)
    target: Float32Array = field(repr=False)
    terms: VarianceTerms = field(repr=False)
    floor_dn2: Float32Array | None = field(repr=False)
    fit: PairFit

    @classmethod
    def of(
        cls,
        pair: PhotographPair,
        blur: RelativeBlur,
        noise: CaptureNoise | None,
        sample_px: int = SAMPLE_PX,
    ) -> "_Matched":
        """Smooth by the blur that was measured, and fit."""
        guess, zoom = pair.guessed_blur_px2, pair.positions.zoom
        softer_px2 = blur.towards(guess, _BLUR_ERR_PX2)
        if pair.positions.whole_shift is not None and blur.is_none(_SURE):
            softer_px2 = 0.0
        smoothing = smoothing_for(softer_px2)
        valid = pair.valid(smoothing)
        seen, target = pair.seen(smoothing.source_px), smoothed(pair.target, smoothing.target_px)
        known = [
            noise.variance_dn2(image).astype(np.float32) if one is None and noise else one
            for one, image in zip(pair.known_variances(smoothing), (target, seen), strict=True)
        ]
        gains = PairModel(gain=blur.gain, offset_dn=0.0).noise_gain(smoothing, zoom)
        floor = None
        if any(one is not None for one in known):
            # The photographs' own scatter is not less than what their noise is known to be.
            own, other = (np.float32(0) if one is None else one for one in known)
            floor = np.asarray(np.float32(gains.target) * own + np.float32(gains.source) * other)
        steps = pair.rounding_variance_dn2(gains, smoothing)
        terms = VarianceTerms.of(
            seen, pair.source, pair.target, pair.positions, pair.tone_slope, steps
        )
        least = floor if steps is None else steps if floor is None else np.maximum(floor, steps)
        # Its mean has no noise that goes with that of the difference.
        noises = (gains.source * blur.noises_dn[0] ** 2, gains.target * blur.noises_dn[1] ** 2)
        share = noises[0] / sum(noises) if sum(noises) > 0 else 0.5
        if pair.positions.whole_shift is None:
            # Of two views the finest detail differs, as lenses and sampling have it: what predicts
            # the target best is a kernel on the source alone, which holds that back.
            share = 0.0
        rules = FitRules(
            smoothing_px=smoothing.target_px,
            target_share=share,
            sample_px=sample_px,
            is_one_view=pair.positions.whole_shift is not None,
        )
        fit = fit_pair(seen, target, terms, valid, least, rules)
        return cls(
            pair=pair,
            blur=blur,
            smoothing=smoothing,
            valid=valid,
            seen=seen,
            target=target,
            terms=terms,
            floor_dn2=floor,
            fit=fit,
        )

    def as_coded(self) -> "_Matched":
        """The same, with the errors of blur and light that compression has."""
        err_px2 = hypot(self.blur.err_px2, _CODING_ERR_PX2)
        gain_err = hypot(self.blur.gain_err, _CODING_GAIN_ERR * self.blur.gain)
        return replace(self, blur=replace(self.blur, err_px2=err_px2, gain_err=gain_err))

    def with_tone(self) -> PhotographPair | None:
        """The pair with the target in the source's levels, where a gain does not bring it there."""
        if not self.fit.is_curved:
            return None
        curve = fit_tone_curve(self.seen, self.pair.target, self.valid, self.smoothing.target_px)
        return None if curve is None else self.pair.with_tone(curve)

    @property
    def loss(self) -> float:
        """That of the fit, of the levels that the file has."""
        if self.pair.tone_slope is None:
            return self.fit.loss
        return self.fit.loss - 2 * float(np.log(self.pair.tone_slope[self.valid]).mean())

    @property
    def variance_dn2(self) -> Float32Array:
        """Predicted variance of the difference."""
        variance = self.terms.variance(self.fit.sizes, self.floor_dn2)
        if self.pair.tone_variance_dn2 is not None:
            variance += self.pair.tone_variance_dn2
        if self.pair.place_err_px is not None:
            variance += self.terms.others[0] * self.pair.place_err_px**2
        return self._at_least(variance)

    @property
    def noise_variance_dn2(self) -> Float32Array:
        """The part of it that is noise."""
        return self._at_least(
            self.terms.variance(self.terms.noise_sizes(self.fit.sizes), self.floor_dn2)
        )

    def _at_least(self, variance_dn2: Float32Array) -> Float32Array:
        """Return it no less than arithmetic has: of two levels whole parts have no other."""
        least_dn = np.float32(_ARITHMETIC) * np.abs(self.target[self.valid]).max(initial=0)
        np.maximum(variance_dn2, np.square(least_dn), out=variance_dn2)
        return variance_dn2

    @property
    def rounding_variance_dn2(self) -> Float32Array | None:
        """Variance by rounding to the files' levels, without which shadows have none at all."""
        return self.pair.rounding_variance_dn2(self.gains, self.smoothing)

    @property
    def gains(self) -> WhiteNoiseGain:
        """Of white noise in either photograph."""
        return self.fit.model.noise_gain(self.smoothing, self.pair.positions.zoom)

    @property
    def noise_factor(self) -> float:
        """Noise that was fitted over that of the noise model, or over 1 DN^2."""
        if self.floor_dn2 is None:
            expected = self.gains.target + self.gains.source
        else:
            expected = float(self.floor_dn2[self.valid].mean())
        return self.terms.noise_dn2(self.fit.sizes, self.valid) / expected


@dataclass(frozen=True, slots=True, kw_only=True)
class _Focus:
    """What the blur between the photographs says of the camera, as a `Comparison` has it."""

    kernel: KernelOrigin
    extra_px2: float
    err_px2: float
    warnings: tuple[str, ...] = ()


def _focus(matched: _Matched, psf: Psf | PsfField | None) -> _Focus:
    """Compare the blur that was measured with the one that the calibration says."""
    pair, blur = matched.pair, matched.blur
    # Of the follow-up over the reference, in the follow-up's pixels.
    sense = 1.0 if pair.is_on_followup else -(pair.positions.zoom**2)
    err_px2 = abs(sense) * blur.err_px2
    if psf is None:
        return _Focus(kernel="pair", extra_px2=sense * blur.value_px2, err_px2=err_px2)
    expected_px2 = calibrated_blur_px2(
        psf, matched.seen, matched.valid, matched.smoothing, pair.positions
    )
    extra_px2 = sense * (blur.value_px2 - expected_px2)
    if not err_px2 < inf:
        return _Focus(kernel="calibrated", extra_px2=0.0, err_px2=inf)
    # In the pixels of the coarser photograph: the same whichever comes first.
    if abs(extra_px2) < max(_FOCUS_PX2 * abs(sense), _SURE * err_px2):
        return _Focus(kernel="calibrated", extra_px2=extra_px2, err_px2=err_px2)
    warning = (
        f"the focus has changed by {extra_px2:+.2f} px^2 of blur, {abs(extra_px2) / err_px2:.0f} "
        f"standard errors: the follow-up is {'softer' if extra_px2 > 0 else 'sharper'} against the "
        "reference than the calibrated PSF predicts; the blur was fitted to the photographs"
    )
    return _Focus(kernel="both", extra_px2=extra_px2, err_px2=err_px2, warnings=(warning,))


def _scatter(
    matched: _Matched, difference: Float32Array
) -> tuple[Float32Array, float, Float32Array | None]:
    """Calibrated standard deviation, share of the variance beside noise, variance by steps."""
    valid, smoothing = matched.valid, matched.smoothing
    variance, noise = matched.variance_dn2, matched.noise_variance_dn2
    sd = calibrated_factor(difference, variance, noise, valid, smoothing.target_px)
    share = 1 - float(np.mean(noise[valid] / variance[valid]))
    sd *= np.sqrt(variance, out=variance)
    rounding = matched.rounding_variance_dn2
    if rounding is not None:
        np.maximum(sd, np.sqrt(rounding), out=sd)
    return sd, share, rounding


def _compared(matched: _Matched, focus: _Focus, coded_steps: tuple[CodedSteps, ...]) -> Comparison:
    pair, smoothing, valid, fit = matched.pair, matched.smoothing, matched.valid, matched.fit
    seen, target = matched.seen, matched.target
    # In place where it can be: a large frame's images are most of what a comparison holds.
    difference = fit.model.difference(seen, target)
    sd, share, steps_dn2 = _scatter(matched, difference)
    compared, may_be_more, may_be_less = _between_ends(pair, smoothing)
    gain, offset = fit.model.light((seen.shape[0], seen.shape[1]))
    mean_gain = float(gain[valid].mean())
    if not (mean_gain and isfinite(mean_gain)) or _is_drowned(matched):
        raise AnalysisError(
            "with this noise the photographs have nothing in common; check the given noise, and "
            "that they show the same scene"
        )
    plain = smoothed(pair.seen(0.0), smoothing.target_px)
    plain *= gain
    np.subtract(target, plain, out=plain)
    plain -= offset
    scale = _to_after_minus_before(pair, gain)
    if not pair.is_on_followup:
        may_be_more, may_be_less = may_be_less, may_be_more
    for image in (difference, plain):
        if scale is not None:
            image *= scale
        image[~compared] = 0
    if scale is not None:
        sd *= np.abs(scale)
        steps_dn2 = None if steps_dn2 is None else steps_dn2 * np.square(scale)
    bounds = Bounds.of(difference, sd, may_be_more & compared, may_be_less & compared)
    return Comparison(
        is_on_followup=pair.is_on_followup,
        difference_dn=difference if bounds is None else bounds.surely(),
        plain_difference_dn=plain,
        sd_dn=sd,
        valid=compared,
        smoothing_px=smoothing.target_px,
        target_dn=target,
        matched_scale=1.0 if scale is None else scale,
        kernel=focus.kernel,
        extra_blur_px2=focus.extra_px2,
        extra_blur_err_px2=focus.err_px2,
        gain=mean_gain if pair.is_on_followup else 1 / mean_gain,
        gain_err=matched.blur.gain_err * (1 if pair.is_on_followup else 1 / mean_gain**2),
        noise_factor=matched.noise_factor,
        registration_err_px=sqrt(fit.sizes[GRADIENT]) / abs(mean_gain),
        width_err_px2=sqrt(fit.sizes[LAPLACIAN]) / abs(mean_gain),
        smoothing=smoothing,
        scatter=FittedScatter.of(
            fit, matched.terms, matched.floor_dn2, valid, matched.gains, (pair.source, pair.target)
        ),
        warnings=(*focus.warnings, *_unexplained(share)),
        drawn_apart=_drawn_apart(pair) if pair.is_drawn else None,
        bounds=bounds,
        steps_dn2=steps_dn2 if coded_steps else None,
        coded_steps=coded_steps,
    )


def _to_after_minus_before(pair: PhotographPair, gain: Float32Array) -> Float32Array | None:
    """What takes a difference there, in the follow-up's levels; None of one that is so already.

    Works in place of the ``gain``.
    """
    if not pair.is_on_followup:
        # So far before minus after, in the reference's levels. Far from all that both show, the
        # gain may be 0.
        gain[gain == 0] = 1
        return np.divide(np.float32(-1), gain, out=gain)
    # Otherwise in the levels that the tone curve made, if there is one.
    return None if pair.tone_slope is None else np.asarray(1 / pair.tone_slope, dtype=np.float32)


def _drawn_apart(pair: PhotographPair) -> tuple[BoolArray, BoolArray]:
    """Where two drawings differ, and where by more than an outline that is a pixel away.

    Beside such an outline both have either level: a line that one of them lacks is more.
    """
    middle_dn = np.float32((pair.target.min() + pair.target.max()) / 2)
    around = np.ones((3, 3), dtype=np.uint8)
    seen, target = ((one > middle_dn).astype(np.uint8) for one in (pair.seen(0.0), pair.target))
    has_both = [cv2.dilate(one, around) > cv2.erode(one, around) for one in (seen, target)]
    differs = seen != target
    return differs, differs & ~(has_both[0] & has_both[1])


def _between_ends(
    pair: PhotographPair, smoothing: Smoothing
) -> tuple[BoolArray, BoolArray, BoolArray]:
    """What is compared, and what may be more or less; refused where nothing is."""
    compared, may_be_more, may_be_less = pair.compared(smoothing)
    if not compared.any():
        raise OverlapError(
            "wherever the photographs overlap, they are clipped or next to clipped pixels: "
            "nothing can be compared; retake them with less light, or from the same place",
            shared_px=0,
        )
    return compared, may_be_more, may_be_less


def _is_drowned(matched: _Matched) -> bool:
    """Whether the noise that is given is far larger than all that the photographs show."""
    if matched.floor_dn2 is None:
        return False
    scene_dn2 = float(np.var(matched.target[matched.valid], dtype=np.float64))
    # Written so that NaN is drowned.
    return not float(np.mean(matched.floor_dn2[matched.valid])) <= _MOST_NOISE * scene_dn2


def _in_colour(luma: _Matched, pair: PhotographPair, options: ChangeOptions) -> ColourPlanes | None:
    """Channels compared as the luma was, each in its own light and with its own kernel.

    The sharpness to which all are brought is the luma's; ``pair`` are its photographs as they are.
    None where the levels of the two are not in proportion: the errors of four tone curves would be
    changes of colour.
    """
    colours = options.colours
    if luma.pair.tone_slope is not None or colours is None:
        return None
    found = []
    for number in range(3):
        matched = _Matched.of(pair.channel(number, options), luma.blur, None, _CHANNEL_PX)
        if matched.fit.is_curved:
            return None
        found.append(_channel_difference(matched))
    planes = colour_planes(
        _channel_difference(luma), found, colours.step_correlation, luma.smoothing.target_px
    )
    return planes if options.coded_steps else replace(planes, steps_dn2=(None, None, None))


def _channel_difference(matched: _Matched) -> ChannelDifference:
    """What is left of a channel, after minus before, in the follow-up's levels."""
    pair, fit, seen = matched.pair, matched.fit, matched.seen
    difference = fit.model.difference(seen, matched.target)
    variance, noise = matched.variance_dn2, matched.noise_variance_dn2
    rounding = matched.rounding_variance_dn2
    compared, may_be_more, may_be_less = pair.compared(matched.smoothing)
    may_be_more |= ~compared
    may_be_less |= ~compared
    scale: Float32Array | None = None
    if not pair.is_on_followup:
        gain, _ = fit.model.light((seen.shape[0], seen.shape[1]))
        scale = np.divide(np.float32(-1), gain, out=np.zeros_like(gain), where=gain != 0)
        may_be_more, may_be_less = may_be_less, may_be_more
    if scale is not None:
        difference = difference * scale
        square = np.square(scale)
        variance, noise = variance * square, noise * square
        rounding = None if rounding is None else rounding * square
    return ChannelDifference(
        difference_dn=difference,
        variance_dn2=variance,
        noise_dn2=noise,
        rounding_dn2=rounding,
        seen_dn=seen,
        may_be_more=may_be_more,
        may_be_less=may_be_less,
        valid=matched.valid,
    )


def _unexplained(share: float) -> tuple[str, ...]:
    """Say that the stated rate cannot be kept, if so much of the variance is not noise."""
    if share <= _MOST_STRUCTURE:
        return ()
    return (
        "the noise is small compared with what lens and levels leave unexplained "
        f"({100 * share:.0f} % of the variance): expect more false alarms than the stated number",
    )
