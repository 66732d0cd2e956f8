"""Light, kernel and scatter fitted to two smoothed photographs, as simple as the pair allows.

With ``L`` the source in the target's light and ``M = s L + t T`` the mean of both, weighted so that
its noise is not correlated with that of their difference, ``T - L`` is explained as a kernel on M.
The noise of the source then pulls neither the kernel towards nothing, nor the gain below what it
is; and before against after is minus after against before.

Parts of the frame that a model was not fitted to decide how much it needs: gain and offset, light
that changes over the frame, a kernel, one that changes. Kernel and scatter are fitted in turns.
"""

from dataclasses import dataclass, field, replace
from math import pi
from typing import Self

import numpy as np

from analysis.changes.matching._matching_kernel import (
    CENTRE_TAP,
    LADDER,
    NO_KERNEL,
    MatchingKernel,
    NormalEquations,
    WhiteNoiseGain,
    biweight,
    design_matrix,
    white_noise_gain,
)
from analysis.changes.matching._smoothed_warp import light_at_first, pixel_noise_dn, sampled
from analysis.changes.matching._variance import (
    GRADIENT,
    LAPLACIAN,
    VarianceTerms,
    fit_sizes,
    is_noise,
)
from analysis.changes.matching.relative_blur import Smoothing
from simulation.arrays import BoolArray, Float32Array, FloatArray, IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairModel:
    """Light and kernel between a source and a target.

    ``gain, offset_dn``: of the light, before the kernel. ``target_share``: weight of the target in
    the mean of both.
    """

    gain: float
    offset_dn: float
    target_share: float = 0.5
    kernel: MatchingKernel = field(default=NO_KERNEL, repr=False)

    def brought(self, source: Float32Array) -> Float32Array:
        """The source in the target's light."""
        return np.asarray(source * np.float32(self.gain) + np.float32(self.offset_dn))

    def middle(self, source: Float32Array, target: Float32Array) -> Float32Array:
        """Mean of both."""
        share = np.float32(self.target_share)
        own = self.brought(source)
        own *= 1 - share
        own += share * target
        return own

    def difference(self, source: Float32Array, target: Float32Array) -> Float32Array:
        """Target less what the source and the model make of it."""
        apart = target - self.brought(source)
        apart -= self.kernel.of(self.middle(source, target))
        # A level that only the target has is partly in the kernel's mean.
        grown, _ = self.kernel.light((target.shape[0], target.shape[1]))
        apart /= 1 - np.float32(self.target_share) * grown
        return np.asarray(apart)

    def difference_at(
        self,
        source: Float32Array,
        target: Float32Array,
        middle: Float32Array,
        rows: IntArray,
        cols: IntArray,
    ) -> FloatArray:
        """The same, up to the share of the target in the mean, at pixels away from the border."""
        own = target[rows, cols].astype(np.float64)
        apart = own - (self.gain * source[rows, cols] + self.offset_dn)
        return apart - self.kernel.at(middle, rows, cols)

    def light(self, shape: tuple[int, int]) -> tuple[Float32Array, Float32Array]:
        """Gain and offset that take the source to the target, at every pixel."""
        grown, added = self.kernel.light(shape)
        added -= grown * np.float32(self.kernel.level_dn)
        more = 1 + np.float32(1 - self.target_share) * grown
        added += np.float32(self.offset_dn) * more
        less = 1 - np.float32(self.target_share) * grown
        return np.float32(self.gain) * more / less, added / less

    def noise_gain(self, smoothing: Smoothing, zoom: float) -> WhiteNoiseGain:
        """What smoothing and model leave of white noise of variance 1 in either photograph."""
        taps = self.kernel.taps
        none = np.zeros_like(taps)
        none.flat[CENTRE_TAP] = 1.0
        left = 1 - self.target_share * float(taps.sum())
        source = self.gain * (none + (1 - self.target_share) * taps) / left
        target = (none - self.target_share * taps) / left
        return white_noise_gain(source, smoothing, zoom, target)


SAMPLE_PX = 25_000
_ROUNDS = 3
_OUTLIER_SD, _OUTLIER_REACH_PX = 4.5, 2.0
"""Pixels that are left out of the last round, with their neighbours."""

_LEAST_DN2 = 1e-12

_LIGHT_ROUNDS = 6
_BLOCK_PX = 24
_SURELY = 3.0
"""Standard errors by which a model must do better on parts that were held out, to be taken."""

