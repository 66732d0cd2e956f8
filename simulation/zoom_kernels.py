"""The kernels of the zoom-out models for any PSF, as banded matrices along either axis.

``matched``: in the band that the pixels hold, the far image is the near one times ``H(z f) /
H(f)``, sampled as a quintic spline, whose coefficients the kernels give. ``lmmse``: the best linear
estimate from a window of reference pixels.

Long rows of weights are fitted by short ones: the tails of a blur made from its transfer function
alternate from pixel to pixel, where an image seen through a lens has next to nothing. The short row
is the one whose result differs least from the long row's, on average over images seen through that
lens.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import lru_cache
from math import ceil, inf

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.linalg import toeplitz

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.kept_kernels import kept
from simulation.psf import GaussianPsf, Psf
from simulation.resampling import (
    BandedMatrix,
    BlurCovariance,
    SeparableTerm,
    matched_terms,
    mirrored_rows,
    spline_sampling,
    spline_transfer,
)
from simulation.sampling_grid import SamplingGrid
from simulation.seen_scene import (
    SCENE_CORRELATION_PX,
    AxisKernels,
    CrossCovariance,
    FiniteWindow,
    KernelTable,
    SeenScene,
    ideal_error,
    window_kernels,
    window_radius_px,
)

_STEPS_PER_CYCLE = 512  # at least
_ALIASES = 3

_NOISE = 1e-6
"""White noise that is reckoned with, relative to the image's variance."""

_TAPS_MIN = 6
"""As many pixels as a quintic spline has between its knots."""

_TOLERANCE = 2e-8
"""Largest variance of the difference, relative to the image's: 0.008 DN rms of 60 ..."""

_TOLERANCE_OF_ALIASES = 2e-3
"""... or this part of what the pixels fold below Nyquist, which no model gets right."""


