"""How much blurrier one photograph is than another, and how much brighter, told from noise.

The difference ``D`` of two photographs at one sharpness is regressed on their weighted mean ``M``
and its derivatives: a gain adds ``M``, a blur of variance t adds ``t / 2`` times the Laplacian, a
displacement the gradient. Weighted by the noise of the other, the mean has noise that is not
correlated with that of the difference, so that neither passes for blur or for light; and what the
noise of the mean adds to the squares of the columns, by which all coefficients would shrink, is
known from the difference.

Two transfer functions that are not Gaussian do not differ by a variance. So the ratio that a
calibrated camera would show is held against a Gaussian's over the spectrum of the photograph
itself, as the measurement does.

References
----------
W. A. Fuller, Measurement Error Models (1987), section 2.3.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import expm1, hypot, inf, pi, sqrt

import cv2
import numpy as np

from analysis.changes.matching._smoothed_warp import (
    PixelPositions,
    Window,
    finest_detail,
    light_at_first,
    pixel_noise_dn,
    smoothed,
)
from calibration.robust import robust_sigma
from simulation import Psf, PsfField
from simulation.arrays import BoolArray, Float32Array, FloatArray

_BLOCK_PX = 24
"""Pixels of other blocks are taken as independent."""

_ROUNDS = 5
_CONVERGED_PX2 = 0.01
_OUTLIER = 5.0
_MOST_PX2 = 9.0
_WINDOWS, _WINDOW_PX, _STEP_PX = 5, 128, 2
"""A large frame is seen through 5 x 5 windows, of which every other pixel counts along a line: on
texture they tell the blur to 0.005 px^2."""

_WEIGHT_ROUNDS = 4
_STEEP = 0.9
"""Quantile of the gradient, from which on what is wrong at edges is seen beside the noise."""

_LEAST_NORMAL, _LEAST_EIGENVALUE = 1e-3, 1e-6
"""Squares of a column beside those that the noise adds, over both, below which it shows nothing;
and the same of any combination of columns, below which these are not told apart."""

_LEAST_SAMPLES = 36

_NOTHING_PX2 = 1e-4
"""What single precision makes of equal photographs."""

_LEAST_PX2 = 1.0
_MARGIN_PX2 = 0.4
"""The softer photograph is smoothed by a variance of at least 1 px^2, and by what it is softer and
this much, so that the noise of the sharper one is not all that is smoothed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RelativeBlur:
    """How a target differs from its source, and standard errors.

    ``value_px2, err_px2``: variance by which it is blurrier, in its own pixels. Without any detail
    the error is infinite. ``displacement_px, displacement_covariance_px2``: of the frame's middle
    and its change from one side to the other: ``(y, x)``, by y, by x; shapes (6,) and (6, 6).
    ``unlike``: mean square of what is left over that of the detail. ``noises_dn``: standard
    deviations of the noise of single pixels of source and target.
    """

    value_px2: float
    err_px2: float
    gain: float = 1.0
    gain_err: float = inf
    displacement_px: FloatArray | None = None
    displacement_covariance_px2: FloatArray | None = None
    unlike: float = inf
    noises_dn: tuple[float, float] = (0.0, 0.0)

    def towards(self, expected_px2: float, expected_err_px2: float) -> float:
        """Mean of the variance and of what is expected, each weighted by its error."""
        share = expected_err_px2**2 / (expected_err_px2**2 + min(self.err_px2, 1e6) ** 2)
        return expected_px2 + share * (self.value_px2 - expected_px2)

    def is_none(self, errors: float) -> bool:
        """Whether it is none within so many standard errors."""
        return abs(self.value_px2) <= max(errors * self.err_px2, _NOTHING_PX2)

    @property
    def most_displaced(self) -> tuple[float, float]:
        """Largest displacement at a corner, px, and its standard error."""
        if self.displacement_px is None or self.displacement_covariance_px2 is None:
            return inf, inf
        found = []
        for y in (-0.5, 0.5):
            for x in (-0.5, 0.5):
                to = np.kron(np.array([1.0, y, x]), np.eye(2))
                spread = to @ self.displacement_covariance_px2 @ to.T
                found.append((hypot(*(to @ self.displacement_px)), sqrt(np.trace(spread))))
        return max(found)


