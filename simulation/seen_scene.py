"""What a window of reference pixels tells of a far pixel, on average over scenes.

The scene is isotropic and of first order: covariance ``exp(-|d| / L)``, power falling with the
third power of the frequency. A period of the scene stands for the plane; it is several times as
long as any window.

A window's covariance is block-Toeplitz and the same from either end, so that the even and the odd
patterns of weights are systems of half the size; where the PSF is the same in the mirror of either
axis, there are four of a quarter. The kernels of all subpixel positions are a short sum of products
of one-dimensional ones. The first product holds the kernels' sums along either axis, so that it
alone acts on what varies along one axis only: a constant stays a constant and a ramp a ramp. The
others are the singular vectors of the rest, and sum to zero along both axes.
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import ceil, log, pi, sqrt

import numpy as np
from scipy.linalg import cho_factor, cho_solve, solve_triangular

from simulation.arrays import FloatArray, IntArray
from simulation.psf import Psf

SCENE_CORRELATION_PX = 30.0
"""Correlation length of the scene prior; from 3 to 100 px the errors differ by less than 1 %."""

_ALIASES = 3
"""Orders of aliasing on either side: beyond 3.5 cy/px the pixel and the scene leave 1e-4."""

_FAINT = 1e-11
"""Part of the cross spectrum's sum that may lie beyond the frequencies kept."""


@dataclass(frozen=True, slots=True, eq=False)
class SeenScene:
    """The scene as the near camera sees it.

    ``period_px`` is even. ``power`` and ``near`` are the spectrum of the scene and the transfer
    function, shape ``(rows, cols)``: at frequencies from 0 up along y, of both signs along x.
    ``covariance`` is that of two reference pixels, shape ``(period_px, period_px)``, by their
    distance; it wraps.
    """

    psf: Psf
    period_px: int
    power: FloatArray
    near: FloatArray
    covariance: FloatArray

    @classmethod
    def through(cls, psf: Psf, period_px: int, correlation_px: float) -> "SeenScene":
        """See a scene of variance 1, whose covariance falls to 1/e at ``correlation_px``."""
        fy, fx = _frequencies(period_px)
        angular = 2 * np.pi * correlation_px
        # Transform of exp(-|d| / L) in the plane, for a scene of variance 1.
        squared = fy[:, None] ** 2 + fx**2
        power = 2 * np.pi * (correlation_px / period_px) ** 2 / (1 + angular**2 * squared) ** 1.5
        near = psf.otf(fx[None, :], fy[:, None])
        upper = power * near**2
        both = np.concatenate([upper[:0:-1, ::-1], upper])
        orders = 2 * _ALIASES + 1
        # The lattice starts half a cycle below its lowest order; both ends of it are kept.
        folded = both[:-1, :-1].reshape(orders, period_px, orders, period_px).sum(axis=(0, 2))
        covariance = np.fft.fft2(np.fft.ifftshift(folded)).real
        return cls(psf, period_px, power, near, covariance)

    @property
    def is_mirrored(self) -> bool:
        """Whether the covariance is the same in the mirror of either axis."""
        mirrored = np.roll(self.covariance[::-1], 1, axis=0)
        return bool(np.allclose(mirrored, self.covariance, rtol=0, atol=1e-12 * self.variance))

    @property
    def is_diagonal(self) -> bool:
        """Whether the covariance is the same when rows and columns are exchanged."""
        tolerance = 1e-12 * self.variance
        return bool(np.allclose(self.covariance.T, self.covariance, rtol=0, atol=tolerance))

    @property
    def variance(self) -> float:
        """Variance of a reference pixel."""
        return float(self.covariance[0, 0])

    def across(self, zoom_y: float, zoom_x: float) -> "CrossCovariance":
        """Covariance of reference pixels with those of a camera further away."""
        fy, fx = _frequencies(self.period_px)
        far = self.psf.otf(zoom_x * fx[None, :], zoom_y * fy[:, None])
        # The lower half plane repeats the upper one.
        twice = np.where(fy > 0, 2.0, 1.0)[:, None]
        seen = twice * self.power * far
        values = seen * self.near
        variance = float(np.vdot(seen, far))
        middle = len(fx) // 2
        size = np.abs(values)
        by_column = size.sum(axis=0)
        by_column = by_column[middle:] + by_column[middle::-1]
        last = max(_reach(size.sum(axis=1)), _reach(by_column))
        kept = slice(middle - last, middle + last + 1)
        return CrossCovariance(fy[: last + 1], fx[kept], values[: last + 1, kept], variance)