@dataclass(frozen=True, slots=True, eq=False)
class _ImageCovariance:
    """Covariance of the pixels along one axis of an image, by distance in px, with a tolerance."""

    values: FloatArray
    tolerance: float

    @classmethod
    def seen_through(
        cls, transfer: Callable[[FloatArray], FloatArray], lags: int, noise_ratio: float = 0.0
    ) -> "_ImageCovariance":
        """Covariance of a first-order scene seen through a transfer function, and of its noise."""
        count = max(_STEPS_PER_CYCLE, 2 * lags)
        freq = np.arange(-_ALIASES * count, _ALIASES * count) / count
        angular = 2 * np.pi * SCENE_CORRELATION_PX * freq
        power = np.abs(transfer(freq)) ** 2 / (1 + angular**2)
        total = float(power.sum())
        aliased = 1 - float(power[np.abs(freq) <= 0.5].sum()) / total
        values = np.fft.fft(power.reshape(-1, count).sum(axis=0)).real[: count // 2] / total
        values[0] += max(_NOISE, noise_ratio)
        return cls(np.asarray(values), max(_TOLERANCE, _TOLERANCE_OF_ALIASES * aliased))


def _shortest(
    rows: FloatArray, covariance: _ImageCovariance, share: float, *, keeps_ramp: bool = True
) -> FloatArray:
    """Fit rows by the fewest weights that change the images of a camera by next to nothing.

    The rows have the shape ``(n, columns)``, with an even number of columns; the result are weights
    ``(n, taps)`` of the middle columns. The response to a constant stays the same, and with
    ``keeps_ramp`` that to a ramp; no product of rows and columns responds to one, if the other's
    weights sum to 0. ``share`` is the part of the difference that counts: the other axis leaves
    that much of an image's variance.
    """
    for taps in range(_TAPS_MIN if keeps_ramp else 2, rows.shape[1], 2):
        weights, difference = _fitted(rows, taps, covariance, keeps_ramp)
        if float(difference.max()) * share <= covariance.tolerance:
            return weights
    return rows


def _largest_variance(rows: FloatArray, covariance: _ImageCovariance) -> float:
    """Largest variance of what a row of weights makes of an image of variance 1."""
    return float(_variances(rows, covariance).max())


def _fitted(
    rows: FloatArray, taps: int, covariance: _ImageCovariance, keeps_ramp: bool
) -> tuple[FloatArray, FloatArray]:
    """Return weights of the middle columns, and the variance of the difference, row by row."""
    count = rows.shape[1]
    column = np.arange(count)
    near = column[(count - taps) // 2 :][:taps]
    wanted = rows @ covariance.values[np.abs(np.subtract.outer(column, near))]
    system = toeplitz(covariance.values[:taps])
    middle = (count - 1) / 2
    kept = 2 if keeps_ramp else 1
    drift = np.stack([np.ones(taps), near - middle])[:kept]
    moments = np.stack([rows.sum(axis=1), rows @ (column - middle)])[:kept]
    solved = np.linalg.solve(system, np.concatenate([wanted, drift]).T).T
    bare, drifts = solved[:-kept], solved[-kept:]
    factors = np.linalg.solve(drift @ drifts.T, moments - drift @ bare.T)
    weights = bare + factors.T @ drifts
    change = _variances(rows, covariance) - 2 * np.einsum("rn,rn->r", weights, wanted)
    return weights, change + _variances(weights, covariance)


def _variances(rows: FloatArray, covariance: _ImageCovariance) -> FloatArray:
    system = toeplitz(covariance.values[: rows.shape[1]])
    return np.asarray(np.einsum("ra,ra->r", rows @ system, rows))


_NEAR_ZERO = 3e-3
"""Where ``|H|`` is below, as at the zeros of a lens out of focus, noise would be amplified."""

_OMITTED_SHARE = 0.5
"""Part of the tolerance that the products left out may take; with all of it, which saves up to a
sixth more, photographs seen through a round lens are twice as far from the exact sum."""

_GRAM_ROUNDING = 1e-14
"""Eigenvalues of a covariance of products, relative to the largest, that are rounding alone."""

_POSITIONS_PX: FloatArray = np.arange(-2, 19) / 16
"""Positions from the pixel before, of rows that a cubic spline is laid through: right to 2e-5."""

_SIZE_MIN, _SIZE_ZOOMS = 128, 32
"""Period of the kernels in px, and least in far pixels."""


@lru_cache(maxsize=32)
def spline_prefilter(psf: Psf, zoom_y: float, zoom_x: float) -> tuple[SeparableTerm, ...]:
    """Kernels from pixels to coefficients, whose products sum to the prefilter."""
    if isinstance(psf, GaussianPsf):
        (xx, xy), (_, yy) = psf.covariance_px2.tolist()
        return matched_terms(
            BlurCovariance(
                yy_px2=yy * (zoom_y**2 - 1),
                xx_px2=xx * (zoom_x**2 - 1),
                xy_px2=xy * (zoom_y * zoom_x - 1),
            )
        )
    size = max(_SIZE_MIN, _SIZE_ZOOMS * ceil(max(zoom_y, zoom_x)))
    freq: FloatArray = np.fft.fftfreq(size).astype(np.float64)
    fy, fx = freq[:, None], freq[None, :]
    near, far = psf.otf(fx, fy), psf.otf(zoom_x * fx, zoom_y * fy)
    transfer = far * near / (near**2 + _NEAR_ZERO**2) * (1 + _NEAR_ZERO**2)
    # A pixel grid cannot distinguish +1/2 and -1/2 cycles/px: the real part is their mean.
    kernel = np.fft.ifft2(transfer / (spline_transfer(fy) * spline_transfer(fx))).real
    # All of the period, so that the sum of the tails beyond it lies at its ends.
    radius = size // 2
    kernel = np.roll(kernel, (radius, radius), (0, 1))
    kernel = np.pad(kernel, ((0, 1), (0, 1)), mode="wrap")
    kernel[[0, -1], :] *= 0.5
    kernel[:, [0, -1]] *= 0.5
    middle: FloatArray = np.zeros(1)
    table = KernelTable.of((kernel / kernel.sum())[None, None], middle, middle)
    return tuple(
        SeparableTerm(along_y[0], along_x[0])
        for along_y, along_x in zip(table.along_y.weights, table.along_x.weights, strict=True)
    )


def spline_terms(
    shape: tuple[int, int], grid: SamplingGrid, psf: Psf
) -> tuple[tuple[BandedMatrix, BandedMatrix], ...]:
    """Pairs ``(Wy, Wx)`` whose ``Wy image Wx^T`` sum to the follow-up of model ``matched``."""
    rows = _short_rows(psf, max(grid.zoom_y, 1.0), max(grid.zoom_x, 1.0))
    return tuple((y.at(grid.rows_px, shape[0]), x.at(grid.cols_px, shape[1])) for y, x in rows)


@dataclass(frozen=True, slots=True, eq=False)
class _ShortRows:
    """Weights that sample the spline along one axis, by the position between the pixels.

    ``weights`` has shape ``(len(_POSITIONS_PX), taps)``, with an even number of taps.
    """

    weights: FloatArray

    def at(self, positions_px: FloatArray, size: int) -> BandedMatrix:
        """Sample at positions in an image, which is mirrored at its edges."""
        taps = self.weights.shape[1]
        starts = np.floor(positions_px).astype(np.int64) + 1 - taps // 2
        between, which = np.unique(
            np.round(positions_px - np.floor(positions_px), 9), return_inverse=True
        )
        weights = CubicSpline(_POSITIONS_PX, self.weights)(between)
        return mirrored_rows(starts, weights[which], size)


@lru_cache(maxsize=64)
def _short_rows(
    psf: Psf, zoom_y: float, zoom_x: float
) -> tuple[tuple[_ShortRows, _ShortRows], ...]:
    """Terms along y and x, the same for all images and grids: crops equal the whole."""
    rows = [
        _ShortRows(weights)
        for weights in kept(
            "rows", (psf, zoom_y, zoom_x), lambda: tuple(_row_weights(psf, zoom_y, zoom_x))
        )
    ]
    return tuple(zip(rows[::2], rows[1::2], strict=True))


def _row_weights(psf: Psf, zoom_y: float, zoom_x: float) -> Iterator[FloatArray]:
    """Weights of the first term along y and along x, then those of the others."""
    zero: FloatArray = np.zeros(1)
    kernels = spline_prefilter(psf, zoom_y, zoom_x)
    widest = max(len(taps) for kernel in kernels for taps in (kernel.along_y, kernel.along_x))
    lags = 2 * _reach_px(widest)
    covariance_y = _ImageCovariance.seen_through(lambda freq: psf.otf(zero, freq), lags)
    covariance_x = _ImageCovariance.seen_through(lambda freq: psf.otf(freq, zero), lags)
    along_y = np.stack([_long_rows(kernel.along_y) for kernel in kernels])
    along_x = np.stack([_long_rows(kernel.along_x) for kernel in kernels])
    # Of a lens's products, the first alone responds to what is constant along an axis.
    is_apart = not isinstance(psf, GaussianPsf)
    if is_apart and len(kernels) > 1:
        rest_y, rest_x = _fewest(along_y[1:], along_x[1:], covariance_y, covariance_x)
        along_y = np.concatenate([along_y[:1], rest_y])
        along_x = np.concatenate([along_x[:1], rest_x])
    count = len(along_y)
    for number, (y, x) in enumerate(zip(along_y, along_x, strict=True)):
        keeps = number == 0 or not is_apart
        share_y = count * _largest_variance(x, covariance_x)
        yield _shortest(y, covariance_y, share_y, keeps_ramp=keeps)
        share_x = count * _largest_variance(y, covariance_y)
        yield _shortest(x, covariance_x, share_x, keeps_ramp=keeps)


def _fewest(
    along_y: FloatArray,
    along_x: FloatArray,
    covariance_y: _ImageCovariance,
    covariance_x: _ImageCovariance,
) -> tuple[FloatArray, FloatArray]:
    """Write products of rows, shape ``(terms, n, columns)``, as the fewest that the image tells.

    They are the singular vectors of the sum, in the measure of images of these covariances, whose
    omission changes an image by no more than a share of the smaller tolerance.
    """
    root_y, inverse_y = _root_of_gram(along_y, covariance_y)
    root_x, inverse_x = _root_of_gram(along_x, covariance_x)
    left, values, right = np.linalg.svd(root_y @ root_x.T)
    left_out = np.append(np.cumsum(values[::-1] ** 2)[::-1], 0.0)
    tolerance = _OMITTED_SHARE * min(covariance_y.tolerance, covariance_x.tolerance)
    count = int(np.argmax(left_out <= tolerance))
    share = np.sqrt(values[:count])
    return (
        np.einsum("kj,kna->jna", inverse_y @ left[:, :count] * share, along_y),
        np.einsum("kj,kna->jna", inverse_x @ right[:count].T * share, along_x),
    )


def _root_of_gram(rows: FloatArray, covariance: _ImageCovariance) -> tuple[FloatArray, FloatArray]:
    """Root of the covariance of what the terms make of an image along one axis; its inverse."""
    system = toeplitz(covariance.values[: rows.shape[2]])
    gram = np.einsum("kna,lna->kl", rows @ system, rows) / rows.shape[1]
    values, vectors = np.linalg.eigh(gram)
    roots = np.sqrt(np.maximum(values, values[-1] * _GRAM_ROUNDING))
    return roots[:, None] * vectors.T, vectors / roots


def _long_rows(kernel: FloatArray) -> FloatArray:
    """Weights that sample the spline along one axis, at the positions of `_ShortRows`."""
    reach = _reach_px(len(kernel))
    return spline_sampling(reach - 1 + _POSITIONS_PX, kernel, 2 * reach).dense()


def _reach_px(taps: int) -> int:
    """Pixels on either side that a spline through the pixels blurred by ``taps`` reads."""
    return taps // 2 + 4


_PERIOD_PX = 192
"""Period of the scene: four times the largest window's radius."""

_RIDGE = 1e-6
"""Noise of the reference, relative to the scene's variance, that is always reckoned with, times
``1 - 1 / zoom^2``: at zoom 1 the reference comes back. In a scene of 60 DN rms it is 0.06 DN. With
1e-5 a Gaussian of 0.935 px at zoom 1.3 needs two products."""

_RIDGE_MIN = 1e-9
"""At zoom 1; without, the kernels between the positions of a table are less smooth."""

_RIDGE_REACH = 1e-6
"""Least noise at which the window is chosen: without, a small one extrapolates beyond itself."""

_RIDGE_BORDER = 5e-4
"""The same for windows that do not lie around their pixel, and extrapolate: with 1e-4 and a
noise of 0.5 DN the ring of a Gaussian of 1.2 px at zoom 3 is 5.8 DN off instead of 3.7."""

_RIDGE_SHORT = 1e-4
"""Least noise that shorter kernels must not amplify: 0.6 DN where the image has 60 DN rms."""

_MISSED_OF_IDEAL = 0.02
"""Part of the ideal error by which shorter kernels along either axis may exceed it ..."""

_MISSED_LEAST = 0.02 * 0.01 / 60**2
"""... and the same part of 0.01 DN^2 in images of 60 DN rms, relative to the image's variance."""

_BORDER_STEPS = 6
"""Positions of a table a far pixel, at the border: a cubic spline between them is right to 1e-3."""

_HALF_PIXELS = np.arange(-1, 2) / 2

_TABLE_POSITIONS_PX: FloatArray = np.arange(-5, 6) / 8
"""Subpixel positions of a table: a cubic spline between eighths of a pixel is right to 1e-4."""


@dataclass(frozen=True, slots=True)
class _KernelSolver:
    """What all grids of one PSF, zoom and noise share; the taps are those of a window."""

    psf: Psf
    zoom_y: float
    zoom_x: float
    noise_ratio: float
    scene_correlation_px: float
    taps_y: int
    taps_x: int

    @property
    def scene(self) -> SeenScene:
        """The scene as the near camera sees it."""
        return _scene(self.psf, self.scene_correlation_px)

    @property
    def far(self) -> CrossCovariance:
        """The scene as the far camera sees it."""
        return _far(self.psf, self.scene_correlation_px, self.zoom_y, self.zoom_x)

    @property
    def ridge(self) -> float:
        """Noise that is reckoned with, relative to the variance of a reference pixel."""
        return max(self.noise_ratio, _RIDGE * (1 - 1 / (self.zoom_y * self.zoom_x)), _RIDGE_MIN)

    @property
    def is_diagonal(self) -> bool:
        """Whether the kernels are the same when rows and columns are exchanged."""
        return self.zoom_y == self.zoom_x and self.scene.is_diagonal


@dataclass(frozen=True, slots=True, eq=False)
class _Border:
    """Kernels along one axis of windows shifted towards its start, and towards its end."""

    before: AxisKernels
    after: AxisKernels

    def at(self, positions_px: FloatArray) -> FloatArray:
        """Weights ``(terms, n, taps)`` at positions from the windows' centre."""
        terms, _, taps = self.before.weights.shape
        weights = np.empty((terms, len(positions_px), taps))
        for side, is_there in ((self.before, positions_px < 0), (self.after, positions_px >= 0)):
            spline = CubicSpline(side.positions_px, side.weights, axis=1)
            weights[:, is_there] = spline(positions_px[is_there])
        return weights


@lru_cache(maxsize=32)
def _borders(solver: _KernelSolver, table: KernelTable) -> tuple[_Border, _Border]:
    """Kernels along y and along x; whoever needs the ones needs the others."""
    positions_px = table.along_y.positions_px, table.along_x.positions_px

    def design() -> tuple[FloatArray, ...]:
        axes = _border(solver, table, False), _border(solver, table, True)
        sides = [side for axis in axes for side in (axis.before, axis.after)]
        return tuple(array for side in sides for array in (side.positions_px, side.weights))

    arrays = kept("border", (solver, table.taps, positions_px), design)
    sides = [AxisKernels(*arrays[first : first + 2]) for first in range(0, len(arrays), 2)]
    return _Border(*sides[:2]), _Border(*sides[2:])


def _border(solver: _KernelSolver, table: KernelTable, is_along_x: bool) -> _Border:
    own, zoom = (table.turned(), solver.zoom_x) if is_along_x else (table, solver.zoom_y)
    # Up to three positions tell as much as all.
    sampled = np.unique(np.linspace(0, len(own.along_x.positions_px) - 1, 3).astype(np.int64))
    other_px = tuple(own.along_x.positions_px[sampled].tolist())
    # The same kernels serve both axes if their exchange changes nothing.
    is_along_x &= not (solver.is_diagonal and own.taps[0] == own.taps[1])
    lower, upper = _border_positions(own.taps[0], zoom)
    kernels = _border_kernels(solver, own.taps, lower, other_px, is_along_x)
    before = own.rows_of(kernels, np.array(lower), sampled)
    if solver.scene.is_mirrored:
        # What a window knows of a pixel on one side, its mirror knows on the other.
        return _Border(before, AxisKernels(np.array(upper), before.weights[:, ::-1, ::-1]))
    kernels = _border_kernels(solver, own.taps, upper, other_px, is_along_x)
    return _Border(before, own.rows_of(kernels, np.array(upper), sampled))


@lru_cache(maxsize=1)
def _border_kernels(
    solver: _KernelSolver,
    taps: tuple[int, int],
    own_px: tuple[float, ...],
    other_px: tuple[float, ...],
    is_along_x: bool,
) -> FloatArray:
    own, other = np.array(own_px), np.array(other_px)
    blurred = 1 - 1 / (solver.zoom_y * solver.zoom_x)
    ridge = max(solver.ridge, _RIDGE_BORDER * blurred)
    if not is_along_x:
        return window_kernels(_window(solver.scene, *taps, ridge), solver.far, own, other)
    window = _window(solver.scene, *taps[::-1], ridge)
    return window_kernels(window, solver.far, other, own).transpose(1, 0, 3, 2)


def _border_positions(taps: int, zoom: float) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Positions before and after the middle half pixel, up to half a pixel off the window."""
    last = max(taps / 2, 1.0)
    count = max(ceil((last - 0.5) / zoom * _BORDER_STEPS), 3) + 1
    after = np.linspace(0.5, last, count)
    return tuple((-after[::-1]).tolist()), tuple(after.tolist())


def _table_positions(positions_px: FloatArray) -> tuple[float, ...]:
    """Positions to interpolate between: the fewest that need no other image size's factors.

    Whole zooms sample at whole or at half pixels, as the image's size is odd or even.
    """
    twice = 2 * positions_px
    is_half = np.all(np.abs(twice - np.round(twice)) < 2e-9)
    return tuple((_HALF_PIXELS if is_half else _TABLE_POSITIONS_PX).tolist())


@lru_cache(maxsize=16)
def _kernel_solver(
    psf: Psf, zoom_y: float, zoom_x: float, noise_ratio: float, scene_correlation_px: float
) -> _KernelSolver | None:
    """Solver of one PSF, zoom (at least 1) and noise; None if no window is large enough."""
    (radii,) = kept(
        "radii",
        (psf, zoom_y, zoom_x, noise_ratio, scene_correlation_px),
        lambda: (_radii_px(psf, (zoom_y, zoom_x), noise_ratio, scene_correlation_px),),
    )
    if not np.isfinite(radii).all():
        return None
    taps_y, taps_x = (2 * int(radius) for radius in radii)
    return _KernelSolver(psf, zoom_y, zoom_x, noise_ratio, scene_correlation_px, taps_y, taps_x)


def _radii_px(
    psf: Psf, zooms: tuple[float, float], noise_ratio: float, scene_correlation_px: float
) -> FloatArray:
    """Halves of the windows' sides along y and x, infinite where none is large enough."""
    scene = _scene(psf, scene_correlation_px)
    at_reach = max(noise_ratio, _RIDGE_REACH)
    radii = {
        zoom: window_radius_px(
            scene,
            zoom,
            lambda taps_y, taps_x: FiniteWindow.of(scene, taps_y, taps_x, at_reach),
            at_reach * scene.variance,
        )
        for zoom in set(zooms)
    }
    return np.array([inf if radii[zoom] is None else radii[zoom] for zoom in zooms])


@lru_cache(maxsize=4)
def _scene(psf: Psf, correlation_px: float) -> SeenScene:
    return SeenScene.through(psf, _PERIOD_PX, correlation_px)


@lru_cache(maxsize=16)
def _far(psf: Psf, correlation_px: float, zoom_y: float, zoom_x: float) -> CrossCovariance:
    return _scene(psf, correlation_px).across(zoom_y, zoom_x)


@lru_cache(maxsize=4)
def _window(scene: SeenScene, taps_y: int, taps_x: int, ridge: float) -> FiniteWindow:
    return FiniteWindow.of(scene, taps_y, taps_x, ridge)


@lru_cache(maxsize=64)
def _tables(
    solver: _KernelSolver,
    taps: tuple[int, int],
    y_px: tuple[float, ...],
    x_px: tuple[float, ...],
) -> tuple[KernelTable, KernelTable]:
    """Kernels of windows around their pixel, by position, and with 0 for pixels far off."""
    y, x = np.array(y_px), np.array(x_px)

    def design() -> tuple[FloatArray, ...]:
        window = _window(solver.scene, *taps, solver.ridge)
        table = KernelTable.of(window_kernels(window, solver.far, y, x), y, x)
        return _shortened(solver, table.along_y.weights, table.along_x.weights)

    weights = kept("table", (solver, taps, y, x), design)
    whole, short = (
        KernelTable(AxisKernels(y, along_y), AxisKernels(x, along_x))
        for along_y, along_x in (weights[:2], weights[2:])
    )
    return whole, short


def _shortened(
    solver: _KernelSolver, along_y: FloatArray, along_x: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Leave out what would hardly be missed: products, then the far ends of those that stay."""
    scene, terms = solver.scene, len(along_y)
    noise_ratio = max(solver.noise_ratio, _RIDGE_SHORT)
    reckoned = max(solver.noise_ratio, _RIDGE_REACH) * scene.variance
    ideal = ideal_error(scene, solver.far, reckoned) / scene.variance
    allowed = _MISSED_OF_IDEAL * ideal + _MISSED_LEAST
    power = np.fft.fft2(scene.covariance).real / scene.variance + noise_ratio
    seen_y = [_seen_through(rows, power.T, allowed / terms) for rows in along_x]
    seen_x = [_seen_through(rows, power, allowed / terms) for rows in along_y]
    matters = np.array(
        [
            _largest_variance(rows, seen) > seen.tolerance
            for rows, seen in zip(along_y, seen_y, strict=True)
        ]
    )
    matters[0] = True
    kept_terms = np.flatnonzero(matters)
    along_y, along_x = along_y[kept_terms], along_x[kept_terms]
    return (
        along_y,
        along_x,
        _ends_off(along_y, [seen_y[term] for term in kept_terms]),
        _ends_off(along_x, [seen_x[term] for term in kept_terms]),
    )


def _seen_through(rows: FloatArray, power: FloatArray, tolerance: float) -> _ImageCovariance:
    """Covariance along the columns of an image whose rows are combined by weights, on average."""
    passed = np.mean(np.abs(np.fft.fft(rows, len(power))) ** 2, axis=0)
    values = np.fft.ifft(passed @ power).real / len(power)
    return _ImageCovariance(values, tolerance)


def _ends_off(terms: FloatArray, seen: list[_ImageCovariance]) -> FloatArray:
    taps = terms.shape[2]
    if taps % 2:
        return terms  # of an image smaller than a window
    made = np.zeros_like(terms)
    for number, (rows, covariance) in enumerate(zip(terms, seen, strict=True)):
        # The first product alone acts on a ramp.
        short = _shortest(rows, covariance, 1.0, keeps_ramp=number == 0)
        first = (taps - short.shape[1]) // 2
        made[number, :, first : first + short.shape[1]] = short
    return made


_INSIDE_PX = 0.5 + 1e-9


def lmmse_terms(
    shape: tuple[int, int],
    grid: SamplingGrid,
    psf: Psf,
    *,
    noise_ratio: float = 0.0,
    scene_correlation_px: float = SCENE_CORRELATION_PX,
) -> tuple[tuple[BandedMatrix, BandedMatrix], ...] | None:
    """Pairs ``(Wy, Wx)`` whose ``Wy image Wx^T`` sum to the follow-up, for a reference's shape.

    The PSF is the same near and far, in the camera's own pixels; a zoom of the grid below 1 counts
    as 1. ``noise_ratio`` is the variance of the reference's noise over that of the scene,
    ``scene_correlation_px`` the distance at which the scene's covariance has fallen to 1/e. The
    windows stay inside the reference, so that nothing is assumed about the scene beyond its border.
    None where the largest window would lose too much, at large zooms.

    References
    ----------
    N. Wiener, "Extrapolation, Interpolation, and Smoothing of Stationary Time Series", 1949;
    Y. C. Eldar and M. Unser, "Nonideal sampling and interpolation from noisy observations in
    shift-invariant spaces", IEEE Trans. Signal Process. 54 (2006), 2636-2651.
    """
    if not (noise_ratio >= 0 and np.isfinite(noise_ratio)):
        raise ValueError(f"noise_ratio must not be negative, got {noise_ratio}")
    if not (scene_correlation_px > 0 and np.isfinite(scene_correlation_px)):
        raise ValueError(f"scene_correlation_px must be positive, got {scene_correlation_px}")
    zooms = max(grid.zoom_y, 1.0), max(grid.zoom_x, 1.0)
    solver = _kernel_solver(psf, *zooms, noise_ratio, scene_correlation_px)
    if solver is None:
        return None
    along_y = _Windows.along(grid.rows_px, solver.taps_y, shape[0])
    along_x = _Windows.along(grid.cols_px, solver.taps_x, shape[1])
    which = (along_y.taps, along_x.taps), along_y.table_px, along_x.table_px
    table, short = _tables(solver, *which)
    return tuple(
        zip(
            along_y.matrices(short.along_y, lambda y_px: _borders(solver, table)[0].at(y_px)),
            along_x.matrices(short.along_x, lambda x_px: _borders(solver, table)[1].at(x_px)),
            strict=True,
        )
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Windows:
    """The windows of the outputs along one axis, and whether they lie around them unshifted."""

    starts: IntArray
    position_px: FloatArray
    is_around: BoolArray
    taps: int
    size: int

    @classmethod
    def along(cls, positions_px: FloatArray, taps: int, size: int) -> "_Windows":
        taps = min(taps, size)
        first = np.floor(positions_px - taps / 2 + 1e-9).astype(np.int64) + 1
        starts = np.clip(first, 0, size - taps)
        position_px = positions_px - starts - (taps - 1) / 2
        return cls(starts, position_px, np.abs(position_px) <= _INSIDE_PX, taps, size)

    @property
    def table_px(self) -> tuple[float, ...]:
        """Positions that a table must hold."""
        around = self.position_px[self.is_around]
        return _table_positions(around if len(around) else np.zeros(1))

    def matrices(
        self, inside: AxisKernels, at_border: Callable[[FloatArray], FloatArray]
    ) -> list[BandedMatrix]:
        """Weights of all outputs, one matrix for each term."""
        weights = np.empty((len(inside.weights), len(self.starts), self.taps))
        around = self.position_px[self.is_around]
        if len(inside.positions_px) == 1:
            weights[:, self.is_around] = inside.weights
        else:
            exact = np.searchsorted(inside.positions_px, around - 1e-8)
            exact = np.minimum(exact, len(inside.positions_px) - 1)
            if np.all(np.abs(inside.positions_px[exact] - around) < 1e-8):
                weights[:, self.is_around] = inside.weights[:, exact]
            else:
                spline = CubicSpline(inside.positions_px, inside.weights, axis=1)
                weights[:, self.is_around] = spline(around)
        if not self.is_around.all():
            shifted = np.round(self.position_px[~self.is_around], 9)
            places, which = np.unique(shifted, return_inverse=True)
            weights[:, ~self.is_around] = at_border(places)[:, which]
        return [BandedMatrix(self.starts, term, self.size) for term in weights]
