"""The luma, and what red and blue say beside it: planes that noise does not tie together.

Noise of the channels goes together, by demosaicing, compression and the luma's own share of each;
wrong positions and blur move all channels at once, along their own slopes. Both correlations are
measured on the pair, apart; what the luma predicts of red, and both of blue, is taken off. What
remains is a difference like any other, with a variance that is calibrated like any other. Where a
channel says nothing, both photographs being at one end of its scale, it remains as predicted.

References
----------
IEC 61966-2-1:1999, section 5.2: from linear sRGB to XYZ. CIE 142-2001 and G. Sharma, W. Wu and
E. N. Dalal, "The CIEDE2000 color-difference formula", Color Res. Appl. 30 (2005), 21-30.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Final, Self

import cv2
import lazy_loader as lazy
import numpy as np
from scipy.optimize import lsq_linear

from acquisition.photographs import REC601_LUMA
from analysis.changes.matching import calibrated_factor, sampled, smoothed
from calibration.robust import robust_sigma
from simulation.arrays import AnyArray, BoolArray, Float32Array, FloatArray

Steps = tuple[Float32Array | None, Float32Array | None]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairColours:
    """Reference and follow-up in colour, shape ``(rows, cols, 3)`` each, linear in light.

    ``reference_dn, followup_dn``: red, green and blue. ``step_variance_dn2``: variance of each
    level by the steps of the files, shape ``(rows, cols, 3)``, where known. ``step_dn``: steps of
    the levels of reference and follow-up, likewise. ``step_correlation``: of the errors of the
    channels by the steps, shape ``(3, 3)``. ``white_dn``: level of white of both, for differences
    as they are seen; None where a file does not say it.
    """

    reference_dn: AnyArray = field(repr=False)
    followup_dn: AnyArray = field(repr=False)
    step_variance_dn2: Steps = field(default=(None, None), repr=False)
    step_dn: Steps = field(default=(None, None), repr=False)
    step_correlation: FloatArray = field(default_factory=lambda: np.eye(3), repr=False)
    white_dn: tuple[float | None, float | None] = (None, None)


def to_rgb(luma_red_blue: FloatArray) -> FloatArray:
    """Red, green and blue, shape ``(3, ...)``, of luma, red and blue."""
    luma, red, blue = luma_red_blue
    of_red, of_green, of_blue = REC601_LUMA
    return np.stack([red, (luma - of_red * red - of_blue * blue) / of_green, blue])


def to_luma_red_blue(rgb: FloatArray) -> FloatArray:
    """Luma, red and blue, shape ``(3, ...)``, of red, green and blue."""
    red, _, blue = rgb
    return np.stack([np.tensordot(np.asarray(REC601_LUMA), rgb, axes=1), red, blue])


_SAMPLE_PX = 25_000
_CLIP_SD, _CLIPPED_VARIANCE = 3.0, 0.9734
"""Standard deviations within which pixels tell correlations, and what is left of a variance."""

_MOST = 0.98
"""Correlation, beyond which two planes are taken for no more than that of one."""

_MOST_STRUCTURE = 0.8
"""Correlation of what is not noise: edges of colours alias, and are compressed, each in its way."""

_LEAST_STRUCTURE = 0.01
"""Mean share of the variance beside noise from which on its correlation is told apart."""

_CALIBRATED_PX = 60_000
"""Pixels that a variance is calibrated by: a luma alone by eight times as many."""

_LEAST_OF_STEPS, _LEAST_OF_USUAL = 0.3, 0.03
"""Standard deviation of a channel by which another is predicted, over that of its file's steps,
and over the frame's."""

_WINDOW_PX = 1.5
_HIDDEN_SD = 3.0
"""Standard deviations of a difference of the wrong sign that are noise."""

