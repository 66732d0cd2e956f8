"""Covariance of a window of the difference image, and how linear observers weigh its pixels.

``K = sigma^2 (I + U U^T) + K_artefact`` has n^4 elements, but ``U U^T`` is a product of one matrix
for each axis, and ``K_artefact``, which depends on the distance of two pixels alone, is a
convolution. Conjugate gradients with a circulant preconditioner solve ``K w = s`` some ten times as
fast as a Cholesky factor; see ``benchmarks/speed/detectability.py``. Over all positions of a window
one array of lagged products holds the artefact's covariance; over many images the arrays add up,
and what a template makes of the artefact is one sum over lags.

Every observer is a template w; its decision is ``w . g`` and its detectability index
``d' = w . s / sqrt(w . K w)``, the distance of the two means over the standard deviation.

References
----------
R. H. Chan, M. K. Ng, "Conjugate gradient methods for Toeplitz systems", SIAM Review 38, 1996.
H. H. Barrett, K. J. Myers, "Foundations of Image Science", 2004, chapter 13; B. D. Gallas,
H. H. Barrett, "Validating the use of channels to estimate the ideal linear observer", 2003
(Laguerre-Gauss channels).
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from math import pi, sqrt
from typing import Protocol, Self

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.linalg import LinAlgError, cho_factor, cho_solve, eigh
from scipy.special import eval_laguerre, ndtr, ndtri

from analysis.choices import OBSERVERS, Observer
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

    ``noise_dn2``: variance of the white noise in either image, positive. ``up_y, up_x``: rows of
    ``U`` for the window, shape (n, follow-up pixels). ``autocovariance_dn2``: of the artefact,
    shape ``(2 n - 1, 2 n - 1)``, lag 0 in the middle; positive semidefinite as far as it is known.
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
        noise = rfft2(
            np.outer(*(_wrapped(_diagonals(a), size) for a in (self._along_y, self._along_x)))
        ).real
        spectrum = noise_dn2 * (1 + np.maximum(noise, 0.0)) + np.maximum(self._artefact, 0.0)
        self._preconditioner = 1.0 / spectrum

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


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ArtefactTiles:
    """Lagged products of the artefact, tile by tile.

    ``products_dn2``: shape ``(tiles, 2 n - 1, 2 n - 1)``: sums over a tile's pixels x of ``a(x) a(x
    + lag)``, even in the lag; lag 0 in the middle; n is the side of the window. ``pixels``: shape
    ``(tiles,)``: pixels of each tile, those at the border in part.
    """

    products_dn2: FloatArray
    pixels: FloatArray

    @classmethod
    def joined(cls, parts: list["ArtefactTiles"]) -> Self:
        """Tiles of several images together."""
        return cls(
            products_dn2=np.concatenate([part.products_dn2 for part in parts]),
            pixels=np.concatenate([part.pixels for part in parts]),
        )

    @property
    def autocovariance_dn2(self) -> FloatArray:
        """Mean over all pixels of all tiles, shape ``(2 n - 1, 2 n - 1)``, symmetric."""
        return np.asarray(self.products_dn2.sum(axis=0) / self.pixels.sum())

    def template_sums(self, template: FloatArray) -> FloatArray:
        """Sum over each tile's positions of the squared response to the artefact, (tiles,)."""
        return np.asarray(
            np.tensordot(self.products_dn2, template_autocorrelation(template), axes=2)
        )


def artefact_tiles(artefact_dn: FloatArray, window_px: int, tiles_per_side: int) -> ArtefactTiles:
    """Measure the lagged products of an artefact image around its mean.

    ``artefact_dn``: shape ``(rows, cols)``. ``window_px``: side n of the window; lags up to n - 1
    are taken. The image fades to zero over n / 2 px at its border, so that the border itself is not
    taken for artefact; it counts by the weight it has left. What the fading takes of a lag is given
    back, so that small images tell the same covariance as large ones, and one that is positive
    semidefinite only as far as it is known. ``tiles_per_side``: the image is cut into this many
    tiles along each axis.
    """
    if min(artefact_dn.shape) < window_px:
        raise ValueError(
            f"an artefact image of {artefact_dn.shape} px is smaller than the window of "
            f"{window_px} px"
        )
    lag = window_px - 1
    fading = _frame_fading(artefact_dn.shape, window_px)
    regained = _regained(artefact_dn.shape, window_px)
    padded = np.pad(fading * (artefact_dn - artefact_dn.mean()), lag)
    rows, cols = (
        np.linspace(0, size, tiles_per_side + 1).astype(int) for size in artefact_dn.shape
    )
    products, pixels = [], []
    for top, bottom in pairwise(rows):
        for left, right in pairwise(cols):
            around = padded[top : bottom + 2 * lag, left : right + 2 * lag]
            inside = padded[top + lag : bottom + lag, left + lag : right + lag]
            product = _correlated(around, inside, 2 * lag + 1)
            # Templates meet the even part alone.
            products.append(regained * (product + product[::-1, ::-1]) / 2)
            pixels.append(float(np.sum(fading[top:bottom, left:right] ** 2)))
    return ArtefactTiles(products_dn2=np.stack(products), pixels=np.array(pixels))


