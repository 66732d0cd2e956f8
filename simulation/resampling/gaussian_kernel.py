"""Gaussian blurs on a pixel grid, as sums of separable kernels.

A Gaussian *sampled* at the pixels is a wrong blur below a width of 0.6 px: for 0.3 px, it blurs by
0.09 px. The kernels here are made from the transfer function instead: they are the inverse
transform of ``exp(-2 pi^2 f^T S f)`` up to the Nyquist frequency. A correlated Gaussian
(off-diagonal ``S``) is not a product of two kernels; its singular value decomposition writes it as
a short sum of products.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import ceil

import numpy as np

from simulation.arrays import FloatArray
from simulation.choices import GaussianForm

_MATCHED_TAIL_TOLERANCE = 1e-3
"""Largest weight that the ``matched`` model cuts off, in both ``zoom_out`` and ``simulate_pose``;
it keeps two successive zooms within 0.07 % of a single one."""

_TERMS_TOLERANCE = 3e-5
"""Terms are kept until the omitted singular values sum to less than this."""

_CUT_SIGMAS = 4.5
"""A Gaussian is below 1e-4 of its peak there."""

_SPLINE_RADIUS_MIN_PX = 13
"""Least half-width with a spline prefilter, which itself has fallen to 2e-5 there."""

_SAMPLED_TRUNCATION = 4.0
"""Half-width in sigmas, as in ``scipy.ndimage.gaussian_filter``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BlurCovariance:
    """Covariance of a blur in px^2; it may be singular, and zero means no blur.

    Raises
    ------
    ValueError
        If it is not positive semi-definite.
    """

    yy_px2: float
    xx_px2: float
    xy_px2: float = 0.0

    def __post_init__(self) -> None:
        ceiling = self.yy_px2 * self.xx_px2 * (1 + 1e-9)
        if not (self.yy_px2 >= 0 and self.xx_px2 >= 0 and self.xy_px2**2 <= ceiling):
            raise ValueError(f"a blur needs a positive semi-definite covariance, got {self}")


@dataclass(frozen=True, slots=True, eq=False)
class SeparableTerm:
    """One product ``along_y[i] * along_x[j]`` of a kernel; odd lengths, centred at 0 px."""

    along_y: FloatArray
    along_x: FloatArray


@lru_cache(maxsize=64)
def gaussian_terms(
    covariance: BlurCovariance,
    *,
    tail_tolerance: float,
    spline_prefilter: bool = False,
    form: GaussianForm = "transfer",
) -> tuple[SeparableTerm, ...]:
    """Kernels whose products sum to the blur of ``covariance``; the total is 1.

    The transfer function has a kink at the Nyquist frequency, so the kernel's tail falls only with
    the square of the distance, with alternating signs. It is cut off once it is below
    ``tail_tolerance`` and the Gaussian itself has ended, with half weight on the last pixel.

    Parameters
    ----------
    covariance
        Covariance of the blur, px^2.
    tail_tolerance
        Largest weight that may be cut off.
    spline_prefilter
        Divide the transfer function by that of the quintic B-spline, so that the kernel gives
        the coefficients of the spline through the blurred pixels.
    form
        ``"sampled"``: the sampled Gaussian of ``scipy.ndimage``, for comparison; it supports no
        prefilter.

    Returns
    -------
    tuple of SeparableTerm
        One term for an uncorrelated Gaussian.
    """
    if form == "sampled" and spline_prefilter:
        raise ValueError("a sampled Gaussian cannot be divided by the spline's transfer function")
    if covariance.xy_px2 == 0:
        along_y, along_x = (
            _kernel_1d(variance, tail_tolerance, spline_prefilter, form)
            for variance in (covariance.yy_px2, covariance.xx_px2)
        )
        return (SeparableTerm(along_y, along_x),)
    return _correlated_terms(covariance, tail_tolerance, spline_prefilter, form)


def matched_terms(covariance: BlurCovariance) -> tuple[SeparableTerm, ...]:
    """Kernels from pixels to the coefficients of the quintic spline through the blurred pixels."""
    return gaussian_terms(covariance, tail_tolerance=_MATCHED_TAIL_TOLERANCE, spline_prefilter=True)