_LEAST_SPREAD = 1e-3
_LEAST_DN2 = np.float32(1e-12)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Bounds:
    """The least and the most that a difference can be, as an end of the scale hides a part of it.

    Noise is about 0 in both, while what is surely there of each pixel has one sign, and adds up
    behind a wide filter. ``hidden``: 1 where a part is hidden, or the share of such pixels.
    """

    least_dn: Float32Array = field(repr=False)
    most_dn: Float32Array = field(repr=False)
    hidden: Float32Array = field(repr=False)

    @classmethod
    def of(
        cls,
        difference_dn: Float32Array,
        sd_dn: Float32Array,
        may_be_more: BoolArray,
        may_be_less: BoolArray,
    ) -> Self | None:
        """Bounds of a difference that may be larger, or smaller, at some pixels; None at none.

        What is of the wrong sign by more than noise is hidden and tells nothing.
        """
        hidden = may_be_more | may_be_less
        if not hidden.any():
            return None
        far = np.float32(_HIDDEN_SD) * sd_dn
        least = difference_dn.copy()
        least[(may_be_more & (least < -far)) | (may_be_less & (least > far))] = 0
        most = least.copy()
        np.minimum(least, 0, out=least, where=may_be_less)
        np.maximum(most, 0, out=most, where=may_be_more)
        return cls(least_dn=least, most_dn=most, hidden=hidden.astype(np.float32))

    @classmethod
    def none(cls, difference_dn: Float32Array) -> Self:
        """Those of a difference of which nothing is hidden."""
        none = np.zeros_like(difference_dn)
        return cls(least_dn=difference_dn, most_dn=difference_dn, hidden=none)

    def through(self, made: Callable[[Float32Array], Float32Array]) -> Self:
        """What is made of each."""
        return replace(
            self,
            least_dn=made(self.least_dn),
            most_dn=made(self.most_dn),
            hidden=made(self.hidden),
        )

    def surely(self, light_dn: Float32Array | float = 0.0) -> Float32Array:
        """The part of the difference, less some light, that is sure; 0 where its sign is not."""
        least, most = self.least_dn - light_dn, self.most_dn - light_dn
        return np.asarray(np.maximum(least, 0) + np.minimum(most, 0), dtype=np.float32)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ChannelDifference:
    """What is left of one channel, or of the luma, once its light and blur are explained.

    ``difference_dn``: after minus before in the follow-up's levels, smoothed. ``variance_dn2,
    noise_dn2``: predicted, and the part of it that is noise. ``rounding_dn2``: variance that the
    steps of the files give it at most, where they are known. ``seen_dn``: one of the photographs,
    smoothed. ``may_be_more, may_be_less``: pixels whose difference may be larger, or smaller, as an
    end of the scale hides it. ``valid``: pixels that models are fitted to.
    """

    difference_dn: Float32Array = field(repr=False)
    variance_dn2: Float32Array = field(repr=False)
    noise_dn2: Float32Array = field(repr=False)
    rounding_dn2: Float32Array | None = field(repr=False)
    seen_dn: Float32Array = field(repr=False)
    may_be_more: BoolArray = field(repr=False)
    may_be_less: BoolArray = field(repr=False)
    valid: BoolArray = field(repr=False)

    @property
    def is_at_an_end(self) -> BoolArray:
        """Pixels of which an end of the scale hides a part."""
        return self.may_be_more | self.may_be_less

    @property
    def structure_share(self) -> Float32Array:
        """Share of the variance that is not noise."""
        share = 1 - self.noise_dn2 / np.maximum(self.variance_dn2, np.float32(1e-30))
        return np.asarray(np.clip(share, 0, 1))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ColourPlanes:
    """Luma, red without what the luma predicts, and blue without what both do.

    ``difference_dn, sd_dn``: shape ``(3, rows, cols)``. ``by_others``: levels of red by one of the
    luma's, of blue by one of it, and of blue by one of the second plane's, likewise. ``steps_dn2``:
    variance of each by the steps of the files, None where they are not known.
    ``bounds``: of each plane, where an end of the scale hides something.
    """

    difference_dn: Float32Array = field(repr=False)
    sd_dn: Float32Array = field(repr=False)
    by_others: Float32Array = field(repr=False)
    steps_dn2: tuple[Float32Array | None, ...] = field(default=(None, None, None), repr=False)
    bounds: "tuple[Bounds, ...] | None" = field(default=None, repr=False)


