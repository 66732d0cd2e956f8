"""The kernels of all subpixel positions as a short sum of products of one-dimensional ones.

The first product holds the kernels' sums along either axis, so that it alone acts on what varies
along one axis only: a constant stays a constant and a ramp a ramp. The others are the singular
vectors of the rest, and sum to zero along both axes.
"""

from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from simulation.arrays import FloatArray, IntArray
from simulation.zoom_kernels.scene import CrossCovariance
from simulation.zoom_kernels.window import FiniteWindow

_TERM_TOLERANCE = 3e-4
"""Part of a scene's standard deviation that the omitted products may leave: 0.02 of 60 DN."""

_TERMS_MAX = 16

_WEIGHT_CORRELATION_PX = 30.0
"""The rest is measured on scenes of this correlation length along either axis."""


@dataclass(frozen=True, slots=True, eq=False)
class AxisKernels:
    """One axis of the products.

    Parameters
    ----------
    positions_px
        Positions of the far pixel from the window's centre, shape ``(n,)``.
    weights
        Shape ``(terms, n, taps)``.
    """

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

        Their products with the table's along x are the nearest to the exact kernels.

        Parameters
        ----------
        kernels
            The exact ones, shape ``(len(y_px), len(sampled), taps_y, taps_x)``.
        y_px
            The further positions along y.
        sampled
            Which of the table's positions along x they stand for; a few tell as much as all.
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
    """Split into the kernels for what varies along y alone, along x alone, and the rest.

    How much the former differ between the positions along the other axis is 1e-5 of the scene.
    """
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
