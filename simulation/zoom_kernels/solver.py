"""The kernels for one PSF and zoom, whatever the images' size and the grid's place."""

from dataclasses import dataclass
from functools import lru_cache
from math import ceil, inf

import numpy as np
from scipy.interpolate import CubicSpline

from simulation.arrays import FloatArray, IntArray
from simulation.kept_kernels import kept
from simulation.psf import Psf
from simulation.zoom_kernels.kernel_table import AxisKernels, KernelTable, window_kernels
from simulation.zoom_kernels.reach import ideal_error, window_radius_px
from simulation.zoom_kernels.scene import CrossCovariance, SeenScene
from simulation.zoom_kernels.short_band import ImageCovariance, largest_variance, shortest
from simulation.zoom_kernels.window import FiniteWindow

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

TABLE_POSITIONS_PX: FloatArray = np.arange(-5, 6) / 8
"""Subpixel positions of a table: a cubic spline between eighths of a pixel is right to 1e-4."""


@dataclass(frozen=True, slots=True)
class KernelSolver:
    """What all grids of one PSF, zoom and noise share.

    Parameters
    ----------
    psf
        Total PSF of the camera.
    zoom_y, zoom_x
        Distance of the far pixels in reference pixels, at least 1.
    noise_ratio
        Variance of a reference pixel's noise over that of the scene.
    scene_correlation_px
        Correlation length of the scene.
    taps_y, taps_x
        Reference pixels of a window.
    """

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

    def table(
        self, taps: tuple[int, int], y_px: tuple[float, ...], x_px: tuple[float, ...]
    ) -> KernelTable:
        """Kernels of windows around their pixel, at positions from the windows' centre."""
        return _tables(self, taps, y_px, x_px)[0]

    def short_table(
        self, taps: tuple[int, int], y_px: tuple[float, ...], x_px: tuple[float, ...]
    ) -> KernelTable:
        """Return the table with 0 for pixels far off, as far as nobody would miss them."""
        return _tables(self, taps, y_px, x_px)[1]

    def rows_at_the_border(self, table: KernelTable, y_px: FloatArray) -> FloatArray:
        """Weights along y of windows that do not lie around their pixel.

        Shape ``(terms, len(y_px), taps)``; the positions count from the windows' centre.
        """
        return _borders(self, table)[0].at(y_px)

    def columns_at_the_border(self, table: KernelTable, x_px: FloatArray) -> FloatArray:
        """Weights along x of windows that do not lie around their pixel."""
        return _borders(self, table)[1].at(x_px)


@dataclass(frozen=True, slots=True, eq=False)
class _Border:
    """Kernels along one axis of windows shifted towards its start, and towards its end."""

    before: AxisKernels
    after: AxisKernels

    def at(self, positions_px: FloatArray) -> FloatArray:
        terms, _, taps = self.before.weights.shape
        weights = np.empty((terms, len(positions_px), taps))
        for side, is_there in ((self.before, positions_px < 0), (self.after, positions_px >= 0)):
            spline = CubicSpline(side.positions_px, side.weights, axis=1)
            weights[:, is_there] = spline(positions_px[is_there])
        return weights


@lru_cache(maxsize=32)
def _borders(solver: KernelSolver, table: KernelTable) -> tuple[_Border, _Border]:
    """Kernels along y and along x; whoever needs the ones needs the others."""
    positions_px = table.along_y.positions_px, table.along_x.positions_px

    def design() -> tuple[FloatArray, ...]:
        axes = _border(solver, table, False), _border(solver, table, True)
        sides = [side for axis in axes for side in (axis.before, axis.after)]
        return tuple(array for side in sides for array in (side.positions_px, side.weights))

    arrays = kept("border", (solver, table.taps, positions_px), design)
    sides = [AxisKernels(*arrays[first : first + 2]) for first in range(0, len(arrays), 2)]
    return _Border(*sides[:2]), _Border(*sides[2:])


def _border(solver: KernelSolver, table: KernelTable, is_along_x: bool) -> _Border:
    own, zoom = (table.turned(), solver.zoom_x) if is_along_x else (table, solver.zoom_y)
    sampled = _sampled(own.along_x)
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
    solver: KernelSolver,
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


def _sampled(axis: AxisKernels) -> IntArray:
    """Up to three positions that tell as much as all."""
    return np.unique(np.linspace(0, len(axis.positions_px) - 1, 3).astype(np.int64))


def table_positions(positions_px: FloatArray) -> tuple[float, ...]:
    """Positions to interpolate between: the fewest that need no other image size's factors.

    Whole zooms sample at whole or at half pixels, as the image's size is odd or even.
    """
    twice = 2 * positions_px
    is_half = np.all(np.abs(twice - np.round(twice)) < 2e-9)
    return tuple((_HALF_PIXELS if is_half else TABLE_POSITIONS_PX).tolist())


@lru_cache(maxsize=16)
def kernel_solver(
    psf: Psf, zoom_y: float, zoom_x: float, noise_ratio: float, scene_correlation_px: float
) -> KernelSolver | None:
    """Solver of one PSF, zoom (at least 1) and noise; None if no window is large enough."""
    (radii,) = kept(
        "radii",
        (psf, zoom_y, zoom_x, noise_ratio, scene_correlation_px),
        lambda: (_radii_px(psf, (zoom_y, zoom_x), noise_ratio, scene_correlation_px),),
    )
    if not np.isfinite(radii).all():
        return None
    taps_y, taps_x = (2 * int(radius) for radius in radii)
    return KernelSolver(psf, zoom_y, zoom_x, noise_ratio, scene_correlation_px, taps_y, taps_x)


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
    solver: KernelSolver,
    taps: tuple[int, int],
    y_px: tuple[float, ...],
    x_px: tuple[float, ...],
) -> tuple[KernelTable, KernelTable]:
    """Kernels of the products that matter, over the whole window and shortened."""
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
    solver: KernelSolver, along_y: FloatArray, along_x: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Leave out what would hardly be missed: products, then the far ends of those that stay.

    Another estimate than the best linear one is worse by the variance of their difference.
    """
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
            largest_variance(rows, seen) > seen.tolerance
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


def _seen_through(rows: FloatArray, power: FloatArray, tolerance: float) -> ImageCovariance:
    """Covariance along the columns of an image whose rows are combined by weights.

    ``power`` is the image's, by the frequencies along and across the rows; the mean of the rows'.
    """
    passed = np.mean(np.abs(np.fft.fft(rows, len(power))) ** 2, axis=0)
    values = np.fft.ifft(passed @ power).real / len(power)
    return ImageCovariance(values, tolerance)


def _ends_off(terms: FloatArray, seen: list[ImageCovariance]) -> FloatArray:
    taps = terms.shape[2]
    if taps % 2:
        return terms  # of an image smaller than a window
    made = np.zeros_like(terms)
    for number, (rows, covariance) in enumerate(zip(terms, seen, strict=True)):
        # The first product alone acts on a ramp.
        short = shortest(rows, covariance, 1.0, keeps_ramp=number == 0)
        first = (taps - short.shape[1]) // 2
        made[number, :, first : first + short.shape[1]] = short
    return made