def colour_planes(
    luma: ChannelDifference,
    channels: Sequence[ChannelDifference],
    step_correlation: FloatArray,
    smoothing_px: float,
) -> ColourPlanes:
    """Take off red and blue what the noise and the structure of the others predict.

    ``luma``: how that of the photographs was compared; what differs is taken of the ``channels``,
    each of which has its own light. ``step_correlation``: see `PairColours`. ``smoothing_px``:
    width of the Gaussian that makes neighbours alike.
    """
    red, _, blue = channels
    mixed: Float32Array = np.zeros(luma.difference_dn.shape, dtype=np.float32)
    for weight, channel in zip(REC601_LUMA, channels, strict=True):
        np.add(mixed, np.float32(weight) * channel.difference_dn, out=mixed)
    luma = replace(luma, difference_dn=mixed)
    valid = luma.valid & red.valid & blue.valid
    sds = [_predicted_sd(one, valid) for one in (luma, red, blue)]
    own, own_sd, own_bounds = _calibrated(mixed, sds[0], (luma,), luma.rounding_dn2, smoothing_px)
    luma = replace(luma, difference_dn=own)
    of_red, of_green, of_blue = (np.float32(weight) for weight in REC601_LUMA)
    with_luma, red_blue, with_luma_2 = _correlations((luma, red, blue), sds, valid)
    own_red = np.sqrt(1 - with_luma**2)
    # Of blue in standard deviations, by the second plane in its own.
    further = np.clip((red_blue - with_luma * with_luma_2) / own_red, -_MOST, _MOST)
    own_blue: Float32Array = np.sqrt(
        np.maximum(1 - with_luma_2**2 - further**2, np.float32(1 - _MOST**2))
    )
    # Noise that is far below the steps of a file predicts nothing of another channel's.
    by_luma, by_red = (
        np.maximum(sd, _least_sd(one, sd, valid))
        for one, sd in ((luma, sds[0]), (red, sds[1] * own_red))
    )
    by_steps = partial(_by_steps, channels, step_correlation)
    red_by_luma = with_luma * sds[1] / by_luma
    first = np.asarray(red.difference_dn - red_by_luma * own, dtype=np.float32)
    first_least = by_steps(
        1 - of_red * red_by_luma, -of_green * red_by_luma, -of_blue * red_by_luma
    )
    first, first_sd, first_bounds = _calibrated(
        first, sds[1] * own_red, (red, luma), first_least, smoothing_px
    )
    blue_by_luma = with_luma_2 * sds[2] / by_luma
    blue_by_red = further * sds[2] / by_red
    second = np.asarray(
        blue.difference_dn - blue_by_luma * own - blue_by_red * first, dtype=np.float32
    )
    by_all = blue_by_luma - blue_by_red * red_by_luma
    second_least = by_steps(
        -blue_by_red - of_red * by_all, -of_green * by_all, 1 - of_blue * by_all
    )
    second, second_sd, second_bounds = _calibrated(
        second, sds[2] * own_blue, (blue, luma), second_least, smoothing_px
    )
    is_compared = ~(luma.may_be_more & luma.may_be_less)
    bounds = tuple(
        one or Bounds.none(plane)
        for one, plane in ((own_bounds, own), (first_bounds, first), (second_bounds, second))
    )
    return ColourPlanes(
        difference_dn=np.stack([own, first, second]),
        sd_dn=np.stack([own_sd, first_sd, second_sd]),
        by_others=np.stack([red_by_luma, blue_by_luma, blue_by_red]),
        steps_dn2=(luma.rounding_dn2, first_least, second_least),
        bounds=bounds if any(one.hidden[is_compared].any() for one in bounds) else None,
    )


def to_channels(planes_dn: FloatArray, by_others: AnyArray) -> FloatArray:
    """Luma, red and blue of differences in the planes, shape ``(3, ...)`` each."""
    luma, first, second = planes_dn
    red_by_luma, blue_by_luma, blue_by_red = by_others
    red = first + red_by_luma * luma
    return np.stack([luma, red, second + blue_by_luma * luma + blue_by_red * first])


