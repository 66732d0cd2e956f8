"""Smooth corrections to the position and brightness of far pixels in a near photograph.

A homography leaves out the lens's distortion, and two photographs see the same point under
different vignetting. Both change slowly over the frame: a cubic displacement and a quartic gain are
added to the homography, found by Gauss-Newton from coarse to fine.
"""

from dataclasses import dataclass
from math import sqrt
from typing import Self

import numpy as np
from scipy.ndimage import distance_transform_edt, gaussian_filter, map_coordinates

from calibration.errors import PairError
from simulation.arrays import BoolArray, FloatArray

_DISPLACEMENT_DEGREE = 3
_GAIN_DEGREE = 4
_BLURS_PX = (6.0, 3.0, 1.5, 0.8, 0.8, 0.8)  # of the far image, level by level
_PSF_GUESS_PX = 0.7
_MARGIN_PX = 4.0
_LEAST_PIXELS = 2000
_CLIPPED_REACH_PX = 3.0
"""Distance from a clipped pixel, in far ones, that the blur of the finest level reaches."""

_FINE_PX = 1.5
"""Levels at which the correlation is looked at: the coarse ones leave little in small frames, the
finest more noise."""

_SLOW_PX = 8.0
"""Width beyond which what both photographs show is taken for their light."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClippedPixels:
    """Pixels of the near and of the far photograph that are clipped, each of its own shape."""

    near: BoolArray
    far: BoolArray

    @classmethod
    def none(cls, near_shape: tuple[int, ...], far_shape: tuple[int, ...]) -> Self:
        """Nothing is clipped."""
        return cls(near=np.zeros(near_shape, dtype=bool), far=np.zeros(far_shape, dtype=bool))

    def away(self, y_px: FloatArray, x_px: FloatArray, reach_px: float, zoom: float) -> BoolArray:
        """Far pixels with no clipped one within reach, in far pixels, in either photograph.

        ``y_px`` and ``x_px`` are their near coordinates.
        """
        beside = _within(self.near, reach_px * zoom)
        rows, cols = (
            np.clip(np.rint(at), 0, most - 1).astype(np.intp)
            for at, most in zip((y_px, x_px), beside.shape, strict=True)
        )
        return np.asarray(~beside[rows, cols] & ~_within(self.far, reach_px))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SmoothAlignment:
    """Near coordinates and gain of every far pixel, each in the shape of the far image.

    ``far(p) = gain(p) (blurred near)(y(p), x(p)) + offset``. ``jacobian``, shape (2, 2), is the
    mean of d(near x, near y) / d(far x, far y) over the overlap. ``correlation`` is that of the
    two photographs once aligned, slow changes of light removed.
    """

    y_px: FloatArray
    x_px: FloatArray
    gain: FloatArray
    jacobian: FloatArray
    residual_rms_dn: float
    correlation: float


def align_smoothly(
    near_dn: FloatArray,
    far_dn: FloatArray,
    far_to_near: FloatArray,
    clipped: ClippedPixels | None = None,
) -> SmoothAlignment:
    """Refine a homography by a smooth displacement and gain.

    Parameters
    ----------
    near_dn, far_dn
        Linear in light, shape ``(rows, cols)``.
    far_to_near
        Homography from far to near pixel centres, shape (3, 3), accurate to a few px.
    clipped
        Pixels that do not count, and neither do their neighbours; None for none.

    Raises
    ------
    PairError
        If the images overlap in fewer than 2000 far pixels, or so few of them are not clipped.
    """
    rows, cols = np.mgrid[: far_dn.shape[0], : far_dn.shape[1]].astype(np.float64)
    start_y, start_x = _projected(far_to_near, rows, cols)
    inside = _inside(start_y, start_x, near_dn.shape)
    if np.count_nonzero(inside) < _LEAST_PIXELS:
        raise PairError(
            "the two photographs hardly overlap: photograph the same scene in both",
            reason="little_overlap",
        )
    clipped = clipped or ClippedPixels.none(near_dn.shape, far_dn.shape)
    u, v = _normalised(cols, inside), _normalised(rows, inside)
    moves, gains = _monomials(u, v, _DISPLACEMENT_DEGREE), _monomials(u, v, _GAIN_DEGREE)
    zoom = sqrt(abs(float(np.linalg.det(_mean_jacobian(start_y, start_x, inside)))))
    move_x, move_y = np.zeros(len(moves)), np.zeros(len(moves))
    gain = np.zeros(len(gains))
    residual_rms = correlation = 0.0
    for blur in _BLURS_PX:
        x = start_x + np.tensordot(move_x, moves, axes=1)
        y = start_y + np.tensordot(move_y, moves, axes=1)
        used = inside & _inside(y, x, near_dn.shape)
        used &= clipped.away(y, x, _CLIPPED_REACH_PX, zoom)
        _refuse_too_few(used)
        own_px = sqrt((zoom * blur) ** 2 + _PSF_GUESS_PX**2 * (zoom**2 - 1))
        smooth = gaussian_filter(near_dn, own_px)
        slope_y, slope_x = _slopes(smooth)
        points = np.stack([y[used], x[used]])
        seen = map_coordinates(smooth, points, order=1)
        seen_y = map_coordinates(slope_y, points, order=1)
        seen_x = map_coordinates(slope_x, points, order=1)
        blurred = gaussian_filter(far_dn, blur)
        target = blurred[used]
        shapes, lights = moves[:, used], gains[:, used]
        brightness = 1.0 if not gain.any() else gain @ lights
        design = np.vstack([
            brightness * seen_x * shapes,
            brightness * seen_y * shapes,
            seen * lights,
            np.ones_like(seen)[None],
        ])  # fmt: skip
        normal = design @ design.T
        solution: FloatArray = np.asarray(np.linalg.lstsq(normal, design @ target)[0], np.float64)
        count = len(moves)
        move_x, move_y = move_x + solution[:count], move_y + solution[count : 2 * count]
        gain = solution[2 * count : -1]
        residual = solution @ design - target
        residual_rms = float(np.sqrt(np.mean(residual**2)))
        if blur <= _FINE_PX:
            correlation = max(correlation, _correlation(blurred, residual, used))
    x = start_x + np.tensordot(move_x, moves, axes=1)
    y = start_y + np.tensordot(move_y, moves, axes=1)
    seen_by_both = inside & _inside(y, x, near_dn.shape)
    return SmoothAlignment(
        y_px=y,
        x_px=x,
        gain=np.tensordot(gain, gains, axes=1),
        jacobian=_mean_jacobian(y, x, seen_by_both),
        residual_rms_dn=residual_rms,
        correlation=correlation,
    )


def _projected(
    far_to_near: FloatArray, y_px: FloatArray, x_px: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Near coordinates ``(y, x)`` of far ones."""
    x, y, scale = np.tensordot(far_to_near, np.stack([x_px, y_px, np.ones_like(x_px)]), axes=1)
    return y / scale, x / scale