_NOTHING = RelativeBlur(value_px2=0.0, err_px2=inf)
"""Of photographs that do not tell it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Smoothing:
    """Gaussians that bring two photographs to one sharpness, widths in pixels of the grid."""

    source_px: float
    target_px: float


def smoothing_for(blur_px2: float) -> Smoothing:
    """Return the Gaussians for a target blurrier than its source by a variance."""
    softer = max(_LEAST_PX2, abs(blur_px2) + _MARGIN_PX2)
    sharper = softer + abs(blur_px2)
    source, target = (sharper, softer) if blur_px2 >= 0 else (softer, sharper)
    return Smoothing(source_px=sqrt(source), target_px=sqrt(target))


def relative_blur(
    source: Float32Array,
    target: Float32Array,
    positions: PixelPositions,
    valid: BoolArray,
    expected_px2: float,
    steps_dn2: tuple[float, float] = (0.0, 0.0),
) -> RelativeBlur:
    """Measure the variance by which ``target`` is blurrier than ``source``.

    ``steps_dn2``: variance of the pixels of both by the steps of their files; the errors hold it.
    """
    zoom = positions.zoom
    noises = _noises_dn(source, target, positions, valid)
    value = expected_px2
    step = _NOTHING
    for number in range(_ROUNDS):
        widths = smoothing_for(value)
        areas = 4 * pi * (widths.source_px * zoom) ** 2, 4 * pi * widths.target_px**2
        coefficients = positions.coefficients(source, widths.source_px * zoom)
        sides = _Sides.of(coefficients, target, positions, valid, widths.target_px)
        noise_dn2 = tuple(noise**2 / area for noise, area in zip(noises, areas, strict=True))
        by_steps_dn2 = tuple(one / area for one, area in zip(steps_dn2, areas, strict=True))
        step = sides.related(noise_dn2, by_steps_dn2, widths)
        is_rough = number == 0 and not step.err_px2 < inf
        if is_rough:
            # Lines of the sharper one pass for more noise than both have in common. Once both are
            # as sharp, what is told has to stand out from it.
            step = sides.related((0.0, 0.0), by_steps_dn2, widths)
        if not step.err_px2 < inf:
            return replace(step, value_px2=expected_px2, noises_dn=noises)
        value = float(np.clip(value + step.value_px2, -_MOST_PX2, _MOST_PX2))
        if not is_rough and abs(step.value_px2) < max(_CONVERGED_PX2, 0.1 * step.err_px2):
            break
    return replace(step, value_px2=value, noises_dn=noises)


def _noises_dn(
    source: Float32Array, target: Float32Array, positions: PixelPositions, valid: BoolArray
) -> tuple[float, float]:
    """Standard deviations of the noise of single pixels of source and target.

    Where pixels lie upon pixels, both show the same finest detail, which their difference has not:
    its variance is the sum of both noises', and its covariance with the sum of the two photographs
    is the difference.
    """
    if positions.whole_shift is None:
        return pixel_noise_dn(source), pixel_noise_dn(target, valid)
    seen = positions.seen(source)
    kept = valid[::_STEP_PX, ::_STEP_PX]
    one, other = (finest_detail(image)[::_STEP_PX, ::_STEP_PX][kept] for image in (seen, target))
    gain = np.float32(sqrt(float(np.var(target[valid])) / max(float(np.var(seen[valid])), 1e-30)))
    one = gain * one
    apart, total = other - one, other + one
    spread = robust_sigma(apart)
    # What changed does not count, nor do lines of the scene, beside which noise is not seen.
    calm = np.abs(apart) <= _OUTLIER * spread
    calm &= np.abs(total) <= _OUTLIER * robust_sigma(total)
    more = float(np.mean(apart[calm] * total[calm])) if calm.any() else 0.0
    both = spread**2
    more = min(max(more, -both), both)
    return sqrt((both - more) / 2) / max(float(gain), 1e-30), sqrt((both + more) / 2)


def _windows(shape: tuple[int, int]) -> Iterator[Window]:
    if shape[0] * shape[1] <= (_WINDOWS * _WINDOW_PX) ** 2:
        yield slice(0, shape[0]), slice(0, shape[1])
        return
    tops, lefts = (
        np.linspace(0, max(n - _WINDOW_PX, 0), _WINDOWS).astype(int).tolist() for n in shape
    )
    for top in tops:
        for left in lefts:
            yield (
                slice(top, min(top + _WINDOW_PX, shape[0])),
                slice(left, min(left + _WINDOW_PX, shape[1])),
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Sides:
    """Level, half the Laplacian and the gradient (y, x) of both photographs at a sample of pixels.

    Shape ``(4, pixels)`` each, less the mean level of the target; ``place`` has 1 and the place in
    the frame (y, x) from -0.5 to 0.5, and ``block`` says which pixels are not independent.
    """

    source: FloatArray
    target: FloatArray
    place: FloatArray
    block: FloatArray

    @classmethod
    def of(
        cls,
        coefficients: Float32Array,
        target: Float32Array,
        positions: PixelPositions,
        valid: BoolArray,
        smoothing_px: float,
    ) -> "_Sides":
        """Sample both photographs behind their smoothing."""
        sources, targets, places, blocks = [], [], [], []
        blocks_across = positions.shape[1] // _BLOCK_PX + 1
        mean = np.float32(np.mean(target[valid]) if valid.any() else 0.0)
        every = np.zeros_like(valid)
        every[::_STEP_PX, ::_STEP_PX] = True
        for window in _windows(positions.shape):
            seen = positions.seen(coefficients, window) - mean
            own = smoothed(target[window] - mean, smoothing_px)
            kept = valid[window] & every[window] & np.isfinite(_laplacian(seen))
            rows, cols = np.nonzero(kept)
            y, x = rows + window[0].start, cols + window[1].start
            sources.append(_derivatives(seen, kept))
            targets.append(_derivatives(own, kept))
            place = [np.ones(len(y)), y / positions.shape[0] - 0.5, x / positions.shape[1] - 0.5]
            places.append(np.stack(place))
            blocks.append(y // _BLOCK_PX * blocks_across + x // _BLOCK_PX)
        return cls(
            source=np.concatenate(sources, axis=1),
            target=np.concatenate(targets, axis=1),
            place=np.concatenate(places, axis=1),
            block=np.concatenate(blocks),
        )

    def related(
        self, noise_dn2: tuple[float, ...], steps_dn2: tuple[float, ...], widths: "Smoothing"
    ) -> RelativeBlur:
        """Regress the difference on the mean, both with their derivatives.

        Where something large is new, nothing is told of all pixels: then of those alone that one
        light explains. ``noise_dn2, steps_dn2``: variance of the smoothed source and target by
        noise, and by the steps of their files.
        """
        count = self.place.shape[1]
        if count < _LEAST_SAMPLES:
            return _NOTHING
        light = light_at_first(self.source[0], self.target[0])
        found = self._related(light, np.ones(count), noise_dn2, steps_dn2, widths)
        if found.err_px2 < inf:
            return found
        apart = self.target[0] - light[0] * self.source[0] - light[1]
        weight, _ = _weights(apart, self.target, steps_dn2[1])
        return self._related(light, weight, noise_dn2, steps_dn2, widths)

    def _related(
        self,
        light: tuple[float, float],
        weight: FloatArray,
        noise_dn2: tuple[float, ...],
        steps_dn2: tuple[float, ...],
        widths: "Smoothing",
    ) -> RelativeBlur:
        gain, offset = light
        alike_px = 4 * pi * widths.target_px**2
        # Half of the Laplacian of white noise behind a Gaussian, times that noise itself.
        curved = [2 * expm1(-1 / (4 * width**2)) for width in (widths.source_px, widths.target_px)]
        steps, steepness = 0.0, 1.0
        for _ in range(_WEIGHT_ROUNDS):
            brought = gain * self.source
            brought[0] += offset
            noises = gain**2 * noise_dn2[0], noise_dn2[1]
            share = noises[0] / sum(noises) if sum(noises) > 0 else 0.5
            middle = (1 - share) * brought + share * self.target
            apart = self.target - brought
            columns, noisy = (
                _columns(middle, self.place),
                _columns(apart, self.place, is_noise=True),
            )
            normal = (columns * weight) @ columns.T
            shrunk = normal - share * (1 - share) * ((noisy * weight) @ noisy.T)
            if not _is_told(normal, shrunk):
                return _NOTHING
            inverse = np.linalg.inv(shrunk)
            right = (columns * weight) @ apart[0]
            # The Laplacian of a noise goes with the noise itself, more of it behind less smoothing.
            right[-1] -= weight.sum() * (
                share * noises[1] * curved[1] - (1 - share) * noises[0] * curved[0]
            )
            solution = inverse @ right
            residual = apart[0] - solution @ columns
            steps = gain**2 * steps_dn2[0] + steps_dn2[1]
            weight, steepness = _weights(residual, middle, steps)
            grown = solution[3]
            if not abs(grown) < 2:
                return _NOTHING
            # Of T - L = g M + c with L the source in this light, solved for the target.
            gain, offset = (
                gain * (1 + (1 - share) * grown) / (1 - share * grown),
                (offset * (1 + (1 - share) * grown) + solution[0]) / (1 - share * grown),
            )
        by_steps = steps * alike_px / _STEP_PX**2 * ((columns * weight**2) @ columns.T)
        covariance = _at_least(
            steepness**-2 * _jackknifed(columns, weight, residual, self.block, shrunk),
            inverse @ by_steps @ inverse.T,
        )
        moved = np.arange(6, 12)
        return RelativeBlur(
            value_px2=float(solution[-1]),
            err_px2=sqrt(covariance[-1, -1]),
            gain=float(gain),
            gain_err=sqrt(covariance[3, 3]) * abs(gain),
            displacement_px=-solution[moved],
            displacement_covariance_px2=covariance[np.ix_(moved, moved)],
            unlike=_unlike(residual, columns, weight),
        )


def _is_told(normal: FloatArray, shrunk: FloatArray) -> bool:
    """Whether the columns are more than their noise, level and Laplacian surely so."""
    scale = np.sqrt(np.maximum(np.diag(normal), 1e-300))
    told = shrunk / np.outer(scale, scale)
    is_regular = float(np.linalg.eigvalsh(told)[0]) > _LEAST_EIGENVALUE
    return is_regular and bool((np.diag(told)[[3, -1]] > _LEAST_NORMAL).all())


def _jackknifed(
    columns: FloatArray,
    weight: FloatArray,
    residual: FloatArray,
    block: FloatArray,
    normal: FloatArray,
) -> FloatArray:
    """Covariance of the solution from what it is without each of the blocks.

    References
    ----------
    R. M. Bell and D. F. McCaffrey, "Bias reduction in standard errors for linear regression with
    multi-stage samples", Survey Methodology 28 (2002).
    """
    order = np.argsort(block, kind="stable")
    first = np.flatnonzero(np.diff(block[order], prepend=-1))
    rooted = (columns * np.sqrt(weight))[:, order]
    upper = np.triu_indices(len(normal))
    own = np.stack(
        [
            np.add.reduceat(rooted[one] * rooted[other], first)
            for one, other in zip(*upper, strict=True)
        ]
    )
    without = np.repeat(normal[None], len(first), axis=0)
    without[:, upper[0], upper[1]] -= own.T
    without[:, upper[1], upper[0]] = without[:, upper[0], upper[1]]
    scores = np.add.reduceat((columns * (weight * residual))[:, order], first, axis=1)
    change = np.linalg.solve(without, scores.T[:, :, None])[:, :, 0]
    return np.asarray(change.T @ change)


def _at_least(covariance: FloatArray, least: FloatArray) -> FloatArray:
    """The covariance, widened to variances that are known not to be smaller."""
    own, other = np.maximum(np.diag(covariance), 0.0), np.maximum(np.diag(least), 0.0)
    wider = np.maximum(other - own, 0.0)
    return np.asarray(covariance + np.diag(wider))


def _columns(image: FloatArray, place: FloatArray, *, is_noise: bool = False) -> FloatArray:
    """1, the level and the gradient (y, x) times 1, y and x each, and half the Laplacian."""
    level, laplacian, along_y, along_x = image
    light = np.zeros_like(place) if is_noise else place
    gradient = np.stack([along_y, along_x])
    gradients = (place[:, None] * gradient[None]).reshape(-1, place.shape[1])
    return np.concatenate([light, place * level, gradients, laplacian[None]])


def _weights(
    residual: FloatArray, middle: FloatArray, steps_dn2: float
) -> tuple[FloatArray, float]:
    """Tukey's weights, with a scatter that grows with the gradient where it does so.

    And how much less the weighted residuals change with the solution than the weights say.
    """
    slope = np.hypot(middle[2], middle[3])
    steep = slope >= np.quantile(slope, _STEEP)
    flat = slope <= np.median(slope)
    base = max(robust_sigma(residual[flat]) ** 2, steps_dn2, 1e-18)
    squares = np.square(slope)
    excess = robust_sigma(residual[steep]) ** 2 - base if steep.any() else 0.0
    more = max(excess, 0.0) / max(float(np.median(squares[steep])), 1e-30)
    variance = base + more * squares
    inside = np.maximum(1 - np.square(residual / _OUTLIER) / variance, 0.0)
    weight = np.square(inside) / variance
    turned = np.sum(inside * (5 * inside - 4) / variance)
    return weight, float(turned / np.sum(weight))


def _unlike(residual: FloatArray, columns: FloatArray, weight: FloatArray) -> float:
    kept = weight > 0
    detail = columns[3][kept]
    return float(np.mean(np.square(residual[kept])) / max(float(np.var(detail)), 1e-30))


def _derivatives(image: Float32Array, kept: BoolArray) -> FloatArray:
    slope, one = np.array([-0.5, 0.0, 0.5], dtype=np.float32), np.ones(1, dtype=np.float32)
    along_y, along_x = (
        cv2.sepFilter2D(image, -1, one, slope),
        cv2.sepFilter2D(image, -1, slope, one),
    )
    made = image[kept], _laplacian(image)[kept] / 2, along_y[kept], along_x[kept]
    return np.stack(made).astype(np.float64)


def _laplacian(image: Float32Array) -> Float32Array:
    return np.asarray(cv2.Laplacian(image, cv2.CV_32F, ksize=1, borderType=cv2.BORDER_REFLECT_101))


_SIDE_PX = 256
_LEAST_TRANSFER = 1e-3
_HIGHEST_CY_PER_PX = 0.45


def calibrated_blur_px2(
    psf: Psf | PsfField,
    seen: Float32Array,
    valid: BoolArray,
    smoothing: Smoothing,
    positions: PixelPositions,
) -> float:
    """Variance by which one camera's target is blurrier than its source, in the target's pixels.

    ``psf``: total PSF of the camera that took both; a field is taken where both show the middle of
    what they share.
    """
    rows, cols = np.nonzero(valid)
    row, col = float(rows.mean()), float(cols.mean())
    side = min(_SIDE_PX, *seen.shape)
    top, left = (
        int(np.clip(at - side / 2, 0, n - side))
        for at, n in zip((row, col), seen.shape, strict=True)
    )
    part = (slice(top, top + side), slice(left, left + side))
    level = np.where(valid[part], seen[part] - seen[part][valid[part]].mean(), np.float32(0))
    window = cv2.createHanningWindow((side, side), cv2.CV_32F)
    power = np.abs(np.fft.rfft2(level * window)) ** 2
    fy: FloatArray = np.fft.fftfreq(side)[:, None].astype(np.float64)
    fx: FloatArray = np.fft.rfftfreq(side)[None].astype(np.float64)
    source_row, source_col, slopes = positions.near(row, col)
    # A wave of frequency f in the target has the frequency A^-T f in the source.
    (xx, xy), (yx, yy) = np.linalg.inv(slopes).T.tolist()
    source_psf, target_psf = (
        of.at(x, y) if isinstance(of, PsfField) else of
        for of, x, y in ((psf, source_col, source_row), (psf, col, row))
    )
    source_fx, source_fy = xx * fx + xy * fy, yx * fx + yy * fy
    square = (2 * np.pi) ** 2 * (fx * fx + fy * fy)
    own = target_psf.otf(fx, fy)
    other = source_psf.otf(source_fx, source_fy)
    source_square = (2 * np.pi * positions.zoom) ** 2 * (source_fx**2 + source_fy**2)
    told = (other > _LEAST_TRANSFER) & (np.hypot(fx, fy) < _HIGHEST_CY_PER_PX)
    # Gain and Laplacian, as they are fitted to the photographs.
    columns = np.stack([np.ones_like(square), -square / 2])
    blur_px2 = 0.0
    for _ in range(_ROUNDS):
        made = smoothing_for(blur_px2)
        own_px2, other_px2 = made.target_px**2, made.source_px**2
        ratio = np.divide(own, other, out=np.ones_like(own), where=told)
        ratio *= np.exp((source_square * other_px2 - square * own_px2) / 2)
        # The spectrum is that of the source behind another Gaussian.
        seen_px2 = smoothing.source_px**2
        weight = np.where(told, power * np.exp(source_square * (seen_px2 - other_px2)), 0.0)
        normal = np.einsum("iyx,jyx,yx->ij", columns, columns, weight)
        share = np.einsum("iyx,yx->i", columns, ratio * weight)
        gain, step = np.linalg.lstsq(normal, share, rcond=None)[0].tolist()
        blur_px2 = other_px2 - own_px2 + step / gain
    return blur_px2