def _by_steps(
    channels: Sequence[ChannelDifference],
    correlation: FloatArray,
    *weights: AnyArray,
) -> Float32Array | None:
    """Variance by the steps of the files of a weighted sum of the channels; None if not known."""
    total: Float32Array | None = None
    sds = list[Float32Array]()
    for weight, channel in zip(weights, channels, strict=True):
        if channel.rounding_dn2 is None:
            return None
        sds.append(np.asarray(weight, dtype=np.float32) * np.sqrt(channel.rounding_dn2))
    for number, sd in enumerate(sds):
        own = sd * sd
        for other in range(number):
            own += np.float32(2 * correlation[number, other]) * sd * sds[other]
        total = own if total is None else total + own
    return None if total is None else np.maximum(total, np.float32(0))


def _predicted_sd(channel: ChannelDifference, valid: BoolArray) -> Float32Array:
    """Predicted standard deviation, as large as most of the differences say."""
    sd: Float32Array = np.sqrt(np.maximum(channel.variance_dn2, _LEAST_DN2))
    rows, cols = sampled(valid, _SAMPLE_PX)
    if not len(rows):
        return sd
    spread = robust_sigma(channel.difference_dn[rows, cols] / sd[rows, cols])
    return np.asarray(sd * np.float32(max(spread, _LEAST_SPREAD)), dtype=np.float32)


def _least_sd(channel: ChannelDifference, sd: Float32Array, valid: BoolArray) -> Float32Array:
    """Standard deviation below which a channel's noise is not what its difference shows."""
    rows, cols = sampled(valid, _SAMPLE_PX)
    usual = np.float32(_LEAST_OF_USUAL * np.median(sd[rows, cols]) if len(rows) else 0)
    if channel.rounding_dn2 is None:
        return np.full_like(sd, usual)
    return np.maximum(np.float32(_LEAST_OF_STEPS) * np.sqrt(channel.rounding_dn2), usual)


def _correlations(
    channels: tuple[ChannelDifference, ChannelDifference, ChannelDifference],
    sds: Sequence[Float32Array],
    valid: BoolArray,
) -> tuple[Float32Array, Float32Array, Float32Array]:
    """Those of luma and red, of red and blue, and of luma and blue."""
    luma, red, blue = channels
    shares = [channel.structure_share for channel in channels]
    of_red, _, of_blue = (np.float32(weight) for weight in REC601_LUMA)
    return (
        _correlation((luma, red), (shares[0], shares[1]), of_red * sds[1] / sds[0], valid),
        _correlation((red, blue), (shares[1], shares[2]), None, valid),
        _correlation((luma, blue), (shares[0], shares[2]), of_blue * sds[2] / sds[0], valid),
    )


def _correlation(
    pair: tuple[ChannelDifference, ChannelDifference],
    shares: tuple[Float32Array, Float32Array],
    own_share: Float32Array | None,
    valid: BoolArray,
) -> Float32Array:
    """Correlation of two channels' differences at each pixel, by noise and by structure.

    ``own_share``: of the luma's standard deviation, what the other channel makes by itself. Where
    noise does not tie the channels together, it is that much of the luma's, which differs with the
    colour of the scene; None of two channels.
    """
    rows, cols = sampled(valid, _SAMPLE_PX)
    noise = np.sqrt((1 - shares[0]) * (1 - shares[1]))
    # What an end of the scale hides is not the other's noise.
    noise[pair[0].is_at_an_end | pair[1].is_at_an_end] = 0
    if not len(rows):
        return np.zeros_like(noise)
    scaled = [
        channel.difference_dn[rows, cols]
        / np.sqrt(np.maximum(channel.variance_dn2[rows, cols], 1e-30))
        for channel in pair
    ]
    scaled = [one / max(robust_sigma(one), 1e-12) for one in scaled]
    counts = (np.abs(scaled[0]) < _CLIP_SD) & (np.abs(scaled[1]) < _CLIP_SD)
    if not counts.any():
        return np.zeros_like(noise)
    product = scaled[0][counts] * scaled[1][counts] / _CLIPPED_VARIANCE
    parts = [(noise, -1.0, 1.0)]
    if own_share is not None:
        parts.append((noise * np.minimum(own_share, np.float32(1)), 0.0, 1.0))
    if max(float(share[rows, cols].mean()) for share in shares) >= _LEAST_STRUCTURE:
        alike = _slopes_alike(pair[0].seen_dn, pair[1].seen_dn)
        parts.append((alike * np.sqrt(shares[0] * shares[1]), 0.0, _MOST_STRUCTURE))
    design = np.stack([image[rows, cols][counts] for image, *_ in parts], axis=1).astype(np.float64)
    scale = np.maximum(np.sqrt(np.mean(design**2, axis=0)), 1e-6)
    low, high = np.array([limits for _, *limits in parts]).T * scale
    sizes = lsq_linear(design / scale, product, (low, high)).x / scale
    total = np.zeros_like(noise)
    for size, (image, *_) in zip(sizes.tolist(), parts, strict=True):
        total += np.float32(size) * image
    return np.asarray(np.clip(total, -_MOST, _MOST), dtype=np.float32)


