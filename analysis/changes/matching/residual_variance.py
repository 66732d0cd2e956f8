"""What the difference of two matched photographs scatters by, as a sum of terms.

Each term is an image: the level between the darkest and the brightest, either way, for noise that
may depend on it, half the squared gradient of
the source for an alignment that is wrong by so much (a shift by ``e`` px makes ``e |gradient|``), a
quarter of its squared Laplacian for a wrong blur, and the power of the finest detail of either
photograph for aliasing, compression and sharpening. Their sizes are fitted to the squares of the
difference, most of which holds no change.
"""

from dataclasses import dataclass
from typing import Self

import cv2
import numpy as np
from scipy.optimize import nnls

from analysis.changes.matching.smoothed_warp import PixelPositions, smoothed
from simulation.arrays import BoolArray, Float32Array, FloatArray, IntArray

_ROUNDS = 6
_CLIP = 3.5
"""Standard deviations beyond which a pixel does not count; 0.05 % of normal ones."""

_MEDIAN_CHI2 = 0.4549
"""Median of chi-squared with one degree of freedom."""

_DETAIL_PX = 1.5
_BACKGROUND = 5.0
"""Percentile of the finest detail's power that is noise, which the constant has already."""

_LEAST_DN2 = 1e-12
_STEP = 4
"""Pixels from one to the next of those that percentiles are taken of."""

GRADIENT, LAPLACIAN = 2, 3
"""Places of these terms among the sizes."""

_STRUCTURES = 4

_DARKEST, _BRIGHTEST = 0.1, 99.9
"""Percentiles."""


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class VarianceTerms:
    """Images of the terms, shape ``(rows, cols)`` each.

    Parameters
    ----------
    level
        From 0 at the darkest to 1 at the brightest. The first size is the variance at 0, the
        second that at 1.
    others
        Squared gradient, squared Laplacian, the finest detail of target and source, and, if the
        target was given another tone curve, its squared slope.
    """

    level: Float32Array
    others: tuple[Float32Array, ...]

    @classmethod
    def of(
        cls,
        seen: Float32Array,
        source: Float32Array,
        target: Float32Array,
        positions: PixelPositions,
        tone_slope: Float32Array | None = None,
    ) -> Self:
        """Compute the terms.

        Parameters
        ----------
        seen
            The source, smoothed, on the target's pixels.
        source, target
            The photographs as they are.
        positions
            Where the target's pixels lie in the source.
        tone_slope
            Slope of the tone curve that was applied to the target, if one was: its noise is that
            many times as large.
        """
        source_detail = positions.seen(_finest_detail(source))
        source_detail[np.isnan(source_detail)] = 0
        others = [
            _gradient(seen),
            _laplacian(seen),
            _without_background(_finest_detail(target)),
            _without_background(source_detail),
        ]
        if tone_slope is not None:
            others.append(smoothed(tone_slope * tone_slope, 1.0))
        return cls(level=_level(seen), others=tuple(others))

    def at(self, rows: IntArray, cols: IntArray) -> FloatArray:
        """Terms at pixels, shape ``(terms, pixels)``."""
        level = self.level[rows, cols].astype(np.float64)
        return np.stack([1 - level, level, *(image[rows, cols] for image in self.others)])

    def variance(self, sizes: FloatArray, floor_dn2: Float32Array | None = None) -> Float32Array:
        """Sum of the terms with their sizes, and no less than a floor."""
        dark, bright = sizes[:2].astype(np.float32)
        total = self.level * (bright - dark)
        total += dark + np.float32(_LEAST_DN2)
        for size, image in zip(sizes[2:].astype(np.float32), self.others, strict=True):
            if size > 0:
                total += size * image
        return np.asarray(total if floor_dn2 is None else np.maximum(total, floor_dn2))

    def noise_sizes(self, sizes: FloatArray) -> FloatArray:
        """Return the sizes with those of gradient, Laplacian and fine detail set to 0."""
        is_noise = np.ones(len(sizes), dtype=np.bool_)
        is_noise[GRADIENT : GRADIENT + _STRUCTURES] = False
        return np.asarray(sizes * is_noise)

    def noise_dn2(self, sizes: FloatArray, valid: BoolArray) -> float:
        """Mean variance by the level alone, which is noise."""
        level = float(self.level[valid].mean())
        return float((1 - level) * sizes[0] + level * sizes[1])


def _level(image: Float32Array) -> Float32Array:
    """Level from 0 at the darkest to 1 at the brightest, clipped there."""
    low, high = np.nanpercentile(image[::_STEP, ::_STEP], [_DARKEST, _BRIGHTEST])
    return np.asarray(np.clip((image - np.float32(low)) / np.float32(max(high - low, 1e-6)), 0, 1))


def _gradient(image: Float32Array) -> Float32Array:
    """Half the squared gradient."""
    slope = np.array([-0.5, 0.0, 0.5], dtype=np.float32)
    one = np.ones(1, dtype=np.float32)
    along_x, along_y = (
        cv2.sepFilter2D(image, -1, slope, one),
        cv2.sepFilter2D(image, -1, one, slope),
    )
    return np.asarray((along_x * along_x + along_y * along_y) / 2)


def _laplacian(image: Float32Array) -> Float32Array:
    """A quarter of the squared Laplacian."""
    curved = np.asarray(cv2.Laplacian(image, cv2.CV_32F, ksize=1))
    return np.asarray(curved * curved / 4)


def _finest_detail(image: Float32Array) -> Float32Array:
    """Power of what a Gaussian of 1 px takes from an image, gathered over 1.5 px."""
    detail = image - smoothed(image, 1.0)
    return smoothed(detail * detail, _DETAIL_PX)


def _without_background(power: Float32Array) -> Float32Array:
    """Subtract what the noise alone shows everywhere."""
    return np.asarray(
        np.maximum(power - np.float32(np.percentile(power[::_STEP, ::_STEP], _BACKGROUND)), 0)
    )


def fit_sizes(
    difference_dn: FloatArray, terms: FloatArray, floor_dn2: FloatArray | None
) -> FloatArray:
    """Sizes of the terms, none negative, shape ``(terms,)``.

    Parameters
    ----------
    difference_dn
        At a sample of pixels, shape ``(n,)``.
    terms
        Shape ``(terms, n)``.
    floor_dn2
        Variance that a noise model gives the pixels, which the sum does not go below.
    """
    squares = difference_dn**2
    scale = np.maximum(np.mean(terms, axis=1), 1e-30)
    expected = np.full(len(squares), max(float(np.median(squares)) / _MEDIAN_CHI2, _LEAST_DN2))
    least = np.zeros(1) if floor_dn2 is None else floor_dn2
    sizes = np.zeros(len(terms))
    for _ in range(_ROUNDS):
        counts = squares < _CLIP**2 * expected
        # A square has the variance 2 expected^2.
        weight = 1.0 / expected[counts]
        design = (terms[:, counts] / scale[:, None] * weight).T
        sizes = nnls(design, squares[counts] * weight)[0] / scale
        expected = np.maximum(np.maximum(sizes @ terms, least), _LEAST_DN2)
    return sizes
