"""The kernels for one PSF and zoom, whatever the images' size and the grid's place."""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from simulation.arrays import FloatArray, IntArray
from simulation.psf import Psf
from simulation.zoom_kernels.kernel_table import AxisKernels, KernelTable, window_kernels
from simulation.zoom_kernels.reach import window_radius_px
from simulation.zoom_kernels.scene import CrossCovariance, SeenScene
from simulation.zoom_kernels.window import FiniteWindow

_PERIOD_PX = 192
"""Period of the scene: four times the largest window's radius."""

_RIDGE = 1e-7
"""Noise of the reference, relative to the scene's variance, that is always reckoned with, times
``1 - 1 / zoom^2``: at zoom 1 the reference comes back. In a scene of 60 DN rms it is 0.02 DN."""

_RIDGE_MIN = 1e-11

_RIDGE_REACH = 1e-6
"""Least noise at which the window is chosen: without, a small one extrapolates beyond itself."""

_RIDGE_BORDER = 5e-4
"""Least noise for windows that do not lie around their pixel, and extrapolate: with 1e-4 and a
noise of 0.5 DN the ring of a Gaussian of 1.2 px at zoom 3 is 5.8 DN off instead of 3.7."""

_EXACT_POSITIONS_MAX = 11

TABLE_POSITIONS_PX: FloatArray = np.arange(-5, 6) / 8
"""Subpixel positions of a table: a cubic spline between eighths of a pixel is right to 1e-4."""


@dataclass(frozen=True, slots=True, eq=False)
class KernelSolver:
    """What all grids of one PSF, zoom and noise share.

    Parameters
    ----------
    scene, far
        The scene as either camera sees it.
    taps_y, taps_x
        Reference pixels of a window.
    ridge
        Noise, relative to the variance of a reference pixel.
    """

    scene: SeenScene
    far: CrossCovariance
    taps_y: int
    taps_x: int
    ridge: float

    def table(
        self, taps: tuple[int, int], y_px: tuple[float, ...], x_px: tuple[float, ...]
    ) -> KernelTable:
        """Kernels of windows around their pixel, at positions from the windows' centre."""
        return _table(self, taps, y_px, x_px)

    def rows_at_the_border(self, table: KernelTable, y_px: FloatArray) -> AxisKernels:
        """Kernels along y of windows that do not lie around their pixel."""
        sampled = _sampled(table.along_x)
        kernels = self._at_the_border(table.taps, y_px, table.along_x.positions_px[sampled])
        return table.rows_of(kernels, y_px, sampled)

    def columns_at_the_border(self, table: KernelTable, x_px: FloatArray) -> AxisKernels:
        """Kernels along x of windows that do not lie around their pixel."""
        sampled = _sampled(table.along_y)
        kernels = self._at_the_border(table.taps, table.along_y.positions_px[sampled], x_px)
        return table.turned().rows_of(kernels.transpose(1, 0, 3, 2), x_px, sampled)

    def _at_the_border(
        self, taps: tuple[int, int], y_px: FloatArray, x_px: FloatArray
    ) -> FloatArray:
        window = _window(self.scene, *taps, max(self.ridge, _RIDGE_BORDER))
        return window_kernels(window, self.far, y_px, x_px)


def _sampled(axis: AxisKernels) -> IntArray:
    return np.unique(np.linspace(0, len(axis.positions_px) - 1, 3).astype(np.int64))


def table_positions(positions_px: FloatArray) -> tuple[float, ...]:
    """Return the positions themselves if they are few, those of a table to interpolate if not."""
    places = np.unique(np.round(positions_px, 9))
    return tuple((TABLE_POSITIONS_PX if len(places) > _EXACT_POSITIONS_MAX else places).tolist())


@lru_cache(maxsize=16)
def kernel_solver(
    psf: Psf, zoom_y: float, zoom_x: float, noise_ratio: float, scene_correlation_px: float
) -> KernelSolver | None:
    """Solver of one PSF, zoom (at least 1) and noise; None if no window is large enough."""
    scene = _scene(psf, scene_correlation_px)
    at_reach = max(noise_ratio, _RIDGE_REACH)
    radii = {
        zoom: window_radius_px(
            scene,
            zoom,
            lambda taps_y, taps_x: FiniteWindow.of(scene, taps_y, taps_x, at_reach),
            at_reach * scene.variance,
        )
        for zoom in (zoom_y, zoom_x)
    }
    radius_y, radius_x = radii[zoom_y], radii[zoom_x]
    if radius_y is None or radius_x is None:
        return None
    ridge = max(noise_ratio, _RIDGE * (1 - 1 / (zoom_y * zoom_x)), _RIDGE_MIN)
    far = scene.across(zoom_y, zoom_x)
    return KernelSolver(scene, far, 2 * radius_y, 2 * radius_x, ridge)


@lru_cache(maxsize=4)
def _scene(psf: Psf, correlation_px: float) -> SeenScene:
    return SeenScene.through(psf, _PERIOD_PX, correlation_px)


@lru_cache(maxsize=4)
def _window(scene: SeenScene, taps_y: int, taps_x: int, ridge: float) -> FiniteWindow:
    return FiniteWindow.of(scene, taps_y, taps_x, ridge)


@lru_cache(maxsize=64)
def _table(
    solver: KernelSolver,
    taps: tuple[int, int],
    y_px: tuple[float, ...],
    x_px: tuple[float, ...],
) -> KernelTable:
    window = _window(solver.scene, *taps, solver.ridge)
    y, x = np.array(y_px), np.array(x_px)
    return KernelTable.of(window_kernels(window, solver.far, y, x), y, x)
