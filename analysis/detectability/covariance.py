"""Covariance of a window of the difference image: applied and inverted without being written out.

``K = sigma^2 (I + U U^T) + K_artefact`` has n^4 elements, but ``U U^T`` is a product of one matrix
for each axis, and ``K_artefact``, which depends on the distance of two pixels alone, is a
convolution. Conjugate gradients with a circulant preconditioner solve ``K w = s`` some ten times as
fast as a Cholesky factor; see ``benchmarks/bench_detectability.py``.

References
----------
R. H. Chan, M. K. Ng, "Conjugate gradient methods for Toeplitz systems", SIAM Review 38, 1996.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.linalg import LinAlgError, cho_factor, cho_solve, eigh

from simulation.arrays import FloatArray

_RESIDUAL = 1e-9
_ITERATIONS = 400


class Covariance(Protocol):
    """Covariance of the pixels of a window of n x n."""

    def times(self, images: FloatArray) -> FloatArray:
        """``K x`` of each image x; shape (..., n, n)."""
        ...

    def solved(self, image: FloatArray) -> FloatArray:
        """``K^-1 x``, shape (n, n)."""
        ...


@dataclass(frozen=True, slots=True, eq=False)
class DenseCovariance:
    """A covariance written out: shape (n^2, n^2), pixels row by row.

    Where it is not positive definite, as a measured one may be, its least variances count as
    ``least_dn2``.
    """

    matrix_dn2: FloatArray
    least_dn2: float = 0.0

    def times(self, images: FloatArray) -> FloatArray:
        """See `Covariance.times`."""
        flat = images.reshape(-1, self.matrix_dn2.shape[0])
        return np.asarray(flat @ self.matrix_dn2).reshape(images.shape)

    def solved(self, image: FloatArray) -> FloatArray:
        """See `Covariance.solved`."""
        try:
            factor = cho_factor(self.matrix_dn2, lower=True, check_finite=False)
        except LinAlgError:
            variances, axes = eigh(self.matrix_dn2, check_finite=False)
            along = (axes.T @ image.ravel()) / np.maximum(variances, self.least_dn2)
            return np.asarray(axes @ along).reshape(image.shape)
        weights = cho_solve(factor, image.ravel(), check_finite=False)
        return np.asarray(weights).reshape(image.shape)


class WindowCovariance:
    """Noise in both images and the artefact of the alignment.

    Parameters
    ----------
    noise_dn2
        Variance of the white noise in either image, positive.
    up_y, up_x
        Rows of ``U`` for the window, shape (n, follow-up pixels).
    autocovariance_dn2
        Of the artefact, shape ``(2 n - 1, 2 n - 1)``, lag 0 in the middle; positive semidefinite as
        far as it is known.
    """

    def __init__(
        self, noise_dn2: float, up_y: FloatArray, up_x: FloatArray, autocovariance_dn2: FloatArray
    ) -> None:
        n = up_y.shape[0]
        self._side = n
        self._noise_dn2 = noise_dn2
        self._autocovariance_dn2 = autocovariance_dn2
        self._along_y, self._along_x = up_y @ up_y.T, up_x @ up_x.T
        size = next_fast_len(2 * n - 1, real=True)
        self._fft_shape = size, size
        self._artefact = rfft2(_wrapped(autocovariance_dn2, size)).real
        # The mean over each diagonal: what U U^T is apart from its places on the pixel grid.
        noise = rfft2(np.outer(*(_wrapped(_diagonals(a), size) for a in self._axes))).real
        spectrum = noise_dn2 * (1 + np.maximum(noise, 0.0)) + np.maximum(self._artefact, 0.0)
        self._preconditioner = 1.0 / spectrum

    @property
    def _axes(self) -> tuple[FloatArray, FloatArray]:
        return self._along_y, self._along_x

    def times(self, images: FloatArray) -> FloatArray:
        """See `Covariance.times`."""
        white = images + self._along_y @ images @ self._along_x
        return np.asarray(self._noise_dn2 * white + self._filtered(images, self._artefact))

    def solved(self, image: FloatArray) -> FloatArray:
        """See `Covariance.solved`; to a residual of 1e-9."""
        found = np.zeros_like(image)
        residual = image.copy()
        limit = _RESIDUAL * float(np.linalg.norm(image))
        direction = conditioned = self._filtered(residual, self._preconditioner)
        power = float(np.vdot(residual, conditioned))
        for _ in range(_ITERATIONS):
            if float(np.linalg.norm(residual)) <= limit:
                return found
            image_of = self.times(direction)
            curvature = float(np.vdot(direction, image_of))
            if not curvature > 0:
                break
            step = power / curvature
            found = found + step * direction
            residual = residual - step * image_of
            conditioned = self._filtered(residual, self._preconditioner)
            before, power = power, float(np.vdot(residual, conditioned))
            direction = conditioned + (power / before) * direction
        # Next to no noise: the artefact alone is close to singular, or not known well enough.
        return DenseCovariance(self.dense(), self._noise_dn2).solved(image)

    def dense(self) -> FloatArray:
        """All elements, shape (n^2, n^2), pixels row by row."""
        n = self._side
        white = np.eye(n * n) + np.kron(self._along_y, self._along_x)
        # Of lag (y - y', x - x') at [y, x, y', x'].
        by_lag = sliding_window_view(self._autocovariance_dn2, (n, n))[..., ::-1, ::-1]
        return np.asarray(self._noise_dn2 * white + by_lag.reshape(n * n, n * n))

    def _filtered(self, images: FloatArray, spectrum: FloatArray) -> FloatArray:
        """Cut the window out of the circular convolution with a symmetric kernel."""
        full = irfft2(rfft2(images, self._fft_shape) * spectrum, self._fft_shape)
        return np.asarray(full[..., : self._side, : self._side])


def _diagonals(matrix: FloatArray) -> FloatArray:
    """Mean of each diagonal, shape (2 n - 1,), the main one in the middle."""
    n = matrix.shape[0]
    return np.array([np.trace(matrix, lag) / (n - abs(lag)) for lag in range(1 - n, n)])


def _wrapped(lags: FloatArray, size: int) -> FloatArray:
    """Lags around 0 of each axis, moved to where the circular convolution has them."""
    n = (lags.shape[0] + 1) // 2
    full = np.zeros((size,) * lags.ndim)
    full[(slice(0, lags.shape[0]),) * lags.ndim] = lags
    return np.roll(full, (1 - n,) * lags.ndim, axis=tuple(range(lags.ndim)))
