"""What the reference's blur lacks at a position of the follow-up, compiled.

With covariance Sigma of the PSF in either image and A the derivative of the warp, that is
``A Sigma_far A^T - Sigma_near``; where it has a negative eigenvalue the follow-up is the sharper
one in that direction.
"""

from math import sqrt
from typing import NamedTuple

import numpy as np

from simulation.arrays import FloatArray
from simulation.compiled import compiled, compiled_part
from simulation.pose.lens import warp

NEARER_TOLERANCE_PX2 = 1e-3
"""A smaller surplus of variance changes the contrast at Nyquist by less than 0.5 %."""


class BlurredWarp(NamedTuple):
    """Positions of a follow-up's pixels in the reference, and the PSF of either image.

    Parameters
    ----------
    matrix
        Homography from ideal follow-up to ideal reference pixels.
    lens
        As in ``simulation.pose.lens``.
    psf
        Polynomial coefficients of the covariance, shape ``(3, n)``.
    frame
        The polynomials' centre x, y and 1 / radius, and the position x, y of the follow-up's pixel
        (0, 0) in their frame.
    """

    matrix: FloatArray
    lens: FloatArray
    psf: FloatArray
    frame: FloatArray


@compiled_part(nogil=True, forceinline=True)
def _covariance(
    psf: FloatArray, frame: FloatArray, x_px: float, y_px: float
) -> tuple[float, float, float]:
    """Elements xx, xy, yy of a field; ``frame`` begins with its centre x, y and 1 / radius."""
    count = psf.shape[1]
    if count == 1:
        return psf[0, 0], psf[1, 0], psf[2, 0]
    u, v = (x_px - frame[0]) * frame[2], (y_px - frame[1]) * frame[2]
    xx = xy = yy = 0.0
    total = power = 0
    for k in range(count):
        monomial = 1.0
        for _ in range(total - power):
            monomial *= u
        for _ in range(power):
            monomial *= v
        xx += psf[0, k] * monomial
        xy += psf[1, k] * monomial
        yy += psf[2, k] * monomial
        power += 1
        if power > total:
            total, power = total + 1, 0
    return xx, xy, yy


@compiled_part(nogil=True, forceinline=True)
def _missing_blur(
    matrix: FloatArray,
    lens: FloatArray,
    psf: FloatArray,
    frame: FloatArray,
    col: float,
    row: float,
) -> tuple[float, float, float, float, float, float, float]:
    """Position (x, y), its derivative along the row, and the blur (xx, xy, yy) missing there."""
    x, y, a, b, c, d = warp(matrix, lens, col, row)
    xx, xy, yy = _covariance(psf, frame, col + frame[3], row + frame[4])
    own_xx, own_xy, own_yy = _covariance(psf, frame, x, y)
    return (
        x,
        y,
        a,
        c,
        a * a * xx + 2 * a * b * xy + b * b * yy - own_xx,
        a * c * xx + (a * d + b * c) * xy + b * d * yy - own_xy,
        c * c * xx + 2 * c * d * xy + d * d * yy - own_yy,
    )


@compiled_part(nogil=True, forceinline=True)
def surveyed(
    matrix: FloatArray,
    lens: FloatArray,
    psf: FloatArray,
    frame: FloatArray,
    col: float,
    row: float,
) -> tuple[float, float, float, float, float]:
    """Position (x, y), its derivative along the row, and the missing blur's least eigenvalue."""
    x, y, a, c, xx, xy, yy = _missing_blur(matrix, lens, psf, frame, col, row)
    half = (xx - yy) / 2
    return x, y, a, c, (xx + yy) / 2 - sqrt(half * half + xy * xy)


@compiled(nogil=True)
def survey(view: BlurredWarp, rows: FloatArray, cols: FloatArray) -> FloatArray:
    """(x, y, xx, xy, yy) of the missing blur at ``[i, j]`` of a lattice; it may be indefinite."""
    matrix, lens, psf, frame = view
    seen = np.empty((len(rows), len(cols), 5))
    for i in range(len(rows)):
        for j in range(len(cols)):
            x, y, _, _, xx, xy, yy = _missing_blur(matrix, lens, psf, frame, cols[j], rows[i])
            seen[i, j, 0], seen[i, j, 1] = x, y
            seen[i, j, 2], seen[i, j, 3], seen[i, j, 4] = xx, xy, yy
    return seen


@compiled(nogil=True)
def derivatives(
    matrix: FloatArray, lens: FloatArray, points_px: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Images ``(n, 2)`` of points ``(n, 2)``, order (x, y), and the warp's derivatives there."""
    images, slopes = np.empty_like(points_px), np.empty((len(points_px), 2, 2))
    for i in range(len(points_px)):
        x, y, a, b, c, d = warp(matrix, lens, points_px[i, 0], points_px[i, 1])
        images[i, 0], images[i, 1] = x, y
        slopes[i, 0, 0], slopes[i, 0, 1], slopes[i, 1, 0], slopes[i, 1, 1] = a, b, c, d
    return images, slopes
