"""Covariance of the artefact over positions and images, as autocovariances of tiles of images.

A window's covariance over all positions depends on the distance of two pixels alone, so that one
array of lagged products holds it. It is additive: the covariance over many images is the sum of
their arrays, and what a template makes of the artefact is one sum over lags.
"""

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise
from typing import Self

import numpy as np
from scipy.fft import irfft2, next_fast_len, rfft2

from simulation.arrays import FloatArray


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ArtefactTiles:
    """Lagged products of the artefact, tile by tile.

    Parameters
    ----------
    products_dn2
        Shape ``(tiles, 2 n - 1, 2 n - 1)``: sums over a tile's pixels x of
        ``a(x) a(x + lag)``, even in the lag; lag 0 in the middle; n is the side of the window.
    pixels
        Shape ``(tiles,)``: pixels of each tile, those at the border in part.
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

    Parameters
    ----------
    artefact_dn
        Shape ``(rows, cols)``.
    window_px
        Side n of the window; lags up to n - 1 are taken. The image fades to zero over n / 2 px at
        its border, so that the border itself is not taken for artefact; it counts by the weight it
        has left. What the fading takes of a lag is given back, so that small images tell the same
        covariance as large ones, and one that is positive semidefinite only as far as it is known.
    tiles_per_side
        The image is cut into this many tiles along each axis.

    Raises
    ------
    ValueError
        If the image is smaller than the window.
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
