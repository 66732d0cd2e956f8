"""Smooth corrections to the position and brightness of far pixels in a near photograph.

A homography leaves out the lens's distortion, and two photographs see the same point under
different vignetting. Both change slowly over the frame: a cubic displacement and a quartic gain are
added to the homography, found by Gauss-Newton from coarse to fine.
"""

from dataclasses import dataclass
from math import sqrt

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates

from calibration.errors import PairError
from simulation.arrays import BoolArray, FloatArray

_DISPLACEMENT_DEGREE = 3
_GAIN_DEGREE = 4
_BLURS_PX = (6.0, 3.0, 1.5, 0.8, 0.8, 0.8)  # of the far image, level by level
_PSF_GUESS_PX = 0.7
_MARGIN_PX = 4.0
_LEAST_PIXELS = 2000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SmoothAlignment:
    """Near coordinates and gain of every far pixel, each in the shape of the far image.

    ``far(p) = gain(p) (blurred near)(y(p), x(p)) + offset``. ``jacobian``, shape (2, 2), is the
    mean of d(near x, near y) / d(far x, far y) over the overlap.
    """

    y_px: FloatArray
    x_px: FloatArray
    gain: FloatArray
    jacobian: FloatArray
    residual_rms_dn: float


def align_smoothly(
    near_dn: FloatArray, far_dn: FloatArray, far_to_near: FloatArray
) -> SmoothAlignment:
    """Refine a homography by a smooth displacement and gain.

    Parameters
    ----------
    near_dn, far_dn
        Linear in light, shape ``(rows, cols)``.
    far_to_near
        Homography from far to near pixel centres, shape (3, 3), accurate to a few px.

    Raises
    ------
    PairError
        If the images overlap in fewer than 2000 far pixels.
    """
    rows, cols = np.mgrid[: far_dn.shape[0], : far_dn.shape[1]].astype(np.float64)
    start_x, start_y, scale = np.tensordot(
        far_to_near, np.stack([cols, rows, np.ones_like(rows)]), axes=1
    )
    start_x, start_y = start_x / scale, start_y / scale
    inside = _inside(start_y, start_x, near_dn.shape)
    if np.count_nonzero(inside) < _LEAST_PIXELS:
        raise PairError(
            "the two photographs hardly overlap: photograph the same scene in both",
            reason="little_overlap",
        )
    u, v = _normalised(cols, inside), _normalised(rows, inside)
    moves, gains = _monomials(u, v, _DISPLACEMENT_DEGREE), _monomials(u, v, _GAIN_DEGREE)
    zoom = sqrt(abs(float(np.linalg.det(_mean_jacobian(start_y, start_x, inside)))))
    move_x, move_y = np.zeros(len(moves)), np.zeros(len(moves))
    gain = np.zeros(len(gains))
    residual_rms = 0.0
    for blur in _BLURS_PX:
        x = start_x + np.tensordot(move_x, moves, axes=1)
        y = start_y + np.tensordot(move_y, moves, axes=1)
        used = inside & _inside(y, x, near_dn.shape)
        own_px = sqrt((zoom * blur) ** 2 + _PSF_GUESS_PX**2 * (zoom**2 - 1))
        smooth = gaussian_filter(near_dn, own_px)
        slope_y, slope_x = _slopes(smooth)
        points = np.stack([y[used], x[used]])
        seen = map_coordinates(smooth, points, order=1)
        seen_y = map_coordinates(slope_y, points, order=1)
        seen_x = map_coordinates(slope_x, points, order=1)
        target = gaussian_filter(far_dn, blur)[used]
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
        residual_rms = float(np.sqrt(np.mean((solution @ design - target) ** 2)))
    x = start_x + np.tensordot(move_x, moves, axes=1)
    y = start_y + np.tensordot(move_y, moves, axes=1)
    seen_by_both = inside & _inside(y, x, near_dn.shape)
    return SmoothAlignment(
        y_px=y,
        x_px=x,
        gain=np.tensordot(gain, gains, axes=1),
        jacobian=_mean_jacobian(y, x, seen_by_both),
        residual_rms_dn=residual_rms,
    )


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
