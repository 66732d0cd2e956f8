"""Two photographs compared on the pixels of the coarser one.

The nearer photograph is the source, the other the target. Both are smoothed, by Gaussians that
bring them to one sharpness; the source is resampled on the target's pixels and a kernel fitted to
the pair takes it to the target. What remains is compared with its own scatter.
"""

from dataclasses import dataclass, field
from math import sqrt

import cv2
import numpy as np

from analysis.changes import matching_kernel, residual_variance
from analysis.changes.document import KernelOrigin
from analysis.changes.matching_kernel import MatchingKernel
from analysis.changes.options import ChangeOptions
from analysis.changes.relative_blur import RelativeBlur, Smoothing, relative_blur, smoothing_for
from analysis.changes.residual_variance import VarianceTerms
from analysis.changes.smoothed_warp import PixelPositions, smoothed, spline_coefficients
from analysis.changes.threshold import significance_threshold
from analysis.changes.variance_calibration import calibrate_variance
from analysis.errors import OverlapError
from calibration.registration import DistortedPose
from simulation import Psf, PsfField
from simulation.arrays import AnyArray, BoolArray, Float32Array, FloatArray, FloatImage, IntArray

_LEAST_PIXELS = 1000
_SAMPLE = 25_000
_CALIBRATION_SAMPLE = 500_000
_SEED = 20
_ROUNDS = 3
_OUTLIER_SD, _OUTLIER_REACH_PX = 4.5, 2
_CHANGE_REACH_PX = 5
_CALIBRATION_ROUNDS = 3
_CALIBRATION_RATE = 0.05
"""Pixels a frame flagged by chance where changes are kept out of the calibration."""

_BORDER_SD = 3.0
_CLIPPED_SD, _CLIPPED_PX = 2.0, 3.0
"""Reach of a clipped pixel: so many widths of the smoothing, and pixels."""

_COMMON_PSF_PX2 = 0.64
"""Variance of a common camera's PSF, for a first guess."""