@dataclass(frozen=True, slots=True, eq=False)
class CrossCovariance:
    """Covariance of reference and follow-up pixels, by frequency; ``variance`` of the latter."""

    freq_y: FloatArray
    freq_x: FloatArray
    values: FloatArray
    variance: float

    def at(self, distance_y_px: FloatArray, distance_x_px: FloatArray) -> FloatArray:
        """Covariances at all pairs of distances, shape ``(len(y), len(x))``."""
        y = 2 * np.pi * np.multiply.outer(distance_y_px, self.freq_y)
        x = 2 * np.pi * np.multiply.outer(distance_x_px, self.freq_x)
        even = (np.cos(y) @ self.values) @ np.cos(x).T
        return np.asarray(even - (np.sin(y) @ self.values) @ np.sin(x).T)


def _frequencies(period_px: int) -> tuple[FloatArray, FloatArray]:
    last = _ALIASES * period_px + period_px // 2
    steps = np.arange(-last, last + 1) / period_px
    return steps[last:], steps


def _reach(sums: FloatArray) -> int:
    """Index of the last frequency that matters."""
    beyond = 1 - np.cumsum(sums) / sums.sum()
    return int(np.argmax(beyond <= _FAINT))


_Block = tuple[slice, slice]
_Reflection = tuple[_Block, float]


@dataclass(frozen=True, slots=True, eq=False)
class _Parity:
    """One symmetry class of patterns: its pixels, its reflections with their signs, its factor."""

    half: _Block
    reflections: tuple[_Reflection, ...]
    factor: tuple[FloatArray, bool]

    def solved(self, wanted: FloatArray) -> FloatArray:
        """Part of the solution that has this symmetry, shape ``(n, taps_y, taps_x)``."""
        folded = sum(sign * wanted[(slice(None), *mirror)] for mirror, sign in self.reflections)
        part = np.asarray(folded)[(slice(None), *self.half)]
        shape = part.shape
        flat = cho_solve(self.factor, part.reshape(len(part), -1).T, check_finite=False).T
        solution = np.zeros_like(wanted)
        quarter = flat.reshape(shape) / len(self.reflections)
        for mirror, sign in self.reflections:
            solution[(slice(None), *mirror)][(slice(None), *self.half)] = sign * quarter
        return solution


@dataclass(frozen=True, slots=True, eq=False)
class FiniteWindow:
    """The covariance of a window's pixels, factorised by its symmetry classes.

    ``drifts`` are a constant and, where there are pixels for it, a ramp along either axis, shape
    ``(3, taps_y, taps_x)`` or fewer; positions count from the window's centre. ``solved_drifts``
    are the drifts divided by the covariance.

    References
    ----------
    G. Matheron, "The intrinsic random functions and their applications", 1973 (kriging with a
    drift).
    """

    taps_y: int
    taps_x: int
    parities: tuple[_Parity, ...]
    drifts: FloatArray
    solved_drifts: FloatArray

    @classmethod
    def of(cls, scene: SeenScene, taps_y: int, taps_x: int, ridge: float) -> "FiniteWindow":
        """Factorise a window's covariance plus white noise of ``ridge`` times its variance."""
        parities = tuple(_parities(scene, taps_y, taps_x, ridge))
        y = (np.arange(taps_y) - (taps_y - 1) / 2)[:, None] * np.ones(taps_x)
        x = np.ones(taps_y)[:, None] * (np.arange(taps_x) - (taps_x - 1) / 2)
        ramps = [ramp for ramp, taps in ((y, taps_y), (x, taps_x)) if taps > 1]
        drifts = np.stack([np.ones_like(y), *ramps])
        solved = np.asarray(sum(parity.solved(drifts) for parity in parities))
        return cls(taps_y, taps_x, parities, drifts, solved)

    def weights(self, covariance: FloatArray, y_px: FloatArray, x_px: FloatArray) -> FloatArray:
        """Weights that estimate far pixels: least error of all that keep a constant and a ramp.

        ``covariance`` is that of each far pixel with the window's, shape ``(n, taps_y, taps_x)``,
        as the weights'; ``y_px`` and ``x_px`` are the far pixels' positions from the window's
        centre.
        """
        bare = np.asarray(sum(parity.solved(covariance) for parity in self.parities))
        places = [p for p, taps in ((y_px, self.taps_y), (x_px, self.taps_x)) if taps > 1]
        wanted = np.stack([np.ones(len(bare)), *places])
        axes = ([1, 2], [1, 2])
        missing = wanted - np.tensordot(self.drifts, bare, axes)
        gram = np.tensordot(self.drifts, self.solved_drifts, axes)
        factors = np.linalg.solve(gram, missing)
        return np.asarray(bare + np.tensordot(factors.T, self.solved_drifts, 1))