def lagged_products(first: FloatArray, second: FloatArray, window_px: int) -> FloatArray:
    """Even part of the sums over pixels x of ``first(x) second(x + lag)``, (2 n - 1, 2 n - 1).

    Both images are taken around their means and fade to zero at the border, as in `artefact_tiles`.
    """
    lag = window_px - 1
    fading = _frame_fading(first.shape, window_px)
    around = np.pad(fading * (first - first.mean()), lag)
    product = _correlated(around, fading * (second - second.mean()), 2 * lag + 1)
    return np.asarray(_regained(first.shape, window_px) * (product + product[::-1, ::-1]) / 2)


def faded_pixels(shape: tuple[int, ...], window_px: int) -> float:
    """Number of pixels of an image, those at the border by the weight they have left."""
    return float(np.sum(_frame_fading(shape, window_px) ** 2))


def template_autocorrelation(template: FloatArray) -> FloatArray:
    """Lagged products of a template, shape ``(2 n - 1, 2 n - 1)``, lag 0 in the middle."""
    n = template.shape[0]
    padded = np.pad(template, n - 1)
    return _correlated(padded, template, 2 * n - 1)


@lru_cache(maxsize=32)
def _regained(shape: tuple[int, ...], window_px: int) -> FloatArray:
    """What gives each lag's sum the weight that lag 0 has."""
    fading = _frame_fading(shape, window_px)
    lag = window_px - 1
    overlap = _correlated(np.pad(fading, lag), fading, 2 * lag + 1)
    return np.asarray(overlap[lag, lag] / ((overlap + overlap[::-1, ::-1]) / 2))


def _frame_fading(shape: tuple[int, ...], window_px: int) -> FloatArray:
    return np.outer(*(_fading(size, window_px // 2) for size in shape))


def _fading(size: int, width: int) -> FloatArray:
    """Weights along an axis: a cosine rises from the border to 1 over ``width`` px."""
    from_border = np.minimum(np.arange(size), np.arange(size)[::-1]) + 0.5
    return np.asarray(0.5 - 0.5 * np.cos(np.pi * np.minimum(from_border / width, 1.0)))


def _correlated(around: FloatArray, inside: FloatArray, size: int) -> FloatArray:
    """``out[l] = sum over x of inside[x] around[x + l]`` for l from 0, shape (size, size)."""
    shape = [next_fast_len(n, real=True) for n in around.shape]
    spectrum = rfft2(around, shape) * np.conj(rfft2(inside, shape))
    return np.asarray(irfft2(spectrum, shape)[:size, :size])


_CHANNELS = 6
"""Laguerre-Gauss channels; Gallas and Barrett 2003 find 5 to 10 enough for Gaussian signals."""


def auc_of(d_prime: FloatArray | float) -> FloatArray:
    """Area under the ROC curve of normally distributed decisions, in [0.5, 1] for d' >= 0."""
    return np.asarray(ndtr(np.asarray(d_prime) / sqrt(2.0)))


def d_prime_of_auc(auc: FloatArray | float) -> FloatArray:
    """Index d' of normally distributed decisions with this AUC, in [0, 1]; infinite at its ends."""
    return np.asarray(sqrt(2.0) * ndtri(np.asarray(auc)))


def observer_templates(
    signal: FloatArray, covariance: Covariance, observers: tuple[Observer, ...]
) -> dict[Observer, FloatArray]:
    """Templates of the observers for a signal known exactly in noise of known covariance.

    ``signal``: what is left of the change in the difference image, shape (n, n). Returns ``npw``:
    the signal itself; ``hotelling``: ``K^-1 s``; ``cho``: the Hotelling observer of what the
    Laguerre-Gauss channels let through.
    """
    templates: dict[Observer, FloatArray] = {}
    for observer in observers:
        match observer:
            case "npw":
                templates[observer] = signal
            case "hotelling":
                templates[observer] = covariance.solved(signal)
            case "cho":
                channels = _laguerre_gauss_channels(signal, _CHANNELS)
                spread = covariance.times(channels.T.reshape(-1, *signal.shape))
                inner = channels.T @ spread.reshape(channels.shape[1], -1).T
                through = np.linalg.solve(inner, channels.T @ signal.ravel())
                templates[observer] = np.asarray(channels @ through).reshape(signal.shape)
            case _:
                raise ValueError(f"observer must be one of {', '.join(OBSERVERS)}")
    return templates


def _laguerre_gauss_channels(signal: FloatArray, count: int) -> FloatArray:
    """Rotationally symmetric channels around a signal's centre, as wide as it, orthonormal.

    ``signal``: shape (n, n). Centre and width are the moments of its squared levels. Returns
    ``L_j(2 pi r^2 / a^2) exp(-pi r^2 / a^2)`` with ``a = sqrt(2 pi) sigma``, so that the first one
    matches a Gaussian signal of that sigma; made orthonormal on the pixels.
    """
    position = np.arange(signal.shape[0], dtype=np.float64)
    weight = signal**2 / np.sum(signal**2)
    centre_y, centre_x = float(weight.sum(axis=1) @ position), float(weight.sum(axis=0) @ position)
    r2 = (position[:, None] - centre_y) ** 2 + (position[None, :] - centre_x) ** 2
    # The square of a Gaussian has half its variance: the mean r^2 is that sigma^2.
    sigma2 = max(float(np.sum(weight * r2)), 0.25)
    scaled = pi * r2.ravel() / (2 * pi * sigma2)
    channels = np.stack(
        [eval_laguerre(j, 2 * scaled) * np.exp(-scaled) for j in range(count)], axis=1
    )
    return np.asarray(np.linalg.qr(channels)[0])