def _kernel_1d(
    variance_px2: float, tail_tolerance: float, spline_prefilter: bool, form: GaussianForm
) -> FloatArray:
    if variance_px2 == 0 and not spline_prefilter:
        return np.ones(1)
    sigma_px = np.sqrt(variance_px2)
    if form == "sampled":
        radius = int(_SAMPLED_TRUNCATION * sigma_px + 0.5)
        kernel = np.exp(-0.5 * (np.arange(-radius, radius + 1) / sigma_px) ** 2)
        return np.asarray(kernel / kernel.sum())
    size = _transform_size(sigma_px)
    freq: FloatArray = np.fft.fftfreq(size).astype(np.float64)
    transfer = np.exp(-2 * np.pi**2 * variance_px2 * freq**2)
    if spline_prefilter:
        transfer = transfer / spline_transfer(freq)
    half = np.fft.ifft(transfer).real[: size // 2]
    radius = _cut_radius(half, sigma_px, tail_tolerance)
    if spline_prefilter:
        radius = max(radius, _SPLINE_RADIUS_MIN_PX)
    kernel = np.concatenate([half[radius:0:-1], half[: radius + 1]])
    kernel[[0, -1]] *= 0.5
    return np.asarray(kernel / kernel.sum())


def _correlated_terms(
    covariance: BlurCovariance, tail_tolerance: float, spline_prefilter: bool, form: GaussianForm
) -> tuple[SeparableTerm, ...]:
    sigma_y_px, sigma_x_px = np.sqrt(covariance.yy_px2), np.sqrt(covariance.xx_px2)
    if form == "sampled":
        radii = [int(_SAMPLED_TRUNCATION * s + 0.5) for s in (sigma_y_px, sigma_x_px)]
        y, x = np.ogrid[-radii[0] : radii[0] + 1, -radii[1] : radii[1] + 1]
        yy, xx, xy = covariance.yy_px2, covariance.xx_px2, covariance.xy_px2
        quadratic = (xx * y**2 - 2 * xy * x * y + yy * x**2) / (yy * xx - xy**2)
        kernel = np.exp(-0.5 * quadratic)
    else:
        size = _transform_size(max(sigma_y_px, sigma_x_px))
        freq: FloatArray = np.fft.fftfreq(size).astype(np.float64)
        fy, fx = freq[:, None], freq[None, :]
        transfer = np.exp(
            -2
            * np.pi**2
            * (
                covariance.yy_px2 * fy**2
                + covariance.xx_px2 * fx**2
                + 2 * covariance.xy_px2 * fx * fy
            )
        )
        # A pixel grid cannot distinguish +1/2 and -1/2 cycles/px: the real part is their mean.
        if spline_prefilter:
            transfer = transfer / (spline_transfer(fy) * spline_transfer(fx))
        full = np.fft.fftshift(np.fft.ifft2(transfer).real)
        radii = [
            len(_kernel_1d(v, tail_tolerance, spline_prefilter, form)) // 2
            for v in (covariance.yy_px2, covariance.xx_px2)
        ]
        mid = size // 2
        kernel = full[
            mid - radii[0] : mid + radii[0] + 1, mid - radii[1] : mid + radii[1] + 1
        ].copy()
        kernel[[0, -1], :] *= 0.5
        kernel[:, [0, -1]] *= 0.5
    u, singular, vt = np.linalg.svd(kernel / kernel.sum())
    left_out = singular.sum() - np.cumsum(singular)
    count = int(np.argmax(left_out <= _TERMS_TOLERANCE)) + 1
    gains = singular[:count] / sum(singular[k] * u[:, k].sum() * vt[k].sum() for k in range(count))
    return tuple(SeparableTerm(u[:, k] * gains[k], vt[k]) for k in range(count))


def spline_transfer(freq_cy_per_px: FloatArray) -> FloatArray:
    """Transfer function of the quintic B-spline sampled at the pixels (1, 26, 66, 26, 1)/120."""
    angle = 2 * np.pi * freq_cy_per_px
    return np.asarray((33 + 26 * np.cos(angle) + np.cos(2 * angle)) / 60)


def _transform_size(sigma_px: float) -> int:
    """Length of the transform, long enough that the kernel does not reach its periodic copy."""
    return int(2 ** np.ceil(np.log2(max(512.0, 24 * sigma_px))))


def _cut_radius(half_kernel: FloatArray, sigma_px: float, tail_tolerance: float) -> int:
    above = np.flatnonzero(np.abs(half_kernel) > tail_tolerance)
    return max(int(above[-1]) + 1, ceil(_CUT_SIGMAS * sigma_px))
