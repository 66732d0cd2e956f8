"""The operator of model ``lmmse`` on a grid: banded matrices along either axis."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.psf import Psf
from simulation.resampling import BandedMatrix, SamplingGrid
from simulation.zoom_kernels.kernel_table import AxisKernels
from simulation.zoom_kernels.scene import SCENE_CORRELATION_PX
from simulation.zoom_kernels.solver import kernel_solver, table_positions

_INSIDE_PX = 0.5 + 1e-9


def lmmse_terms(
    shape: tuple[int, int],
    grid: SamplingGrid,
    psf: Psf,
    *,
    noise_ratio: float = 0.0,
    scene_correlation_px: float = SCENE_CORRELATION_PX,
) -> tuple[tuple[BandedMatrix, BandedMatrix], ...] | None:
    """Pairs ``(Wy, Wx)`` whose ``Wy image Wx^T`` sum to the follow-up.

    Parameters
    ----------
    shape
        ``(rows, cols)`` of the reference.
    grid
        Pixels of the follow-up. A zoom below 1 counts as 1.
    psf
        Total PSF of the camera, in its own pixels; the same near and far.
    noise_ratio
        Variance of the reference's noise over that of the scene.
    scene_correlation_px
        Distance at which the scene's covariance has fallen to 1/e.

    Returns
    -------
    tuple of pairs of BandedMatrix, or None
        The windows stay inside the reference, so that nothing is assumed about the scene beyond
        its border. None where the largest window would lose too much, at large zooms.

    Raises
    ------
    ValueError
        If the noise is negative or not finite, or the correlation length is not positive.

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
    solver = kernel_solver(psf, *zooms, noise_ratio, scene_correlation_px)
    if solver is None:
        return None
    along_y = _Windows.along(grid.rows_px, solver.taps_y, shape[0])
    along_x = _Windows.along(grid.cols_px, solver.taps_x, shape[1])
    which = (along_y.taps, along_x.taps), along_y.table_px, along_x.table_px
    table, short = solver.table(*which), solver.short_table(*which)
    return tuple(
        zip(
            along_y.matrices(short.along_y, lambda y_px: solver.rows_at_the_border(table, y_px)),
            along_x.matrices(short.along_x, lambda x_px: solver.columns_at_the_border(table, x_px)),
            strict=True,
        )
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Windows:
    """The windows of the outputs along one axis.

    ``position_px`` counts from the window's centre; ``is_around`` says where the window lies
    around its output, and was not shifted to stay inside the image.
    """

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
        return table_positions(around if len(around) else np.zeros(1))

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