def _slopes_alike(one: Float32Array, other: Float32Array) -> Float32Array:
    """Cosine of the angle between the slopes of two images, over a window."""
    slope = np.array([-0.5, 0.0, 0.5], dtype=np.float32)
    still = np.ones(1, dtype=np.float32)
    slopes = [
        (cv2.sepFilter2D(image, -1, slope, still), cv2.sepFilter2D(image, -1, still, slope))
        for image in (one, other)
    ]
    own, its, both = (
        smoothed(np.asarray(first[0] * second[0] + first[1] * second[1]), _WINDOW_PX)
        for first, second in (
            (slopes[0], slopes[0]),
            (slopes[1], slopes[1]),
            (slopes[0], slopes[1]),
        )
    )
    return np.asarray(both / np.sqrt(np.maximum(own * its, np.float32(1e-30))))


def _calibrated(
    difference: Float32Array,
    sd: Float32Array,
    channels: Sequence[ChannelDifference],
    least_dn2: Float32Array | None,
    smoothing_px: float,
) -> "tuple[Float32Array, Float32Array, Bounds | None]":
    """A plane, 0 where nothing is known of it, its calibrated standard deviation, and bounds.

    ``channels``: the one that it is of, and another whose pixels are to be valid too.
    ``least_dn2``: variance by the steps of the files, where that is known.
    """
    channel = channels[0]
    variance: Float32Array = np.asarray(np.maximum(np.square(sd), _LEAST_DN2), dtype=np.float32)
    noise = variance * (1 - channel.structure_share)
    valid = np.logical_and.reduce([one.valid for one in channels])
    found = sd
    if valid.any():
        factor = calibrated_factor(difference, variance, noise, valid, smoothing_px, _CALIBRATED_PX)
        found = factor * np.sqrt(variance)
    if least_dn2 is not None:
        found = np.maximum(found, np.sqrt(least_dn2))
    found = np.asarray(found, dtype=np.float32)
    bounds = Bounds.of(difference, found, channel.may_be_more, channel.may_be_less)
    return (difference if bounds is None else bounds.surely(), found, bounds)


_skimage = lazy.load("skimage")

_TO_XYZ: Final = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)
_LEAST_SHARE: Final = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class SeenDifference:
    """Of two colours, before and after.

    ``delta_e``: CIEDE2000. ``is_of_colour``: whether it is more of colour, at one luma, than of
    lightness.
    """

    delta_e: float
    is_of_colour: bool

    @classmethod
    def of(cls, before_rgb: FloatArray, after_rgb: FloatArray, white_dn: float) -> "SeenDifference":
        """Compare linear levels of red, green and blue, shape ``(3,)`` each."""
        before, after = (
            np.clip(one / white_dn, _LEAST_SHARE, None) for one in (before_rgb, after_rgb)
        )
        light = [float(one @ np.asarray(REC601_LUMA)) for one in (before, after)]
        seen, lit, own = (_lab(one) for one in (before, before * light[1] / light[0], after))
        grey = [_lab(np.full(3, one)) for one in light]
        return cls(
            delta_e=_delta_e(seen, own),
            is_of_colour=_delta_e(lit, own) > _delta_e(grey[0], grey[1]),
        )


def _lab(rgb: FloatArray) -> FloatArray:
    return np.asarray(_skimage.color.xyz2lab(_TO_XYZ @ rgb))


def _delta_e(one: FloatArray, other: FloatArray) -> float:
    return float(_skimage.color.deltaE_ciede2000(one, other))
