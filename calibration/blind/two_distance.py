"""The PSF from two photographs of any textured scene at two distances, without an edge target.

The camera blurs both photographs equally in its own pixels. In near pixels, the far PSF is the same
PSF stretched by A = d near / d far, so that the kernel between the photographs has the covariance
``A Sigma A' - Sigma``, which is linear in Sigma. For a pure zoom-out z it is ``(z^2 - 1) Sigma``.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, sqrt

import numpy as np

from calibration.blind.alignment import ClippedPixels, align_smoothly
from calibration.blind.inter_image_kernel import InterImageKernel, estimate_kernel
from calibration.errors import PairError
from simulation.arrays import FloatArray

LEAST_ZOOM = 1.15
_LEAST_CORRELATION = 0.6
"""Of aligned photographs; scenes that do not match reach 0.47, as their shapes are bent to fit."""
_WIDEST_SIGMA_PX = 1.2
_REACH_SIGMAS = 3.5
_RADII_PX = (4, 12)
_GRID = 64  # samples of the kernel's transfer function along each axis
_SHARPEST_PX2 = 0.03  # the pixel alone has 1/12
_GAIN = 5  # index among the parameters of the Gaussian
_MOST_STEPS = 50
_CONVERGED = 1e-9


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairPsf:
    """Total PSF covariance from two photographs, px^2, and its error.

    ``covariance_err_px2`` is the covariance matrix, shape (3, 3), of the elements (xx, xy, yy).
    """

    zoom: float
    covariance_px2: FloatArray
    covariance_err_px2: FloatArray


def pair_psf(
    near_dn: FloatArray,
    far_dn: FloatArray,
    far_to_near: FloatArray,
    *,
    near_noise_dn2: float = 0.0,
    clipped: ClippedPixels | None = None,
) -> PairPsf:
    """Total PSF from a near and a far photograph.

    Parameters
    ----------
    near_dn, far_dn
        Linear in light, shape ``(rows, cols)``.
    far_to_near
        Homography from far to near pixel centres, shape (3, 3).
    near_noise_dn2
        Noise variance of a pixel in the near image; if it is left out, noise is taken for blur.
    clipped
        Pixels that do not count; None for none.

    Raises
    ------
    PairError
        If the two do not match there, the distances are too similar, or the photographs have too
        little detail.
    """
    alignment = align_smoothly(near_dn, far_dn, far_to_near, clipped)
    if alignment.correlation < _LEAST_CORRELATION:
        raise PairError(
            "the photographs do not match where they were expected to, their correlation is "
            f"{alignment.correlation:.2f}",
            reason="not_aligned",
        )
    jacobian = alignment.jacobian
    zoom = sqrt(abs(float(np.linalg.det(jacobian))))
    if zoom < LEAST_ZOOM:
        raise PairError(
            f"the second photograph is {zoom:.3f} times as far away as the first; at least "
            f"{LEAST_ZOOM} is needed, and 2 is good",
            reason="one_distance",
        )
    reach = _REACH_SIGMAS * _WIDEST_SIGMA_PX * sqrt(zoom**2 - 1)
    radius = min(max(ceil(reach), _RADII_PX[0]), _RADII_PX[1])
    kernel = estimate_kernel(
        near_dn,
        far_dn,
        alignment,
        radius_px=radius,
        near_noise_dn2=near_noise_dn2,
        clipped=clipped,
    )
    between, between_err = _gaussian_of(kernel)
    # (A x A - I) vec Sigma = vec Sigma_k, for the three elements of symmetric matrices.
    a, b, c, d = jacobian.ravel()
    system = np.array(
        [
            [a * a - 1, 2 * a * b, b * b],
            [a * c, a * d + b * c - 1, b * d],
            [c * c, 2 * c * d, d * d - 1],
        ]
    )
    inverse = np.linalg.inv(system)
    xx, xy, yy = inverse @ between
    if np.linalg.eigvalsh([[xx, xy], [xy, yy]])[0] < _SHARPEST_PX2:
        raise PairError(
            "the far photograph is not softer than the near one: was it taken in focus?",
            reason="sharp",
        )
    return PairPsf(
        zoom=zoom,
        covariance_px2=np.array([[xx, xy], [xy, yy]]),
        covariance_err_px2=inverse @ between_err @ inverse.T,
    )


def combined(pairs: Sequence[PairPsf]) -> tuple[FloatArray, FloatArray]:
    """Weighted mean of the covariances' elements (xx, xy, yy), and its covariance matrix.

    If the pairs disagree by more than their errors, the errors grow by that factor.
    """
    if not pairs:
        raise ValueError("there is no pair of photographs")
    elements = [pair.covariance_px2[[0, 0, 1], [0, 1, 1]] for pair in pairs]
    weights = [np.linalg.inv(pair.covariance_err_px2) for pair in pairs]
    covariance = np.linalg.inv(np.sum(weights, axis=0))
    mean = covariance @ np.sum([w @ e for w, e in zip(weights, elements, strict=True)], axis=0)
    if len(pairs) > 1:
        chi2 = sum(
            float((e - mean) @ w @ (e - mean)) for w, e in zip(weights, elements, strict=True)
        )
        covariance = covariance * max(1.0, chi2 / (3 * (len(pairs) - 1)))
    return mean, covariance


def _gaussian_of(kernel: InterImageKernel) -> tuple[FloatArray, FloatArray]:
    """Covariance elements (xx, xy, yy) of the Gaussian that fits the pixels best, and their error.

    Gauss-Newton on the squared error of the far pixels, which the normal equations contain in full;
    the covariance, a shift, a gain and an offset are free.
    """
    guess = _REACH_SIGMAS / kernel.radius_px
    parameters = np.array([guess**-2, 0.0, guess**-2, 0.0, 0.0, 1.0, 0.0]) * 0.5
    parameters[_GAIN] = 1.0
    unknowns, slopes = _gaussian_kernel(parameters, kernel.radius_px)
    error = kernel.squared_error(unknowns)
    for _ in range(_MOST_STEPS):
        system = slopes.T @ kernel.normal @ slopes
        step = np.linalg.solve(system, slopes.T @ (kernel.right - kernel.normal @ unknowns))
        for shrunk in 0.5 ** np.arange(12):
            trial = parameters + shrunk * step
            if not _is_covariance(trial):
                continue
            unknowns, slopes = _gaussian_kernel(trial, kernel.radius_px)
            if kernel.squared_error(unknowns) <= error:
                break
        else:
            break
        gained, error = error - kernel.squared_error(unknowns), kernel.squared_error(unknowns)
        parameters = trial
        if gained <= _CONVERGED * error:
            break
    unknowns, slopes = _gaussian_kernel(parameters, kernel.radius_px)
    # The pixels scatter about the model with the noise of both images.
    noisy = error + float(unknowns @ (kernel.noisy_normal - kernel.normal) @ unknowns)
    variance = noisy / max(kernel.pixels - len(parameters), 1)
    inverse = np.linalg.inv(slopes.T @ kernel.normal @ slopes)
    covariance = variance * inverse @ (slopes.T @ kernel.noisy_normal @ slopes) @ inverse
    return parameters[:3], np.asarray(covariance[:3, :3])


def _is_covariance(parameters: FloatArray) -> bool:
    xx, xy, yy = parameters[:3]
    return bool(xx > 0 and yy > 0 and xy**2 < xx * yy)


def _gaussian_kernel(parameters: FloatArray, radius: int) -> tuple[FloatArray, FloatArray]:
    """Weights and offset of a Gaussian kernel from its transfer function, and their derivatives."""
    xx, xy, yy, shift_x, shift_y, gain, offset = parameters
    fy, fx = np.meshgrid(np.fft.fftfreq(_GRID), np.fft.fftfreq(_GRID), indexing="ij")
    exponent = -2 * np.pi**2 * (xx * fx**2 + 2 * xy * fx * fy + yy * fy**2)
    transfer = np.exp(exponent - 2j * np.pi * (fx * shift_x + fy * shift_y))
    factors = np.stack(
        [
            gain * -2 * np.pi**2 * fx**2,
            gain * -4 * np.pi**2 * fx * fy,
            gain * -2 * np.pi**2 * fy**2,
            gain * -2j * np.pi * fx,
            gain * -2j * np.pi * fy,
            np.ones_like(fx),
        ]
    )
    crop = np.r_[-radius : radius + 1]
    grids = np.fft.ifft2(factors * transfer).real[:, crop[:, None], crop]
    slopes = np.zeros((crop.size**2 + 1, len(parameters)))
    slopes[:-1, :-1] = grids.reshape(len(grids), -1).T
    slopes[-1, -1] = 1.0
    return np.append(gain * slopes[:-1, _GAIN], offset), slopes
