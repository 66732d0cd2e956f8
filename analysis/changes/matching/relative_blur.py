"""How much blurrier one photograph is than another, told from noise.

A blur of variance t adds ``t / 2`` times the Laplacian. The difference of two photographs and the
Laplacian of one of them share that one's noise, which would pass for blur. So the equations are
multiplied by an instrument that shares it with neither: the other photograph's pixels are divided
like the squares of a chessboard, and what the white ones show is held against the black ones.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import inf, sqrt

import cv2
import numpy as np

from analysis.changes.matching.smoothed_warp import (
    PixelPositions,
    Window,
    smoothed,
    spline_coefficients,
)
from calibration.robust import robust_sigma
from simulation.arrays import BoolArray, Float32Array, FloatArray

_BLOCK_PX = 24
"""Pixels of other blocks are taken as independent."""

_ROUNDS = 4
_CONVERGED_PX2 = 0.03
_OUTLIER = 5.0
_MOST_PX2 = 9.0
_WINDOWS, _WINDOW_PX = 3, 176
"""A large frame is seen through 3 x 3 windows: on texture they tell the blur to 0.005 px^2."""

_LEAST_PX2 = 1.0
_MARGIN_PX2 = 0.4
"""The softer photograph is smoothed by a variance of at least 1 px^2, and by what it is softer and
this much, so that the noise of the sharper one is not all that is smoothed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RelativeBlur:
    """Variance by which a photograph is blurrier, in its own pixels, and its standard error.

    Without any detail the error is infinite.
    """

    value_px2: float
    err_px2: float

    def towards(self, expected_px2: float, expected_err_px2: float) -> float:
        """Mean of the variance and of what is expected, each weighted by its error."""
        share = expected_err_px2**2 / (expected_err_px2**2 + min(self.err_px2, 1e6) ** 2)
        return expected_px2 + share * (self.value_px2 - expected_px2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Smoothing:
    """Gaussians that bring two photographs to one sharpness, widths in pixels of the grid."""

    source_px: float
    target_px: float


def smoothing_for(blur_px2: float) -> Smoothing:
    """Return the Gaussians for a target blurrier than its source by a variance."""
    softer = max(_LEAST_PX2, abs(blur_px2) + _MARGIN_PX2)
    sharper = softer + abs(blur_px2)
    source, target = (sharper, softer) if blur_px2 >= 0 else (softer, sharper)
    return Smoothing(source_px=sqrt(source), target_px=sqrt(target))


def relative_blur(
    source: Float32Array,
    target: Float32Array,
    positions: PixelPositions,
    valid: BoolArray,
    expected_px2: float,
) -> RelativeBlur:
    """Measure the variance by which ``target`` is blurrier than ``source``.

    Parameters
    ----------
    source, target
        The two photographs.
    positions
        Where the target's pixels lie in the source.
    valid
        Pixels of the target that count.
    expected_px2
        Where the search begins.
    """
    zoom = positions.zoom
    value = expected_px2
    step = RelativeBlur(value_px2=0.0, err_px2=inf)
    for _ in range(_ROUNDS):
        widths = smoothing_for(value)
        coefficients = spline_coefficients(source, widths.source_px * zoom)
        step = _step(coefficients, target, positions, valid, widths.target_px)
        if not step.err_px2 < inf:
            return RelativeBlur(value_px2=expected_px2, err_px2=inf)
        value = float(np.clip(value + step.value_px2, -_MOST_PX2, _MOST_PX2))
        if abs(step.value_px2) < max(_CONVERGED_PX2, 0.3 * step.err_px2):
            break
    return RelativeBlur(value_px2=value, err_px2=step.err_px2)


def _windows(shape: tuple[int, int]) -> Iterator[Window]:
    if shape[0] * shape[1] <= (_WINDOWS * _WINDOW_PX) ** 2:
        yield slice(0, shape[0]), slice(0, shape[1])
        return
    tops, lefts = (
        np.linspace(0, max(n - _WINDOW_PX, 0), _WINDOWS).astype(int).tolist() for n in shape
    )
    for top in tops:
        for left in lefts:
            yield (
                slice(top, min(top + _WINDOW_PX, shape[0])),
                slice(left, min(left + _WINDOW_PX, shape[1])),
            )


def _step(
    coefficients: Float32Array,
    target: Float32Array,
    positions: PixelPositions,
    valid: BoolArray,
    smoothing_px: float,
) -> RelativeBlur:
    """Blur that remains between the smoothed photographs, with gain and offset fitted as well."""
    design, instrument, measured, block = [], [], [], []
    blocks_across = positions.shape[1] // _BLOCK_PX + 1
    mean = float(np.mean(target[valid])) if valid.any() else 0.0
    for window in _windows(positions.shape):
        seen = positions.seen(coefficients, window)
        kept = valid[window] & np.isfinite(_laplacian(seen))
        rows, cols = np.nonzero(kept)
        y, x = rows + window[0].start, cols + window[1].start
        place = np.stack(
            [np.ones(len(y)), y / positions.shape[0] - 0.5, x / positions.shape[1] - 0.5]
        )
        halves = _halves(target[window] - mean, smoothing_px)
        for one, other in (halves, halves[::-1]):
            design.append(_columns(seen - mean, kept, place))
            instrument.append(_columns(other, kept, place))
            measured.append(one[kept])
            block.append(y // _BLOCK_PX * blocks_across + x // _BLOCK_PX)
    x, z = np.concatenate(design, axis=1), np.concatenate(instrument, axis=1)
    return _two_stage(x, z, np.concatenate(measured).astype(np.float64), np.concatenate(block))


def _halves(image: Float32Array, smoothing_px: float) -> tuple[Float32Array, Float32Array]:
    """The image as either half of its pixels shows it, smoothed."""
    white = np.add.outer(*(np.arange(n) % 2 for n in image.shape)) % 2 == 1
    halves = (np.where(half, 2 * image, np.float32(0)) for half in (white, ~white))
    one, other = (smoothed(half, smoothing_px) for half in halves)
    return one, other


def _laplacian(image: Float32Array) -> Float32Array:
    return np.asarray(cv2.Laplacian(image, cv2.CV_32F, ksize=1, borderType=cv2.BORDER_REFLECT_101))


def _columns(image: Float32Array, kept: BoolArray, place: FloatArray) -> FloatArray:
    level = image[kept].astype(np.float64)
    return np.concatenate([place, place * level, _laplacian(image)[kept][None] / 2.0])


def _two_stage(
    design: FloatArray, instrument: FloatArray, measured: FloatArray, block: FloatArray
) -> RelativeBlur:
    """Solve with instruments; the error is that of sums over blocks.

    References
    ----------
    H. White, "Instrumental variables regression with independent observations", 1982, with blocks
    as clusters.
    """
    nothing = RelativeBlur(value_px2=0.0, err_px2=inf)
    kept = np.ones(len(measured), dtype=np.bool_)
    gain = design.shape[0] // 2
    for _ in range(2):
        z = instrument[:, kept]
        normal = z @ design[:, kept].T
        scale = np.sqrt(np.abs(np.diag(normal)))
        if (
            not scale.min() > 0
            or np.linalg.cond(normal / np.outer(scale, scale)) > 1e10
            or not normal[-1, -1] > 0
        ):
            return nothing
        solution = np.linalg.solve(normal, z @ measured[kept])
        residual = measured - solution @ design
        kept = np.abs(residual) < _OUTLIER * (robust_sigma(residual) + 1e-9)
    scores = instrument * (residual * kept)
    sums = np.stack([np.bincount(block, weights=row) for row in scores])
    inverse = np.linalg.inv(normal)
    covariance = inverse @ (sums @ sums.T) @ inverse.T
    if not solution[gain] > 0:
        return nothing
    return RelativeBlur(
        value_px2=float(solution[-1] / solution[gain]),
        err_px2=float(np.sqrt(covariance[-1, -1]) / solution[gain]),
    )
