"""Independent noise of the reference, propagated to a follow-up from another pose.

``simulate_pose`` weights reference pixels, so the variance at a follow-up pixel is the sum of its
squared weights times their variances. That sum depends on the blur at the position and on where
the position is between the pixels. With ``H`` the transfer function of the blurred cardinal spline,
it is a short Fourier series in the position x,
``sum_m cos(2 pi m x) integral of H(f) H(m - f) df``, because ``H`` is almost zero beyond one cycle
per pixel.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from simulation.arrays import FloatArray
from simulation.pose.simulate import shared_blur
from simulation.pose.view import PoseView
from simulation.psf import GaussianPsf, PsfField
from simulation.resampling import spline_transfer

_POINTS = 17
"""Positions per axis at which the squares are summed; the blur changes slowly over a frame."""

_STEPS_PER_CYCLE = 24
_HIGHEST_CY_PER_PX = 1.5

_ORDERS = ((0, 0), (1, 0), (0, 1), (1, 1), (1, -1))
"""Orders (x, y) of the series; every one but the first represents its opposite too."""


def pose_noise_gain(
    homography: NDArray[np.floating[Any]],
    reference: tuple[int, int],
    size: tuple[int, int],
    psf: GaussianPsf | PsfField | None,
    *,
    origin_px: tuple[float, float] | None = None,
    distortion_k1: float = 0.0,
) -> FloatArray:
    """Variance of the simulated follow-up if every reference pixel has variance 1.

    Parameters
    ----------
    homography, size, psf, origin_px, distortion_k1
        As in ``simulate_pose``.
    reference
        ``(rows, cols)`` of the reference.

    Returns
    -------
    ndarray of shape ``(height, width)``
        At most about 1; 1 where the follow-up takes a reference pixel as it is. Pixels mirrored
        beyond the reference's border count like others.

    Raises
    ------
    ValueError
        As for ``simulate_pose``, about the homography, the size and the PSF.
    """
    view = PoseView.of(homography, reference, size, psf, origin_px, distortion_k1)
    lattice = [np.linspace(0.0, max(count - 1, 1), _POINTS) for count in view.follow_up]
    held = shared_blur(view).held_px2
    rest = view.survey(lattice[0], lattice[1])[..., 2:].reshape(-1, 3) - held
    series = _series(held, _positive_parts(rest)).reshape(_POINTS, _POINTS, len(_ORDERS))
    height, width = view.follow_up
    along_series = RegularGridInterpolator((lattice[0], lattice[1]), series, method="linear")
    gain = np.empty((height, width))
    cols = np.arange(width, dtype=np.float64)
    for row in range(height):
        x, y = view.survey(np.array([float(row)]), cols)[0, :, :2].T
        terms = along_series(np.column_stack([np.full(width, float(row)), cols]))
        waves = [np.cos(2 * np.pi * (m * x + n * y)) for m, n in _ORDERS[1:]]
        gain[row] = terms[:, 0] + 2 * np.sum(terms[:, 1:].T * waves, axis=0)
    return gain


def _positive_parts(blurs_px2: FloatArray) -> FloatArray:
    """Set negative eigenvalues to 0, as the simulation does; rows are xx, xy, yy."""
    matrices = blurs_px2[:, [0, 1, 1, 2]].reshape(-1, 2, 2)
    values, vectors = np.linalg.eigh(matrices)
    parts = (vectors * np.maximum(values, 0.0)[:, None, :]) @ vectors.transpose(0, 2, 1)
    return np.asarray(parts.reshape(-1, 4)[:, [0, 1, 3]])


def _series(held_px2: FloatArray, rests_px2: FloatArray) -> FloatArray:
    """Coefficients of ``_ORDERS`` for the rest at each position, shape ``(n, len(_ORDERS))``."""
    freq = np.arange(
        -_HIGHEST_CY_PER_PX + 0.5, _HIGHEST_CY_PER_PX + 0.5 + 1e-9, 1 / _STEPS_PER_CYCLE
    )
    found = np.empty((len(rests_px2), len(_ORDERS)))
    for k, rest in enumerate(rests_px2):
        for order, (m, n) in enumerate(_ORDERS):
            # Both factors are centred between 0 and the order.
            fx = freq - 0.5 + m / 2
            fy = freq - 0.5 + n / 2
            product = _transfer(fx, fy, held_px2, rest) * _transfer(m - fx, n - fy, held_px2, rest)
            found[k, order] = product.sum() / _STEPS_PER_CYCLE**2
    return found


def _transfer(
    fx: FloatArray, fy: FloatArray, held_px2: FloatArray, rest_px2: FloatArray
) -> FloatArray:
    """Transfer function of the cardinal quintic spline after both blurs, shape (fy, fx).

    The held blur acts on pixels, so its transfer function is periodic like theirs.
    """
    periodic = _gaussian(fx - np.round(fx), fy - np.round(fy), held_px2)
    spline = _cardinal(fx)[None, :] * _cardinal(fy)[:, None]
    return np.asarray(periodic * _gaussian(fx, fy, rest_px2) * spline)


def _gaussian(fx: FloatArray, fy: FloatArray, blur_px2: FloatArray) -> FloatArray:
    xx, xy, yy = blur_px2
    x, y = fx[None, :], fy[:, None]
    return np.asarray(np.exp(-2 * np.pi**2 * (xx * x**2 + 2 * xy * x * y + yy * y**2)))


def _cardinal(freq_cy_per_px: FloatArray) -> FloatArray:
    return np.asarray(np.sinc(freq_cy_per_px) ** 6 / spline_transfer(freq_cy_per_px))
