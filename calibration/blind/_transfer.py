"""The lens that takes a near photograph to a far one, fitted to the pixels of both.

In pixels of the far photograph the kernel between both has the transfer function ``K(v) = H(v) /
H(A^-T v)``, where H is the transfer of lens and pixel, A takes far to near pixels and v is in
cycles per far pixel. K times the near photograph's spectrum, folded to the far pixels, predicts
these; displacement, brightness and an offset are fitted along. H has the parameters and the prior
of `_lens_prior`, and is found by Gauss-Newton with damping.

Residuals are compared as the cosines of blocks of eight pixels, each of the 64 with a variance of
its own, and those of a JPEG by the intervals that were rounded.

A near spectrum with noise, or with what the near pixels alias, would make K too low where the scene
is weak. Each frequency is multiplied by the share of its power that is neither (the regression of
far on near has that factor), where the aliased power is the lens's own beyond the Nyquist
frequency, with the scene's spectrum going on as a power of frequency.

References
----------
M. Delbracio, A. Almansa, P. Musé, J.-M. Morel, "Subpixel point spread function estimation from two
photographs at different distances", SIAM J. Imaging Sciences 5 (2012): the product of K over
distances. R. J. Carroll, D. Ruppert, L. A. Stefanski, C. M. Crainiceanu, Measurement Error in
Nonlinear Models, 2nd ed. (2006), chapter 4: regression calibration. D. W. Marquardt, J. SIAM 11
(1963) 431-441: the damping.
"""

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property
from math import pi

import numpy as np
import scipy.fft
from scipy.ndimage import gaussian_filter, map_coordinates

from calibration.blind._cosine_blocks import (
    BLOCK,
    EVEN_CODE,
    UsedBlocks,
    code_slopes,
    codes_of,
    within_interval,
)
from calibration.blind._lens_prior import (
    GAUSSIAN_PARAMETERS,
    ComplexArray,
    LensFactors,
    LensGrid,
    lens_prior,
    lens_transfer,
)
from calibration.blind._resampled_pair import Folding, ResampledPair
from calibration.edges import JpegCompression
from simulation.arrays import BoolArray, FloatArray, IntArray

_INDICES = BLOCK * BLOCK
_LEAST_SHARE = 0.3  # of a block's pixels that are used
DISPLACEMENT_DEGREE, GAIN_DEGREE = 3, 4
_REACH = 1.05  # of the polynomials' coordinates, 1 at the border of the used pixels
_SMOOTHING = 0.008  # of the spectrum's sides
_RING_CY_PER_PX = 0.004
_NOISE_EXCESS = 1.1  # over the weakest ring of fine detail, that its own scatter explains
_WEAKEST = 1e-3  # contrast below which no spectrum is divided by the lens
_LEAST_SCATTER = 4e-3  # of the far pixels' standard deviation: what interpolation is right to
_LEAST_CODE_VARIANCE = 1e-3
_LEAST_TOLD = 1e-2  # of a cosine's information that its interval leaves
_MOST_STEPS, _CONVERGED = 15, 0.05  # twice the log likelihood
_DAMPING, _LEAST_DAMPING, _MOST_TRIES = 1e-5, 1e-7, 8
_VARIANCE_ROUNDS = 5

_SLOPE_RADII_CY_PER_PX = np.array([0.2, 0.25, 0.3, 0.35, 0.4])
_FINE_RINGS_CY_PER_PX = np.linspace(0.3, 0.5, 11)
_KNOWN_CY_PER_PX = 0.35  # where the scene's power is read off, to be continued from
_FARTHEST_CY_PER_PX = 1.2
_SLOPES = (1.0, 6.0)
_USUAL_SLOPE = 3.0
_WEAKEST_POWER = 1e-3

_NEAR_SHARE = 0.5
"""Of what the far cosines of a JPEG scatter by: the far noise is there as well, and detail that
rounding took from the near ones."""