_BLUR_ERR_PX2 = 1.0
"""How far the relative blur of two photographs may be from that guess."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Comparison:
    """What is left between two photographs once pose, blur and light are explained.

    Images are on the grid of the coarser photograph, shape ``(rows, cols)`` each; 0 where not
    ``valid``.

    Parameters
    ----------
    is_on_followup
        Whether the grid is that of the follow-up's pixels; the reference's if not.
    difference_dn
        After minus before in the follow-up's levels, smoothed.
    plain_difference_dn
        The same with the nearer photograph merely resampled.
    sd_dn
        Standard deviation of the difference.
    valid
        Pixels that were compared.
    smoothing_px
        Width of the Gaussian that smoothed the follow-up, in pixels of the grid.
    kernel
        Where the blur between the photographs is known from.
    extra_blur_px2, extra_blur_err_px2
        Variance by which the follow-up is softer than the calibration says, or than the reference
        where there is none, in follow-up pixels; and its standard error, infinite without detail.
    gain
        Mean gain of light, follow-up over reference.
    noise_dn2
        Variance of the noise in a follow-up pixel if both photographs had the same.
    registration_err_px, width_err_px2
        Standard deviations of the registration along the gradient, and of the variance by which
        the fitted blur is wrong.
    warnings
        Sentences on what makes the comparison doubtful.
    """

    is_on_followup: bool
    difference_dn: FloatImage
    plain_difference_dn: FloatImage
    sd_dn: FloatImage
    valid: BoolArray
    smoothing_px: float
    kernel: KernelOrigin
    extra_blur_px2: float
    extra_blur_err_px2: float
    gain: float
    noise_dn2: float
    registration_err_px: float
    width_err_px2: float
    warnings: tuple[str, ...] = ()

    @property
    def significance(self) -> FloatImage:
        """Difference over its standard deviation."""
        return np.asarray(np.where(self.valid, self.difference_dn / self.sd_dn, 0))

    @property
    def extra_blur_significance(self) -> float:
        """Extra blur over its standard error."""
        return self.extra_blur_px2 / self.extra_blur_err_px2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Pair:
    """The two photographs in the roles that the comparison gives them.

    ``source`` is the nearer one, ``target`` the other; ``usable`` marks pixels that count.
    """

    source: Float32Array = field(repr=False)
    target: Float32Array = field(repr=False)
    positions: PixelPositions = field(repr=False)
    source_usable: BoolArray = field(repr=False)
    target_usable: BoolArray = field(repr=False)

    def valid(self, smoothing: Smoothing) -> BoolArray:
        """Pixels of the target that nothing unusable reaches."""
        zoom = self.positions.zoom
        border = matching_kernel.RADIUS_PX + _BORDER_SD * max(
            smoothing.source_px, smoothing.target_px
        )
        far = [
            _CLIPPED_PX + _CLIPPED_SD * width
            for width in (smoothing.source_px * zoom, smoothing.target_px)
        ]
        seen = self.positions.inside(_away(~self.source_usable, far[0]), border * zoom)
        return seen & _away(~self.target_usable, far[1]) & _inner(seen.shape, border)


def _away(mask: BoolArray, distance_px: float) -> BoolArray:
    """Pixels further than this from all of a mask."""
    if not mask.any():
        return np.ones(mask.shape, dtype=np.bool_)
    apart = cv2.distanceTransform((~mask).astype(np.uint8), cv2.DIST_L2, cv2.DIST_MASK_5)
    return np.asarray(apart > distance_px)


def _inner(shape: tuple[int, int], border_px: float) -> BoolArray:
    inner = np.zeros(shape, dtype=np.bool_)
    border = int(np.ceil(border_px))
    inner[border:-border, border:-border] = True
    return inner


def compare(
    reference: AnyArray,
    followup: AnyArray,
    psf: Psf | PsfField | None,
    pose: DistortedPose,
    options: ChangeOptions,
) -> Comparison:
    """Compare two aligned photographs.

    Parameters
    ----------
    reference, followup
        Grey, shape ``(rows, cols)``.
    psf
        Total PSF of the camera, if it is known.
    pose
        Of the follow-up in the reference.
    options
        Noise, masks and white levels.

    Raises
    ------
    OverlapError
        If the photographs share too little.
    """
    is_on_followup = pose.zoom >= 1
    pair = _pair(reference, followup, pose, options)
    zoom = pair.positions.zoom
    guess = _COMMON_PSF_PX2 * (1 - 1 / zoom**2)
    rough = pair.valid(smoothing_for(guess))
    if int(rough.sum()) < _LEAST_PIXELS:
        raise OverlapError(
            "the photographs overlap too little; retake the follow-up with more overlap",
            shared_px=int(rough.sum()),
        )
    blur = relative_blur(pair.source, pair.target, pair.positions, rough, guess)
    smoothing = smoothing_for(blur.towards(guess, _BLUR_ERR_PX2))
    valid = pair.valid(smoothing)
    seen = pair.positions.seen(spline_coefficients(pair.source, smoothing.source_px * zoom))
    target = smoothed(pair.target, smoothing.target_px)
    valid &= np.isfinite(seen)
    seen = np.nan_to_num(seen, nan=float(seen[valid].mean()))
    fit = _Fit.of(pair, seen, target, valid)
    difference = target - fit.kernel.of(seen)
    variance = fit.terms.variance(fit.sizes)
    scale = _calibrated(difference, variance, valid, smoothing.target_px)
    sd = np.sqrt(variance) * scale
    gain = fit.kernel.gain(seen.shape)
    plain = pair.positions.seen(spline_coefficients(pair.source, 0.0))
    plain = smoothed(np.nan_to_num(plain, nan=fit.kernel.level_dn), smoothing.target_px)
    plain = (
        target - gain * (plain - np.float32(fit.kernel.level_dn)) - fit.kernel.offset(seen.shape)
    )
    smoothing_px = smoothing.target_px
    mean_gain = float(gain[valid].mean())
    own, other = matching_kernel.white_noise_gain(
        fit.kernel.taps, smoothing.source_px, smoothing.target_px, zoom
    )
    noise = float(
        np.median(fit.terms.variance(np.concatenate([fit.sizes[:2], np.zeros(4)]))[valid])
    )
    if not is_on_followup:
        # The difference is before minus after in the reference's levels.
        difference, plain, sd = (np.asarray(image / gain) for image in (-difference, -plain, sd))
        smoothing_px = smoothing.source_px
    return Comparison(
        is_on_followup=is_on_followup,
        difference_dn=np.where(valid, difference, np.float32(0)),
        plain_difference_dn=np.where(valid, plain, np.float32(0)),
        sd_dn=sd,
        valid=valid,
        smoothing_px=smoothing_px,
        kernel="pair",
        extra_blur_px2=blur.value_px2 if is_on_followup else -blur.value_px2 * zoom**2,
        extra_blur_err_px2=blur.err_px2,
        gain=mean_gain if is_on_followup else 1 / mean_gain,
        noise_dn2=noise / (own + other),
        registration_err_px=sqrt(fit.sizes[residual_variance.GRADIENT]) / abs(mean_gain),
        width_err_px2=sqrt(fit.sizes[residual_variance.LAPLACIAN]) / abs(mean_gain),
    )


def _pair(
    reference: AnyArray, followup: AnyArray, pose: DistortedPose, options: ChangeOptions
) -> _Pair:
    images = [np.asarray(image, dtype=np.float32) for image in (reference, followup)]
    usable = [
        _usable(image, white) for image, white in zip(images, options.white_level_dn, strict=True)
    ]
    images = [np.nan_to_num(image) for image in images]
    if options.left_out is not None:
        usable[1] &= ~options.left_out
    towards = pose.to_reference_px
    if pose.zoom < 1:
        images, usable, towards = images[::-1], usable[::-1], pose.to_followup_px
    return _Pair(
        source=images[0],
        target=images[1],
        positions=PixelPositions.of(towards, images[1].shape, images[0].shape),
        source_usable=usable[0],
        target_usable=usable[1],
    )


def _usable(image: Float32Array, white_level_dn: float | None) -> BoolArray:
    white = float(np.nanmax(image)) if white_level_dn is None else white_level_dn
    clipped = image >= white - 0.5
    if clipped.mean() < 1e-4:
        clipped[:] = False
    return np.asarray(np.isfinite(image) & ~clipped)


def _sample(valid: BoolArray, count: int) -> tuple[IntArray, IntArray]:
    """Rows and columns of valid pixels: all of them, or about so many at random."""
    total = int(valid.sum())
    if total <= count:
        rows, cols = np.nonzero(valid)
        return rows, cols
    rng = np.random.default_rng(_SEED)
    drawn = rng.integers(0, valid.size, round(count * valid.size / total))
    drawn = drawn[valid.ravel()[drawn]]
    rows, cols = np.unravel_index(drawn, valid.shape)
    return rows, cols


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Fit:
    """Kernel and variance of a pair."""

    kernel: MatchingKernel
    terms: VarianceTerms
    sizes: FloatArray

    @classmethod
    def of(cls, pair: _Pair, seen: Float32Array, target: Float32Array, valid: BoolArray) -> "_Fit":
        """Fit both in turns, changes left out."""
        rows, cols = _sample(valid, _SAMPLE)
        level = float(seen[valid].mean())
        design = matching_kernel.design_matrix(seen, level, rows, cols)
        measured = target[rows, cols].astype(np.float64)
        terms = _terms(pair, seen)
        at = terms.at(rows, cols)
        weight, kept = np.ones(len(rows)), np.ones(len(rows), dtype=np.bool_)
        for number in range(_ROUNDS):
            coefficients = matching_kernel.solve(design, measured, weight * kept)
            residual = measured - design @ coefficients
            sizes = residual_variance.fit_sizes(residual[kept], at[:, kept], None)
            variance = sizes @ at + 1e-12
            weight = matching_kernel.biweight(residual / np.sqrt(variance)) / variance
            kernel = MatchingKernel(coefficients=coefficients, level_dn=level)
            if number == _ROUNDS - 2:
                difference = target - kernel.of(seen)
                outlier = np.abs(difference) > _OUTLIER_SD * np.sqrt(terms.variance(sizes))
                kept = _away(outlier & valid, _OUTLIER_REACH_PX)[rows, cols]
        return cls(kernel=kernel, terms=terms, sizes=sizes)


def _terms(pair: _Pair, seen: Float32Array) -> VarianceTerms:
    detail = residual_variance.finest_detail(pair.source, 1.0)
    source_detail = np.nan_to_num(pair.positions.seen(detail))
    return VarianceTerms(
        level=residual_variance.level_term(seen),
        others=(
            residual_variance.gradient_term(seen),
            residual_variance.laplacian_term(seen),
            residual_variance.without_background(residual_variance.finest_detail(pair.target, 1.0)),
            residual_variance.without_background(source_detail),
        ),
    )


def _calibrated(
    difference: Float32Array, variance: Float32Array, valid: BoolArray, smoothing_px: float
) -> Float32Array:
    """Factor of the standard deviation, from pixels without a change."""
    pixels = int(valid.sum())
    threshold = significance_threshold(_CALIBRATION_RATE / pixels)
    kept = valid
    for _ in range(_CALIBRATION_ROUNDS):
        rows, cols = _sample(kept, _CALIBRATION_SAMPLE)
        calibration = calibrate_variance(
            difference[rows, cols].astype(np.float64),
            variance[rows, cols].astype(np.float64),
            pixels,
            smoothing_px,
        )
        factor = calibration.factor(variance)
        changed = valid & (np.abs(difference) > threshold * factor * np.sqrt(variance))
        now = valid & _away(changed, _CHANGE_REACH_PX)
        if np.array_equal(now, kept):
            break
        kept = now
    return factor
