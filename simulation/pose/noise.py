"""Independent noise of the reference, propagated to a follow-up from another pose.

``simulate_pose`` weights reference pixels, so the variance at a follow-up pixel is the sum of its
squared weights times their variances. That sum depends on the prefilter at the position and on
where the position is between the pixels. With ``G`` the prefilter's transfer function, which is
periodic, and ``B`` that of the sampling kernel, it is a short Fourier series in the position x,
``sum_m cos(2 pi m x) integral of G(f)^2 B(f) B(m - f) df``, because ``B`` is almost zero beyond
1.5 cycles per pixel.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import RegularGridInterpolator

from simulation.arrays import FloatArray
from simulation.pose.local_poses import poses_at_followup
from simulation.pose.options import DEFAULT_OPTIONS, PoseOptions
from simulation.pose.prefilter import kernel_transfer, prefilter
from simulation.pose.sampling_kernel import SAMPLING_KERNELS, SamplingKernel
from simulation.pose.view import PoseView
from simulation.pose.view_filter import view_radius
from simulation.psf import Psf, PsfField

_POINTS = 9
"""Positions per axis at which the squares are summed; cubic between."""

_ORDERS = ((0, 0), (1, 0), (0, 1), (1, 1), (1, -1))
"""Orders (x, y) of the series; every one but the first represents its opposite too."""


def pose_noise_gain(
    homography: NDArray[np.floating[Any]],
    reference: tuple[int, int],
    size: tuple[int, int],
    psf: Psf | PsfField | None,
    options: PoseOptions = DEFAULT_OPTIONS,
) -> FloatArray:
    """Variance of the simulated follow-up if every reference pixel has variance 1.

    Parameters
    ----------
    homography, size, psf, options
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
    view = PoseView.of(homography, reference, size, psf, options.origin_px, options.distortion_k1)
    lattice = [np.linspace(0.0, max(count - 1, 1), _POINTS) for count in view.follow_up]
    x, y = np.meshgrid(lattice[1], lattice[0])
    poses = poses_at_followup(view, np.stack([x.ravel(), y.ravel()], axis=-1))
    model, noise_ratio = options.model_of(view), options.noise_ratio
    radius = view_radius(view, model, noise_ratio)
    kernels = [prefilter(pose, model, noise_ratio, radius).kernel for pose in poses]
    sampling = SAMPLING_KERNELS[model]
    series = np.stack([_series(kernel, sampling) for kernel in kernels]).reshape(
        _POINTS, _POINTS, -1
    )
    height, width = view.follow_up
    along_series = RegularGridInterpolator((lattice[0], lattice[1]), series, method="cubic")
    gain = np.empty((height, width))
    cols = np.arange(width, dtype=np.float64)
    for row in range(height):
        x, y = view.survey(np.array([float(row)]), cols)[0, :, :2].T
        terms = along_series(np.column_stack([np.full(width, float(row)), cols]))
        waves = [np.cos(2 * np.pi * (m * x + n * y)) for m, n in _ORDERS[1:]]
        gain[row] = terms[:, 0] + 2 * np.sum(terms[:, 1:].T * waves, axis=0)
    return gain


def _series(kernel: FloatArray, sampling: SamplingKernel) -> FloatArray:
    """Coefficients of ``_ORDERS`` for a prefilter."""
    period = 2 * len(kernel)
    square = kernel_transfer(kernel, period) ** 2
    # Columns inside the half plane stand for two frequencies each.
    square[:, 1:-1] *= 2
    fy: FloatArray = np.fft.fftfreq(period).astype(np.float64)
    fx: FloatArray = np.fft.rfftfreq(period).astype(np.float64)
    return (
        np.array(
            [_product(sampling, fy, n) @ square @ _product(sampling, fx, m) for m, n in _ORDERS]
        )
        / period**2
    )


def _product(kernel: SamplingKernel, freq: FloatArray, order: int) -> FloatArray:
    """Sum of ``B(f) B(order - f)`` over the aliases of f."""
    alias = freq + np.arange(-3, 4.0)[:, None]
    return np.asarray((kernel.transfer(alias) * kernel.transfer(order - alias)).sum(axis=0))