def _refuse_too_few(used: BoolArray) -> None:
    if np.count_nonzero(used) < _LEAST_PIXELS:
        raise PairError(
            f"clipped pixels and their neighbours leave {np.count_nonzero(used)} pixels that both "
            f"photographs show, {_LEAST_PIXELS} are needed; shorten the exposure",
            reason="saturated",
        )


def _correlation(seen: FloatArray, residual: FloatArray, used: BoolArray) -> float:
    """Correlation of what is seen with what was fitted to it, without what is slow."""
    fitted, target = np.zeros((2, *seen.shape))
    target[used] = seen[used]
    fitted[used] = seen[used] + residual
    share = np.maximum(gaussian_filter(used.astype(np.float64), _SLOW_PX), 1e-9)
    fitted, target = (
        (image - gaussian_filter(image, _SLOW_PX) / share)[used] for image in (fitted, target)
    )
    power = float(np.sqrt(np.sum(fitted**2) * np.sum(target**2)))
    return float(fitted @ target) / power if power > 0 else 0.0


def _within(mask: BoolArray, reach_px: float) -> BoolArray:
    """Pixels so near to one of the mask."""
    if not mask.any():
        return mask
    return np.asarray(distance_transform_edt(~mask) <= reach_px)


def _inside(y: FloatArray, x: FloatArray, shape: tuple[int, ...]) -> BoolArray:
    within_y = (y >= _MARGIN_PX) & (y <= shape[0] - 1 - _MARGIN_PX)
    return np.asarray(within_y & (x >= _MARGIN_PX) & (x <= shape[1] - 1 - _MARGIN_PX))


def _normalised(coordinate: FloatArray, inside: BoolArray) -> FloatArray:
    low, high = float(coordinate[inside].min()), float(coordinate[inside].max())
    return np.asarray(2 * (coordinate - low) / max(high - low, 1.0) - 1)


def _monomials(u: FloatArray, v: FloatArray, degree: int) -> FloatArray:
    return np.stack([u**i * v**j for i in range(degree + 1) for j in range(degree + 1 - i)])


def _mean_jacobian(y: FloatArray, x: FloatArray, inside: BoolArray) -> FloatArray:
    (x_down, x_right), (y_down, y_right) = _slopes(x), _slopes(y)
    mean = [float(slope[inside].mean()) for slope in (x_right, x_down, y_right, y_down)]
    return np.array(mean).reshape(2, 2)


def _slopes(image: FloatArray) -> tuple[FloatArray, FloatArray]:
    down, right = np.gradient(image)
    return np.asarray(down), np.asarray(right)