_MOST_LOSS, _LESS_LOSS = 9.0, 0.05
"""Of a pixel, by the square of its standard deviations, as changes are outliers; and by how much
less a second light must lose on the average to be taken."""

_ALIKE = 1.25
"""Factor between two gains up to which a second light is not looked for."""

_POWERS = (2, 3, 4)
_CURVED_CHI2 = 60.0
"""Chi-squared of three powers of the level from which on a tone curve is needed; 16 is exceeded by
chance in one pair of a thousand, and what compression and clipping bend is more."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairFit:
    """What takes the source to the target, and what the remaining difference scatters by.

    ``sizes``: of the terms of the variance. ``is_curved``: whether the levels of the two are not in
    proportion, beyond what chance does. ``loss``: mean of minus twice the logarithm of a pixel's
    likelihood, which is that of an outlier at least.
    """

    model: PairModel
    sizes: FloatArray
    is_curved: bool
    loss: float


@dataclass(frozen=True, slots=True, kw_only=True)
class FitRules:
    """How a pair is fitted.

    ``smoothing_px``: width of the Gaussian that makes neighbours alike. ``target_share``: share of
    the source's noise in both, in the target's light: see `PairModel`. ``sample_px``: pixels that
    the fit is made to. ``is_one_view``: whether the photographs are of one view, for which simple
    models may do.
    """

    smoothing_px: float
    target_share: float = 0.5
    sample_px: int = SAMPLE_PX
    is_one_view: bool = False


def fit_pair(
    source: Float32Array,
    target: Float32Array,
    terms: VarianceTerms,
    valid: BoolArray,
    floor_dn2: Float32Array | None,
    rules: FitRules,
) -> PairFit:
    """Fit model and variance to a sample of the pixels.

    ``source, target``: smoothed, shape ``(rows, cols)``, finite. ``valid``: pixels that count, the
    kernel's radius away from the border. ``floor_dn2``: variance that the difference has at least,
    by a noise model or the files' steps.
    """
    rows, cols = sampled(valid, rules.sample_px)
    sample = _Sample(
        rows=rows,
        cols=cols,
        source=source[rows, cols].astype(np.float64),
        target=target[rows, cols].astype(np.float64),
        at=terms.at(rows, cols),
        floor=np.full(len(rows), _LEAST_DN2)
        if floor_dn2 is None
        else np.maximum(floor_dn2[rows, cols].astype(np.float64), _LEAST_DN2),
    )
    light = sample.light(rules.target_share)
    middle = light.middle(source, target)
    level = float(middle[rows, cols].mean())
    design = design_matrix(middle, level, rows, cols)
    apart = sample.target - (light.gain * sample.source + light.offset_dn)
    weight, sizes = sample.weights(apart - np.median(apart))
    columns = LADDER[-1]
    if rules.is_one_view:
        columns = _needed(design, apart, weight, sample, target.shape[1])
    kept = np.ones(len(rows), dtype=np.bool_)
    for number in range(_ROUNDS):
        equations = NormalEquations.of(design, apart, weight * kept)
        kernel = MatchingKernel(coefficients=equations.solution(columns), level_dn=level)
        residual = apart - design @ kernel.coefficients
        weight, sizes = sample.weights(residual, kept)
        model = replace(light, kernel=kernel)
        if number == _ROUNDS - 2:
            beside = _Neighbours.of(rows, cols, valid)
            floor = None if floor_dn2 is None else floor_dn2[beside.rows, beside.cols]
            variance = sizes @ terms.at(beside.rows, beside.cols)
            reach = _OUTLIER_SD * np.sqrt(
                np.maximum(variance, _LEAST_DN2 if floor is None else floor)
            )
            left = model.difference_at(source, target, middle, beside.rows, beside.cols)
            kept = ~beside.any_of(np.abs(left) > reach)
    alike = 4 * pi * rules.smoothing_px**2 / np.count_nonzero(valid) * len(rows) + 1
    curved = _curvature_chi2(design, residual, weight * kept / alike) > _CURVED_CHI2
    loss = sample.loss(residual, sizes)
    return PairFit(model=model, sizes=sizes, is_curved=curved, loss=loss)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Sample:
    """Pixels that a fit is made to: levels, terms of the variance, and what it is at least."""

    rows: IntArray
    cols: IntArray
    source: FloatArray
    target: FloatArray
    at: FloatArray
    floor: FloatArray

    def weights(
        self, residual: FloatArray, kept: BoolArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Robust weights of the pixels, and the sizes of the variance's terms."""
        some = np.ones(len(residual), dtype=np.bool_) if kept is None else kept
        sizes = fit_sizes(residual[some], self.at[:, some], self.floor[some])
        variance = np.maximum(sizes @ self.at, self.floor)
        return biweight(residual / np.sqrt(variance)) / variance, sizes

    def light(self, target_share: float) -> PairModel:
        """Gain and offset by robust regression of the difference on the mean of both.

        Where something large stands before the scene, what is behind it is best explained by one
        level for all: a second regression begins with light that differs by a factor alone, and
        with what that explains.
        """
        every = np.ones(len(self.source))
        first = self._light(light_at_first(self.source, self.target), every, target_share)
        levels = [float(np.median(image)) for image in (self.source, self.target)]
        if min(levels) <= 0:
            return first
        gain = levels[1] / levels[0]
        if 1 / _ALIKE <= first.gain / gain <= _ALIKE:
            return first
        weight, _ = self.weights(self.target - gain * self.source)
        second = self._light((gain, 0.0), weight if weight.any() else every, target_share)
        losses = []
        for each in (first, second):
            apart = self.target - (each.gain * self.source + each.offset_dn)
            losses.append(self.loss(apart, self.weights(apart)[1]))
        return second if losses[1] < losses[0] - _LESS_LOSS else first

    def _light(
        self, start: tuple[float, float], weight: FloatArray, target_share: float
    ) -> PairModel:
        gain, offset = start
        for _ in range(_LIGHT_ROUNDS):
            brought = gain * self.source + offset
            middle = (1 - target_share) * brought + target_share * self.target
            apart = self.target - brought
            total = weight.sum()
            mean = float(weight @ middle) / total
            level = middle - mean
            spread = float(weight @ level**2)
            grown = float(weight @ (level * apart)) / spread if spread > 0 else 0.0
            added = float(weight @ apart) / total
            weight, _ = self.weights(apart - grown * level - added)
            if not weight.any():
                weight = np.ones(len(self.source))
            more, less = 1 + (1 - target_share) * grown, 1 - target_share * grown
            gain, offset = gain * more / less, (offset * more + added - grown * mean) / less
        return PairModel(gain=gain, offset_dn=offset, target_share=target_share)

    def loss(self, residual: FloatArray, sizes: FloatArray) -> float:
        """See `PairFit`."""
        return float(np.mean(_losses(residual, np.maximum(sizes @ self.at, self.floor))))