def _parities(scene: SeenScene, taps_y: int, taps_x: int, ridge: float) -> list[_Parity]:
    whole, turned = slice(None), slice(None, None, -1)
    y, x = np.arange(taps_y), np.arange(taps_x)
    half = (slice(taps_y // 2), whole)
    classes: list[tuple[_Reflection, ...]]
    if taps_y % 2 or taps_x % 2:
        # Images smaller than the window: no symmetry is worth the case of a middle pixel.
        half = (whole, whole)
        classes = [(((whole, whole), 1.0),)]
    elif scene.is_mirrored:
        half = (slice(taps_y // 2), slice(taps_x // 2))
        classes = [
            (
                ((whole, whole), 1.0),
                ((turned, whole), up),
                ((whole, turned), left),
                ((turned, turned), up * left),
            )
            for up in (1.0, -1.0)
            for left in (1.0, -1.0)
        ]
    else:
        classes = [(((whole, whole), 1.0), ((turned, turned), sign)) for sign in (1.0, -1.0)]
    pixels = y[half[0]], x[half[1]]
    blocks = [
        _covariances(scene, pixels, (y[mirror[0]][half[0]], x[mirror[1]][half[1]]))
        for mirror, _ in classes[0]
    ]
    parities = []
    for reflections in classes:
        matrix = blocks[0].copy()
        for block, (_, sign) in zip(blocks[1:], reflections[1:], strict=True):
            matrix += sign * block
        matrix[np.diag_indices_from(matrix)] += ridge * scene.variance
        factor = cho_factor(matrix.T, lower=False, overwrite_a=True, check_finite=False)
        parities.append(_Parity(half, reflections, factor))
    return parities


def _covariances(
    scene: SeenScene, one: tuple[IntArray, IntArray], other: tuple[IntArray, IntArray]
) -> FloatArray:
    """Covariance of all pixels of one block with all of another, by rows of the blocks."""
    down = (one[0][:, None] - other[0]) % scene.period_px
    right = (one[1][:, None] - other[1]) % scene.period_px
    values = scene.covariance[down[:, None, :, None], right[None, :, None, :]]
    return np.asarray(values.reshape(len(one[0]) * len(one[1]), -1))


_TERM_TOLERANCE = 3e-4
"""Part of a scene's standard deviation that the omitted products may leave: 0.02 of 60 DN."""

_TERMS_MAX = 16

_WEIGHT_CORRELATION_PX = 30.0
"""The rest is measured on scenes of this correlation length along either axis."""


@dataclass(frozen=True, slots=True, eq=False)
class AxisKernels:
    """One axis of the products: weights ``(terms, n, taps)`` at n positions of far pixels."""

    positions_px: FloatArray
    weights: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class KernelTable:
    """Products whose sum over the terms is the kernel at each pair of positions."""

    along_y: AxisKernels
    along_x: AxisKernels

    @classmethod
    def of(cls, kernels: FloatArray, y_px: FloatArray, x_px: FloatArray) -> "KernelTable":
        """Factorise kernels of shape ``(len(y_px), len(x_px), taps_y, taps_x)``, of sum 1."""
        sums_y, sums_x, rest = _apart(kernels, y_px, x_px)
        root_y, root_x = (_scene_root(kernels.shape[axis]) for axis in (2, 3))
        weighted = np.einsum("abij,ik,jl->akbl", rest, root_y, root_x, optimize=True)
        rows = weighted.shape[0] * weighted.shape[1]
        left, values, right = np.linalg.svd(weighted.reshape(rows, -1), full_matrices=False)
        left_out = np.sqrt(np.cumsum((values**2)[::-1])[::-1] / (len(y_px) * len(x_px)))
        count = min(int(np.sum(left_out > _TERM_TOLERANCE)), _TERMS_MAX)
        share = np.sqrt(values[:count])
        rest_y = (left[:, :count] * share).T.reshape(count, *sums_y.shape)
        rest_x = (share[:, None] * right[:count]).reshape(count, *sums_x.shape)
        return cls(
            AxisKernels(y_px, np.concatenate([sums_y[None], _unweighted(rest_y, root_y)])),
            AxisKernels(x_px, np.concatenate([sums_x[None], _unweighted(rest_x, root_x)])),
        )

    def rows_of(self, kernels: FloatArray, y_px: FloatArray, sampled: IntArray) -> AxisKernels:
        """Kernels along y for further positions, such as those of a window at the border.

        Their products with the table's along x are the nearest to the exact ``kernels``, shape
        ``(len(y_px), len(sampled), taps_y, taps_x)``. ``sampled`` says which of the table's
        positions along x they stand for; a few tell as much as all.
        """
        sums_y, _, rest = _apart(kernels, y_px, self.along_x.positions_px[sampled])
        root_x = _scene_root(kernels.shape[3])
        basis = self.along_x.weights[1:, sampled] @ root_x
        weighted = np.einsum("abij,jl->aibl", rest, root_x, optimize=True)
        flat = basis.reshape(len(basis), len(sampled) * len(root_x))
        found = weighted.reshape(-1, flat.shape[1]) @ np.linalg.pinv(flat)
        along_y = found.T.reshape(len(basis), *sums_y.shape)
        return AxisKernels(y_px, np.concatenate([sums_y[None], along_y]))

    @property
    def taps(self) -> tuple[int, int]:
        """Reference pixels of the windows along y and x."""
        return self.along_y.weights.shape[2], self.along_x.weights.shape[2]

    def turned(self) -> "KernelTable":
        """Return the table with its axes exchanged."""
        return KernelTable(self.along_x, self.along_y)


def window_kernels(
    window: FiniteWindow, far: CrossCovariance, y_px: FloatArray, x_px: FloatArray
) -> FloatArray:
    """Weights of a window for all pairs of positions, shape ``(n_y, n_x, taps_y, taps_x)``."""
    taps = window.taps_y, window.taps_x
    y, x = (
        np.subtract.outer(positions, np.arange(count) - (count - 1) / 2)
        for positions, count in zip((y_px, x_px), taps, strict=True)
    )
    covariance = far.at(y.ravel(), x.ravel()).reshape(*y.shape, *x.shape).transpose(0, 2, 1, 3)
    pairs = np.repeat(y_px, len(x_px)), np.tile(x_px, len(y_px))
    weights = window.weights(covariance.reshape(-1, *taps), *pairs)
    return weights.reshape(len(y_px), len(x_px), *taps)


def _apart(
    kernels: FloatArray, y_px: FloatArray, x_px: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Split into the kernels for what varies along y alone, along x alone, and the rest."""
    sums_y = _exact(kernels.sum(axis=3).mean(axis=1), y_px)
    sums_x = _exact(kernels.sum(axis=2).mean(axis=0), x_px)
    rest = kernels - sums_y[:, None, :, None] * sums_x[None, :, None, :]
    rest -= rest.mean(axis=2, keepdims=True)
    rest -= rest.mean(axis=3, keepdims=True)
    return sums_y, sums_x, rest


def _exact(weights: FloatArray, positions_px: FloatArray) -> FloatArray:
    """Correct the sums and first moments for rounding of the solution."""
    taps = weights.shape[1]
    place = np.arange(taps) - (taps - 1) / 2
    constant, ramp = np.full(taps, 1 / taps), place / max(float(place @ place), 1.0)
    moment = positions_px - weights @ place if taps > 1 else np.zeros(len(weights))
    return np.asarray(
        weights + np.outer(1 - weights.sum(axis=1), constant) + np.outer(moment, ramp)
    )


def _scene_root(taps: int) -> FloatArray:
    distance = np.abs(np.subtract.outer(np.arange(taps), np.arange(taps)))
    return np.linalg.cholesky(np.exp(-distance / _WEIGHT_CORRELATION_PX))


def _unweighted(factors: FloatArray, root: FloatArray) -> FloatArray:
    flat = factors.reshape(-1, len(root))
    plain = solve_triangular(root, flat.T, lower=True, trans="T").T.reshape(factors.shape)
    return np.asarray(plain - plain.mean(axis=2, keepdims=True))


_RADIUS_MAX_PX, _RADIUS_MAX_MIRRORED_PX = 36, 48
"""Largest half of a window's side, for any PSF and for one that is the same in the mirror of either
axis, whose systems are smaller; they take seconds."""

_ALLOWED_OF_IDEAL = 0.06
"""Part of the ideal error by which a window may exceed it ..."""

_ALLOWED_LEAST = 0.06 * 0.01 / 60**2
"""... and the same part of 0.01 DN^2 in scenes of 60 DN rms, relative to the scene's variance."""

_TOLERATED = 0.005 / 60**2
"""At most 0.005 DN^2 where the largest window is too small for the lens's tails; from there on
model ``matched``, which has no window, is the better one."""

_LEAST_PX, _LEAST_ZOOMS = 3, 2
"""Less saves no time, and this much costs a Gaussian lens nothing that could be measured."""

_LEAST_SIGMAS = 3.5
"""Standard deviations of the missing blur: cut off earlier, a Gaussian takes three products and
twice the noise instead of one product."""

_LOW_CY_PER_PX = 0.1

_TRIED_STEPS = 3
_STEP = 1.4
"""Ratio of the radii solved before the excess, which falls with a power, is extrapolated."""

_SHIFTS_PX = (0.0, 0.5)

_SLOWEST_DECAY, _FASTEST_DECAY = 2.0, 8.0

_Windows = Callable[[int, int], FiniteWindow]
"""Gives the factorised window of ``taps_y`` and ``taps_x`` pixels."""


def window_radius_px(
    scene: SeenScene, zoom: float, windows: _Windows, noise_variance: float
) -> int | None:
    """Half the side of the smallest window that loses little; None if the largest loses more."""
    far = scene.across(zoom, zoom)
    ideal = ideal_error(scene, far, noise_variance)
    allowed = _ALLOWED_OF_IDEAL * ideal + _ALLOWED_LEAST
    excesses: list[float] = []
    largest = _RADIUS_MAX_MIRRORED_PX if scene.is_mirrored else _RADIUS_MAX_PX
    blur_px = _width_px(scene) * sqrt(zoom**2 - 1)
    least = max(_LEAST_PX + ceil(_LEAST_ZOOMS * zoom), ceil(_LEAST_SIGMAS * blur_px))
    radii = [min(round(least * _STEP**step), largest) for step in range(_TRIED_STEPS)]
    for radius in radii:
        window = windows(2 * radius, 2 * radius)
        excesses.append(_window_error(scene, far, window, noise_variance) - ideal)
        if excesses[-1] <= allowed:
            return radius
    if radii[-2] == radii[-1]:
        return largest if excesses[-1] <= _TOLERATED else None
    decay = log(excesses[-2] / excesses[-1]) / log(radii[-1] / radii[-2])
    decay = min(max(decay, _SLOWEST_DECAY), _FASTEST_DECAY)
    at_most = excesses[-1] * (radii[-1] / largest) ** decay
    if at_most > max(allowed, _TOLERATED):
        return None
    growth = float((excesses[-1] / allowed) ** (1 / decay))
    return min(ceil(radii[-1] * growth), largest)


def _width_px(scene: SeenScene) -> float:
    """Standard deviation of the Gaussian with the PSF's transfer at a low frequency."""
    low, zero = np.array([_LOW_CY_PER_PX, 0.0]), np.array([0.0, _LOW_CY_PER_PX])
    seen = float(np.clip(scene.psf.otf(low, zero).min(), 1e-3, 1.0))
    return sqrt(-log(seen) / 2) / (pi * _LOW_CY_PER_PX)


def _window_error(
    scene: SeenScene, far: CrossCovariance, window: FiniteWindow, noise_variance: float
) -> float:
    """Expected squared error, of a scene of variance 1, mean of two subpixel positions."""
    size = (scene.period_px, scene.period_px)
    power = np.fft.fft2(scene.covariance).real / scene.period_px**2
    error = 0.0
    for shift_px in _SHIFTS_PX:
        at: FloatArray = np.array([shift_px])
        weights = window_kernels(window, far, at, at)[0, 0]
        y, x = (at[0] - _centred(taps) for taps in weights.shape)
        seen = np.sum(np.abs(np.fft.fft2(weights, size)) ** 2 * power)
        seen += noise_variance * np.sum(weights**2)
        error += far.variance - 2 * float(np.sum(weights * far.at(y, x))) + float(seen)
    return error / len(_SHIFTS_PX)


def _centred(count: int) -> FloatArray:
    return np.arange(count, dtype=np.float64) - (count - 1) / 2


def ideal_error(scene: SeenScene, far: CrossCovariance, noise_variance: float) -> float:
    """Return the error with all reference pixels, mean of the same positions."""
    period = scene.period_px
    seen = np.maximum(np.fft.fft2(scene.covariance).real + noise_variance, 1e-15)
    known = 0.0
    for shift_px in _SHIFTS_PX:
        lags = shift_px + _centred(period)
        known += float(np.sum(np.abs(np.fft.fft2(far.at(lags, lags))) ** 2 / seen)) / period**2
    return max(far.variance - known / len(_SHIFTS_PX), 0.0)