_FINE = np.add.outer(np.arange(BLOCK), np.arange(BLOCK)).ravel() >= 11


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LensFit:
    """A lens, the alignment beside it, and what the cosines scatter by.

    ``alignment`` holds displacements in far pixels along x and y, gains and an offset as
    coefficients, ``variance`` one value for each of the 64 cosines. ``information`` is the matrix
    of the lens's parameters from the pixels alone; ``repeated`` is how often their errors repeat
    themselves.
    """

    lens: FloatArray
    alignment: FloatArray
    variance: FloatArray
    information: FloatArray
    repeated: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Prediction:
    """Levels behind a lens and an alignment, and what their slopes are made of."""

    images: tuple[FloatArray, FloatArray, FloatArray]
    gain: FloatArray
    moved: FloatArray
    level: FloatArray
    cosines: FloatArray


class PairModel:
    """Far pixels as a lens predicts them from near ones."""

    def __init__(
        self, pair: ResampledPair, near_noise_dn2: float, compression: JpegCompression | None
    ) -> None:
        self.pair = pair
        rows, cols = pair.near_dn.shape
        fy = scipy.fft.fftfreq(rows, 1 / pair.finer)[:, None]
        fx = scipy.fft.rfftfreq(cols, 1 / pair.finer)[None, :]
        inverse = np.linalg.inv(pair.near_per_far)
        near_x, near_y = (inverse[0, k] * fx + inverse[1, k] * fy for k in (0, 1))
        self._kept = (np.abs(near_x) < 0.5) & (np.abs(near_y) < 0.5)
        fx, fy = np.broadcast_arrays(fx, fy)
        self._fx, self._fy = fx[self._kept], fy[self._kept]
        self._near_x, self._near_y = near_x[self._kept], near_y[self._kept]
        self._far_lens = LensGrid(self._fx, self._fy)
        self._near_lens = LensGrid(self._near_x, self._near_y)
        self._series = scipy.fft.rfft2(pair.near_dn)[self._kept]
        self._folding = Folding(pair, self._kept)
        # Every pixel of a block had a say in the numbers that JPEG has rounded.
        self._blocks = UsedBlocks(pair.used, 1.0 if compression else _LEAST_SHARE)
        self._compression = compression
        self._target = self._cosines(pair.far_dn)
        self._least_variance = (_LEAST_SCATTER * float(pair.far_dn[pair.used].std())) ** 2
        self._half_step: FloatArray | None = None
        if compression is not None:
            steps = np.tile(compression.steps.ravel(), self._blocks.count)
            self._target = np.rint(self._target / steps) * steps
            self._half_step = 0.5 * steps
        self.near_noise_dn2 = self._possible(near_noise_dn2)
        self._far_noise_dn2 = 0.0
        self._aliased_dn2: FloatArray = np.zeros(self._fx.shape)
        self._seen = self._series * self._true_share(self.near_noise_dn2, lens_prior().mean)

    @property
    def blocks(self) -> int:
        """Number of blocks of far pixels that are compared."""
        return self._blocks.count

    def start(self, lens: FloatArray) -> LensFit:
        """A lens, and the photographs as they were aligned."""
        alignment = np.zeros(2 * len(self._moves) + len(self._gains) + 1)
        alignment[2 * len(self._moves)] = 1.0
        nothing = LensFit(
            lens=lens,
            alignment=alignment,
            variance=np.ones(_INDICES),
            information=np.zeros((lens.size, lens.size)),
        )
        predicted = self._predicted(self._images(self._between(lens)), alignment)
        # Exposures and brightness may differ by anything: they are settled first.
        for _ in range(2):
            variance = self._variance(predicted, None)
            columns = self._aligning(predicted)
            residual, weight = self._compared(predicted, variance)
            weighted = columns * weight
            alignment = alignment + _solved(weighted @ columns.T, weighted @ residual)
            predicted = self._predicted(predicted.images, alignment)
        return replace(nothing, alignment=alignment, variance=self._variance(predicted, None))

    def fitted(self, fit: LensFit, *, is_gaussian: bool = False) -> LensFit:
        """Go on from a fit to the most probable lens; the first parameters alone if Gaussian."""
        prior = lens_prior()
        count = GAUSSIAN_PARAMETERS + 1 if is_gaussian else prior.mean.size
        precision = np.where(np.arange(prior.mean.size) < count, prior.precision, 0.0)
        lens, alignment = fit.lens, fit.alignment
        predicted = self._predicted(self._images(self._between(lens)), alignment)
        variance = self._variance(predicted, fit.variance)
        damping = _DAMPING
        for _ in range(_MOST_STEPS):
            columns = np.concatenate(
                [self._bending(lens, predicted, count), self._aligning(predicted)]
            )
            residual, weight = self._compared(predicted, variance)
            weighted = columns * weight
            data = weighted @ columns.T
            system, right = data.copy(), weighted @ residual
            system[range(count), range(count)] += prior.precision[:count]
            right[:count] += (precision * (prior.mean - lens))[:count]
            before = self._cost(predicted, variance) + precision @ (lens - prior.mean) ** 2
            for _ in range(_MOST_TRIES):
                step = _solved(system + damping * np.diag(np.diag(system)), right)
                tried, aligned = lens.copy(), alignment + step[count:]
                tried[:count] += step[:count]
                trial = self._predicted(self._images(self._between(tried)), aligned)
                after = self._cost(trial, variance) + precision @ (tried - prior.mean) ** 2
                if after <= before:
                    break
                damping *= 10
            else:
                break
            lens, alignment, predicted = tried, aligned, trial
            damping = max(0.1 * damping, _LEAST_DAMPING)
            if before - after < _CONVERGED:
                break
            variance = self._variance(predicted, variance)
        information = np.zeros((lens.size, lens.size))
        information[:count, :count] = _without(data, count)
        return LensFit(
            lens=lens,
            alignment=alignment,
            variance=variance,
            information=information,
            repeated=self._repeated(lens, variance),
        )

    def found_noise_dn2(self, fit: LensFit) -> float:
        """Noise of the near photograph, if it is what the far one scatters by."""
        if self._compression is None:
            return float(np.median(fit.variance[_FINE]))
        slope = code_slopes(self.pair.far_dn[self.pair.used], self._compression)
        return _NEAR_SHARE * float(np.median(fit.variance) * np.mean(slope**-2.0))

    def with_true_share(self, fit: LensFit, near_noise_dn2: float) -> "PairModel":
        """The model with the near spectrum less noise, and less what its pixels alias."""
        made = copy(self)
        made.near_noise_dn2 = self._possible(near_noise_dn2)
        if self._compression is None:
            made._far_noise_dn2 = float(np.median(fit.variance[_FINE]))
        made._aliased_dn2 = made._aliased(fit.lens)
        other_dn2 = made.near_noise_dn2 + made._aliased_dn2
        made._seen = self._series * made._true_share(other_dn2, fit.lens)
        return made

    def displacement(self, fit: LensFit) -> tuple[FloatArray, FloatArray]:
        """Of the far pixels of the pair, along x and y."""
        count = len(self._moves)
        along = (fit.alignment[:count], fit.alignment[count : 2 * count])
        x, y = (np.tensordot(part, self._moves, axes=1) for part in along)
        return x, y

    def _between(self, lens: FloatArray) -> ComplexArray:
        """K at the kept frequencies."""
        far, near = self._far_lens.factors(lens), self._near_lens.factors(lens)
        return far.transfer * _inverse(near.transfer)

    def _images(self, between: ComplexArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Near image behind K, and its derivatives along x and y."""
        series = self._seen * between
        right, down = 2j * pi * self._fx * series, 2j * pi * self._fy * series
        level = self._folding.image(series) + self.pair.near_mean_dn
        return level, self._folding.image(right), self._folding.image(down)

    def _predicted(
        self, images: tuple[FloatArray, FloatArray, FloatArray], alignment: FloatArray
    ) -> _Prediction:
        level, right, down = images
        count = len(self._moves)
        along_x, along_y = alignment[:count], alignment[count : 2 * count]
        gain = np.tensordot(alignment[2 * count : -1], self._gains, axes=1)
        moved = level + right * np.tensordot(along_x, self._moves, axes=1)
        moved += down * np.tensordot(along_y, self._moves, axes=1)
        level = gain * moved + alignment[-1]
        return _Prediction(
            images=images, gain=gain, moved=moved, level=level, cosines=self._cosines(level)
        )

    def _cosines(self, level_dn: FloatArray) -> FloatArray:
        """Of levels, or, for a JPEG, of their codes."""
        if self._compression is not None:
            level_dn = codes_of(level_dn, self._compression) - EVEN_CODE
        return self._blocks.cosines(level_dn)

    def _code_slope(self, predicted: _Prediction) -> FloatArray | float:
        if self._compression is None:
            return 1.0
        return np.asarray(code_slopes(predicted.level, self._compression))

    def _bending(self, lens: FloatArray, predicted: _Prediction, count: int) -> FloatArray:
        """Derivatives of the cosines by the first ``count`` parameters of the lens."""
        far, near = self._far_lens.factors(lens), self._near_lens.factors(lens)
        inverse = _inverse(near.transfer)
        between = far.transfer * inverse
        ahead = _scaled(far, self._seen * inverse)
        behind = _scaled(near, self._seen * inverse * between)
        factor = predicted.gain * self._code_slope(predicted)
        columns = np.empty((count, self._target.size))
        row = 0
        for name in ("widths", "even", "odd"):
            pieces = zip(getattr(self._far_lens, name), getattr(self._near_lens, name), strict=True)
            for on_far, on_near in pieces:
                if row == count:
                    return columns
                series = on_far * ahead[name] - on_near * behind[name]
                columns[row] = self._blocks.cosines(self._folding.image(series) * factor)
                row += 1
        return columns

    def _aligning(self, predicted: _Prediction) -> FloatArray:
        """Derivatives of the cosines by displacement, gain and offset."""
        slope = self._code_slope(predicted)
        _, right, down = predicted.images
        factor = predicted.gain * slope
        parts = [right * factor * move for move in self._moves]
        parts += [down * factor * move for move in self._moves]
        parts += [predicted.moved * slope * gain for gain in self._gains]
        parts.append(np.ones_like(predicted.moved) * slope)
        return np.stack([self._blocks.cosines(part) for part in parts])

    def _compared(
        self, predicted: _Prediction, variance: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Residuals and weights of a step: the score of each cosine is their product."""
        every = np.tile(variance, self._blocks.count)
        if self._half_step is None:
            return self._target - predicted.cosines, 1 / every
        known = within_interval(predicted.cosines, np.sqrt(every), self._target, self._half_step)
        told = np.maximum(1 - known.variance / every, _LEAST_TOLD)
        return (known.mean - predicted.cosines) / told, told / every

    def _variance(self, predicted: _Prediction, start: FloatArray | None) -> FloatArray:
        """Scatter of the 64 cosines about their prediction, by expectation-maximisation."""
        square = np.square(self._target - predicted.cosines).reshape(-1, _INDICES).mean(axis=0)
        if self._half_step is None:
            return np.asarray(square + self._least_variance)
        variance = square + _LEAST_CODE_VARIANCE if start is None else start
        for _ in range(_VARIANCE_ROUNDS):
            spread = np.sqrt(np.tile(variance, self._blocks.count))
            known = within_interval(predicted.cosines, spread, self._target, self._half_step)
            square = known.variance + np.square(known.mean - predicted.cosines)
            variance = square.reshape(-1, _INDICES).mean(axis=0) + _LEAST_CODE_VARIANCE
        return variance

    def _cost(self, predicted: _Prediction, variance: FloatArray) -> float:
        """Minus twice the log likelihood but for a constant."""
        every = np.tile(variance, self._blocks.count)
        if self._half_step is None:
            return float(np.sum(np.square(self._target - predicted.cosines) / every))
        known = within_interval(predicted.cosines, np.sqrt(every), self._target, self._half_step)
        return -2 * float(known.log_probability.sum())

    @cached_property
    def _coordinates(self) -> tuple[FloatArray, FloatArray]:
        """Along x and y, -1 and 1 at the border of the used pixels."""
        places = np.argwhere(self.pair.used)
        low, high = places.min(axis=0), places.max(axis=0)
        y, x = (
            np.clip(2 * (np.arange(count) - first) / max(last - first, 1) - 1, -_REACH, _REACH)
            for count, first, last in zip(self.pair.used.shape, low, high, strict=True)
        )
        return np.meshgrid(x, y)

    @cached_property
    def _moves(self) -> FloatArray:
        return monomials(*self._coordinates, DISPLACEMENT_DEGREE)

    @cached_property
    def _gains(self) -> FloatArray:
        return monomials(*self._coordinates, GAIN_DEGREE)

    @cached_property
    def _power(self) -> FloatArray:
        """Near power spectrum, smooth, as the variance of near pixels that noise would have."""
        rows, cols = self.pair.near_dn.shape
        power, kept = np.zeros(self._kept.shape), self._kept.astype(np.float64)
        # Spectra fall steeply: what is smoothed is what rings have beside their mean.
        usual = self._ring_power()
        power[self._kept] = np.abs(self._series) ** 2 / usual
        width = [_SMOOTHING * rows, _SMOOTHING * cols]
        smooth, share = (
            gaussian_filter(one, width, mode=["wrap", "nearest"]) for one in (power, kept)
        )
        scale = self.pair.near_px_per_sample / float(np.sum(self.pair.taper**2))
        made = scale * smooth / np.maximum(share, 1e-9)
        made[self._kept] *= usual
        return np.asarray(made)

    def _ring_power(self) -> FloatArray:
        """Mean power of each kept frequency's ring in the near photograph's spectrum."""
        ring = np.hypot(self._near_x, self._near_y) / _RING_CY_PER_PX
        number = np.rint(ring).astype(np.intp)
        count = np.bincount(number)
        total = np.bincount(number, np.abs(self._series) ** 2)
        seen = np.flatnonzero(count)
        level = np.log(np.maximum(total[seen] / count[seen], 1e-30))
        return np.asarray(np.exp(np.interp(ring, seen, level)))

    def _true_share(self, other_dn2: FloatArray | float, lens: FloatArray) -> FloatArray:
        """Share of the near power that is not this."""
        power = np.maximum(self._power[self._kept], 1e-30)
        # Pixels are compared within the near frame; beyond it, where the far photograph goes on,
        # there is nothing of it, less of the scene, and the far pixels' noise.
        near = self.pair.near_share
        whole = near + (1 - near) * np.abs(self._between(lens)) ** 2
        if self._compression is None:
            is_far = (np.abs(self._fx) < 0.5) & (np.abs(self._fy) < 0.5)
            zoom2 = abs(float(np.linalg.det(self.pair.near_per_far)))
            beyond_dn2 = (1 - near) * zoom2 * self._far_noise_dn2 * is_far
            power = np.maximum(power - near * other_dn2 - beyond_dn2, 0.0)
        # Else rounding has taken the noise with the detail where both are weak.
        true = power / whole
        return np.asarray(true / (true + other_dn2 + 1e-30))

    @cached_property
    def _fine_rings(self) -> tuple[BoolArray, IntArray]:
        """Kept frequencies that are fine in the near photograph, and the number of their ring."""
        ring = np.digitize(np.hypot(self._near_x, self._near_y), _FINE_RINGS_CY_PER_PX) - 1
        fine = (ring >= 0) & (ring < _FINE_RINGS_CY_PER_PX.size - 1)
        return fine, ring[fine]

    def _possible(self, near_noise_dn2: float) -> float:
        """The noise that was told, or what the weakest fine detail has room for if that is less."""
        if self._compression is not None:
            return near_noise_dn2
        fine, ring = self._fine_rings
        power = np.bincount(ring, self._power[self._kept][fine])
        weakest = float(np.min(power / np.bincount(ring)))
        most_dn2 = weakest / self.pair.near_share
        return near_noise_dn2 if near_noise_dn2 < _NOISE_EXCESS * most_dn2 else most_dn2

    def _repeated(self, lens: FloatArray, variance: FloatArray) -> float:
        """How often the errors that aliasing makes repeat themselves, at least 1.

        Frequencies of a scene alias at random, but those of a pattern along the pixels are few.
        """
        fine, ring = self._fine_rings
        power = np.abs(self._series[fine]) ** 2
        relative = power / (np.bincount(ring, power) / np.bincount(ring))[ring]
        # The power of a random scene has an exponential distribution.
        repeated = float(np.mean(relative**2)) / 2
        made_dn2 = float(np.mean(np.abs(self._between(lens)) ** 2 * self._aliased_dn2))
        if self._compression is not None:
            slope = code_slopes(self.pair.far_dn[self.pair.used], self._compression)
            made_dn2 *= float(np.mean(slope**2))
        return 1 + made_dn2 / float(np.mean(variance)) * max(repeated - 1, 0.0)

    def _aliased(self, lens: FloatArray) -> FloatArray:
        """Power at each kept frequency of what the near pixels alias to it."""
        angle = np.linspace(0, pi, 64, endpoint=False)
        radii = _SLOPE_RADII_CY_PER_PX
        x, y = np.multiply.outer(radii, np.cos(angle)), np.multiply.outer(radii, np.sin(angle))
        scene = self._scene_power(lens, x.ravel(), y.ravel()).reshape(x.shape).mean(axis=1)
        slope = -float(np.polyfit(np.log(radii), np.log(np.maximum(scene, 1e-12)), 1)[0])
        if not _SLOPES[0] < slope < _SLOPES[1]:
            slope = _USUAL_SLOPE
        total = np.zeros(self._near_x.shape)
        for across, down in ((a, b) for a in (-1, 0, 1) for b in (-1, 0, 1) if a or b):
            x, y = self._near_x + across, self._near_y + down
            radius = np.hypot(x, y)
            counts = radius < _FARTHEST_CY_PER_PX
            x, y, back = x[counts], y[counts], _KNOWN_CY_PER_PX / radius[counts]
            passed = np.abs(lens_transfer(lens, x, y)) ** 2
            total[counts] += passed * self._scene_power(lens, x * back, y * back) * back**slope
        return total

    def _scene_power(self, lens: FloatArray, x: FloatArray, y: FloatArray) -> FloatArray:
        """Power of the scene at near frequencies below the Nyquist frequency."""
        (xx, xy), (yx, yy) = self.pair.near_per_far
        far_x, far_y = xx * x + yx * y, xy * x + yy * y
        rows, cols = self.pair.near_dn.shape
        sign = np.where(far_x < 0, -1.0, 1.0)
        at = np.stack([sign * far_y * rows % (rows * self.pair.finer), sign * far_x * cols])
        seen = map_coordinates(self._power, at / self.pair.finer, order=1, mode="grid-wrap")
        passed = np.abs(lens_transfer(lens, x, y)) ** 2
        return np.asarray(
            np.maximum(seen - self.pair.near_share * self.near_noise_dn2, 0.0)
            / np.maximum(passed, _WEAKEST_POWER)
        )


def _inverse(transfer: ComplexArray) -> ComplexArray:
    return np.asarray(transfer.conj() / (np.abs(transfer) ** 2 + _WEAKEST**2))


def _scaled(factors: LensFactors, by: ComplexArray) -> dict[str, ComplexArray]:
    """What each kind of a grid's slopes is multiplied by."""
    return {
        "widths": factors.transfer * by,
        "even": factors.even * by,
        "odd": factors.odd * by,
    }


def monomials(x: FloatArray, y: FloatArray, degree: int) -> FloatArray:
    """Products of powers of two coordinates up to a degree, the constant first."""
    return np.stack([x**i * y**j for i in range(degree + 1) for j in range(degree + 1 - i)])


def _solved(system: FloatArray, right: FloatArray) -> FloatArray:
    """Solution of a system whose unknowns have scales of their own."""
    scale = 1 / np.sqrt(np.maximum(np.diag(system), 1e-300))
    scaled = system * np.multiply.outer(scale, scale)
    return np.asarray(scale * np.linalg.solve(scaled, scale * right))


def _without(system: FloatArray, count: int) -> FloatArray:
    """Information of the first unknowns where the others are not known (Schur's complement)."""
    cross, others = system[:count, count:], system[count:, count:]
    scale = 1 / np.sqrt(np.diag(others))
    scaled = others * np.multiply.outer(scale, scale)
    return np.asarray(
        system[:count, :count] - (cross * scale) @ np.linalg.solve(scaled, (cross * scale).T)
    )