def _losses(residual: FloatArray, variance: FloatArray) -> FloatArray:
    return np.asarray(np.log(variance) + np.minimum(residual**2 / variance, _MOST_LOSS))


def _needed(
    design: FloatArray, apart: FloatArray, weight: FloatArray, sample: _Sample, width: int
) -> BoolArray:
    """Columns of the simplest model that does as well as any where it was not fitted."""
    block_row, block_col = sample.rows // _BLOCK_PX, sample.cols // _BLOCK_PX
    half = (block_row + block_col) % 2 == 0
    block = block_row * (width // _BLOCK_PX + 1) + block_col
    losses = np.zeros((len(LADDER), len(apart)))
    for own in (half, ~half):
        if np.count_nonzero(own) < design.shape[1] or np.count_nonzero(~own) < design.shape[1]:
            return LADDER[-1]
        equations = NormalEquations.of(design[own], apart[own], weight[own])
        for number, columns in enumerate(LADDER):
            residual = apart - design @ equations.solution(columns)
            sizes = fit_sizes(residual[own], sample.at[:, own], sample.floor[own])
            variance = np.maximum(sizes @ sample.at, sample.floor)[~own]
            losses[number, ~own] = _losses(residual[~own], variance)
    best = int(np.argmin(losses.sum(axis=1)))
    for number in range(best):
        worse = np.bincount(block, weights=losses[number] - losses[best])
        if worse.sum() < _SURELY * np.sqrt(np.sum(np.square(worse))):
            return LADDER[number]
    return LADDER[best]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Neighbours:
    """Pixels of a mask within an outlier's reach of samples, and which samples they are near.

    A sample of a large frame has far fewer of them than the frame has pixels.
    """

    rows: IntArray
    cols: IntArray
    counts: BoolArray

    @classmethod
    def of(cls, rows: IntArray, cols: IntArray, mask: BoolArray) -> "_Neighbours":
        """Neighbours of samples that are the reach away from the border."""
        reach = int(_OUTLIER_REACH_PX)
        y, x = np.mgrid[-reach : reach + 1, -reach : reach + 1].reshape(2, -1, 1)
        y, x = (along[y**2 + x**2 <= _OUTLIER_REACH_PX**2][:, None] for along in (y, x))
        counts = mask[rows + y, cols + x]
        return cls(rows=(rows + y)[counts], cols=(cols + x)[counts], counts=counts)

    def any_of(self, marked: BoolArray) -> BoolArray:
        """Samples near a marked pixel, shape ``(samples,)``."""
        every = np.zeros(self.counts.shape, dtype=np.bool_)
        every[self.counts] = marked
        return np.asarray(every.any(axis=0))


def _curvature_chi2(design: FloatArray, residual: FloatArray, weight: FloatArray) -> float:
    """Chi-squared that powers of the mean level take from the residuals."""
    level = design[:, CENTRE_TAP]
    contrast = np.clip(level / max(float(level.std()), 1e-9), -3, 3)
    root = np.sqrt(weight)
    powers = np.stack([contrast**power * root for power in _POWERS], axis=1)
    rooted = design * root[:, None]
    # What kernel and light already explain of the powers tells nothing.
    powers -= rooted @ np.linalg.lstsq(rooted.T @ rooted, rooted.T @ powers, rcond=1e-12)[0]
    share = powers.T @ (residual * root)
    return float(share @ np.linalg.lstsq(powers.T @ powers, share, rcond=1e-12)[0])


_SAMPLE_PX = 25_000


@dataclass(frozen=True, slots=True, kw_only=True)
class FittedScatter:
    """Noise of a difference, and the shares of its variance that are none.

    ``gains``: of white noise in either photograph. ``noise_dn2``: mean variance by noise.
    ``white_dn2``: the part of it that the noise of single pixels explains. Compression and
    resampling take the finest noise away, and what they leave is alike in neighbours.
    ``structure_share``: share of the variance by positions, blur and the finest detail.
    ``displaced``: variance by positions that are wrong over the variance that was fitted: that of
    the gradient, and what the kernel leaves of a displacement that varies over the frame. Only
    roughly so where it is large.
    """

    gains: WhiteNoiseGain
    noise_dn2: float
    white_dn2: float
    structure_share: float
    displaced: float

    @classmethod
    def of(
        cls,
        fit: PairFit,
        terms: VarianceTerms,
        floor_dn2: Float32Array | None,
        valid: BoolArray,
        gains: WhiteNoiseGain,
        images: tuple[Float32Array, Float32Array],
    ) -> Self:
        """Read it off a fit, on a sample of the pixels ``valid``; ``images`` are the pair's."""
        rows, cols = sampled(valid, _SAMPLE_PX)
        at = terms.at(rows, cols)
        parts = fit.sizes[:, None] * at
        floor = 1e-12 if floor_dn2 is None else floor_dn2[rows, cols].astype(np.float64)
        whole = np.maximum(parts.sum(axis=0), floor)
        shares = np.mean(parts / whole, axis=1)
        # What varies of a displacement is in the kernel to first order; its square is left as blur.
        bent = fit.model.kernel.varying_shift_px2**2 * float(np.mean(at[LAPLACIAN] / whole))
        noise_dn2 = float(np.mean(np.maximum(parts[is_noise(len(parts))].sum(axis=0), floor)))
        source_dn = pixel_noise_dn(images[0])
        target_dn = pixel_noise_dn(images[1], valid)
        white_dn2 = gains.source * source_dn**2 + gains.target * target_dn**2
        return cls(
            gains=gains,
            noise_dn2=noise_dn2,
            white_dn2=min(white_dn2, noise_dn2),
            structure_share=float(shares[GRADIENT : LAPLACIAN + 3].sum()),
            displaced=float(shares[GRADIENT]) + bent,
        )

    @property
    def _unexplained_share(self) -> float:
        """Share of the variance that is not white noise."""
        correlated = 1 - self.white_dn2 / max(self.noise_dn2, 1e-30)
        return self.structure_share + (1 - self.structure_share) * correlated

    @property
    def displaced_share(self) -> float:
        """The part of it by positions that are wrong."""
        return min(self.displaced, self._unexplained_share)

    @property
    def unlike_share(self) -> float:
        """The part of it by what is not alike in both photographs: aliasing, compression, blur."""
        return self._unexplained_share - self.displaced_share
