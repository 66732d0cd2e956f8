"""The best filter of a reference before a piecewise polynomial samples it, for one local warp.

The follow-up's camera sees the scene through ``H(A^T f)`` in the reference's coordinates, A being
the derivative of the warp. What a filter G of the reference's pixels and a sampling kernel of
transfer B make of them is ``G B``; the best G is the projection of the best linear estimate onto
what the kernel can sample. The kernel is solved for the taps that it has, rather than
cut out of an infinite one. The derivation is in ``docs/theory-pose.md``.

Either sampling kernel has six pieces of degree five and a continuous derivative, and reproduces
constants and ramps. They differ in the copies of the spectrum that they leave at whole numbers of
cycles per pixel: those of the quintic B-spline vanish fastest at the frequency 0, those of the
other kernel are least over a band, to which the prefilter restores what either kernel takes from
it.

References
----------
T. Blu, P. Thevenaz and M. Unser, "MOMS: maximal-order interpolation of minimal support", IEEE
Trans. Image Processing 10 (2001): kernels of one support differ by their copies alone.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import pi

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from simulation.arrays import FloatArray, IntArray
from simulation.choices import PoseModel
from simulation.psf import Psf
from simulation.seen_scene import SCENE_CORRELATION_PX

_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(24)
"""Exact to rounding for a piece times a cosine of up to 4 cycles per pixel."""

_Piece = tuple[float, float, float, float, float, float]


@dataclass(frozen=True, slots=True)
class SamplingKernel:
    """An even function of the distance, up to 3 px: ``sum_k pieces[j][k] u^k`` at ``j + u`` px."""

    pieces: tuple[_Piece, _Piece, _Piece]

    def transfer(self, freq_cy_per_px: FloatArray) -> FloatArray:
        """Fourier transform, real; 1 at 0 and 0 at every other whole number."""
        freq = np.asarray(freq_cy_per_px, dtype=np.float64)
        u = (_NODES + 1) / 2
        coefficients = np.array(self.pieces)
        values = (u[:, None] ** np.arange(6)) @ coefficients.T * _WEIGHTS[:, None]
        distance = u[:, None] + np.arange(3)
        waves = np.cos(2 * np.pi * freq[..., None] * distance.ravel())
        return np.asarray(waves @ values.ravel())

    def transfer_at_pixels(self, freq_cy_per_px: FloatArray) -> FloatArray:
        """Transfer function of the kernel's values at the pixels."""
        freq = np.asarray(freq_cy_per_px, dtype=np.float64)
        at_0, at_1, at_2 = (piece[0] for piece in self.pieces)
        return at_0 + 2 * at_1 * np.cos(2 * np.pi * freq) + 2 * at_2 * np.cos(4 * np.pi * freq)


QUINTIC_SPLINE = SamplingKernel(
    (
        (66 / 120, 0.0, -60 / 120, 0.0, 30 / 120, -10 / 120),
        (26 / 120, -50 / 120, 20 / 120, 20 / 120, -20 / 120, 5 / 120),
        (1 / 120, -5 / 120, 10 / 120, -10 / 120, 5 / 120, -1 / 120),
    )
)

LEAST_COPIES = SamplingKernel(
    (
        (
            0.490979129551566,
            0.0,
            -0.347064777098669,
            -0.019787091029741,
            0.159510362655799,
            -0.048058483122064,
        ),
        (
            0.235579140956891,
            -0.355741792273685,
            0.064028928229083,
            0.166328901795269,
            -0.112887548767715,
            0.021623664327483,
        ),
        (
            0.018931294267326,
            -0.072129103863158,
            0.108609809008748,
            -0.079919985469405,
            0.02787048802857,
            -0.00336250197208,
        ),
    )
)
"""The least sum of squared copies over the squared band below 0.28 cycles per pixel, for scenes
and textures seen through Gaussian and diffraction-limited lenses at zooms of 1.2 to 3, among all
pieces that fit together so. A copy's amplitude over that of the band is 0.3 % at 0.35 cycles per
pixel, 3 % at 0.4 and 18 % at 0.45, where the spline leaves 2.4, 8.8 and 30 %. A wider band would
take a longer prefilter."""

SAMPLING_KERNELS: dict[PoseModel, SamplingKernel] = {
    "matched": QUINTIC_SPLINE,  # as in ``zoom_out``, whose follow-ups are the same
    "lmmse": LEAST_COPIES,
}


_ALIASES = 2
"""Orders of the sampled spectrum on either side; beyond, scene times pixel is below 1e-6."""

_COPIES = 1
"""Orders at which the sampling kernels pass a scene: beyond 1.5 cycles per pixel 1e-4 at most."""

_RIDGE = 1e-6
"""Least noise over the scene's variance, where the lens passes nothing: 0.05 DN for one of 50."""

_MATCHED_NOISE = 1e-3
"""White part of what a ``matched`` kernel is fitted for: it has to serve any image."""

_PIVOT = 1e-10
"""Added to the diagonal of the systems, whose largest element is about 1, against rounding."""

_SOLVED_RADIUS_MAX = 24
"""Systems of up to 1201 taps are solved, in 0.1 s; wider kernels end far out and are cut."""

Slopes = tuple[float, float, float, float]
"""Derivative of the warp: dx/du, dx/dv, dy/du, dy/dv, with (u, v) in the follow-up."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LocalPose:
    """What a prefilter is for: both PSFs, each in its own pixels, and the warp between them."""

    near: Psf
    far: Psf
    slopes: Slopes


@dataclass(frozen=True, slots=True, eq=False)
class _Prefilter:
    """Weights of the reference's pixels around a spline coefficient.

    ``kernel`` has the shape ``(2 radius + 1, 2 radius + 1)``, is symmetric about its centre and
    sums to 1. ``excess`` is the mean squared error that the infinite kernel would save, over the
    variance of the scene.
    """

    kernel: FloatArray
    excess: float


@dataclass(frozen=True, slots=True)
class _Source:
    """What the reference decides.

    ``near`` is its PSF, or None for pixels that show the scene up to the Nyquist frequency;
    ``noise`` their noise over the scene's variance.
    """

    near: Psf | None
    noise: float
    kernel: SamplingKernel


@dataclass(frozen=True, slots=True, eq=False)
class _Spectra:
    """A reference's spectra, on the half plane of frequencies ``fx >= 0``.

    ``power`` is that of its pixels times the squares of the sampling kernel. ``weighted`` is what
    the far camera's transfer multiplies, shape (orders, orders, rows, cols).
    """

    power: FloatArray
    weighted: FloatArray


@lru_cache(maxsize=4096)
def prefilter(pose: LocalPose, model: PoseModel, noise_ratio: float, radius: int) -> _Prefilter:
    """Kernel of half-width ``radius`` for a local warp; cached.

    ``"lmmse"`` is for the least mean squared error, ``"matched"`` for the ratio of the two transfer
    functions; ``noise_ratio`` is the variance of the reference's noise over that of the scene.

    References
    ----------
    Y. C. Eldar and M. Unser, "Nonideal sampling and interpolation from noisy observations in
    shift-invariant spaces", IEEE Trans. Signal Processing 54 (2006), section IV.
    """
    kernel = SAMPLING_KERNELS[model]
    if model == "lmmse":
        source = _Source(pose.near, max(noise_ratio, _RIDGE), kernel)
    else:
        source = _Source(None, _MATCHED_NOISE, kernel)
    period = _period(radius)
    fy, fx = _frequencies(period)
    spectra = _spectra(source, period)
    if source.near is None:
        passed = kernel.transfer_at_pixels(fy) * kernel.transfer_at_pixels(fx)
        target = _ratio(pose, fy, fx) / passed * spectra.power
    else:
        seen = _far_transfer(pose, *_orders(fy, fx, _COPIES))
        target = np.einsum("ijkl,ijkl->kl", spectra.weighted, seen)
    ideal = target / spectra.power
    if radius <= _SOLVED_RADIUS_MAX:
        taps = _solved(source, radius, np.fft.irfft2(target, (period, period)))
    else:
        taps = _cut(np.fft.irfft2(ideal, (period, period)), radius)
    taps = taps / taps.sum()
    taps.setflags(write=False)
    missed = np.abs(kernel_transfer(taps, period) - ideal) ** 2 * spectra.power
    # The columns inside the half plane stand for two frequencies each.
    excess = (2 * missed.sum() - missed[:, [0, -1]].sum()) / period**2
    return _Prefilter(taps, float(excess))


def kernel_transfer(kernel: FloatArray, period: int) -> FloatArray:
    """Transfer function of a symmetric kernel at the frequencies of ``rfft2`` over a period."""
    radius = len(kernel) // 2
    whole = np.zeros((period, period))
    whole[: len(kernel), : len(kernel)] = kernel
    return np.fft.rfft2(np.roll(whole, (-radius, -radius), axis=(0, 1))).real


def _period(radius: int) -> int:
    """Even; two taps of a solved kernel are never nearer to each other the other way round."""
    wanted = 4 * radius + 4 if radius <= _SOLVED_RADIUS_MAX else 5 * radius // 2
    return wanted + wanted % 2


def _frequencies(period: int) -> tuple[FloatArray, FloatArray]:
    """Frequencies of rows and columns, shapes (period, 1) and (1, period / 2 + 1)."""
    fy: FloatArray = np.fft.fftfreq(period).astype(np.float64)
    fx: FloatArray = np.fft.rfftfreq(period).astype(np.float64)
    return fy[:, None], fx[None, :]


def _orders(fy: FloatArray, fx: FloatArray, orders: int) -> tuple[FloatArray, FloatArray]:
    """Frequencies and their aliases, with two leading axes for the orders along y and x."""
    order = np.arange(-orders, orders + 1.0)
    return fy + order[:, None, None, None], fx + order[None, :, None, None]


def _far_transfer(pose: LocalPose, fy: FloatArray, fx: FloatArray) -> FloatArray:
    a, b, c, d = pose.slopes
    return pose.far.otf(a * fx + c * fy, b * fx + d * fy)


def _ratio(pose: LocalPose, fy: FloatArray, fx: FloatArray) -> FloatArray:
    """Transfer from the reference to the follow-up, never above 1: nothing is sharpened."""
    near, far = pose.near.otf(fx, fy), _far_transfer(pose, fy, fx)
    is_passed = np.abs(near) > np.abs(far)
    limit = np.where(np.signbit(near) == np.signbit(far), 1.0, -1.0)
    return np.where(is_passed, far / np.where(is_passed, near, 1.0), limit)


@lru_cache(maxsize=256)
def _spectra(source: _Source, period: int) -> _Spectra:
    fy, fx = _frequencies(period)
    kernel = source.kernel
    squares = _squares(kernel, fy) * _squares(kernel, fx)
    if source.near is None:
        return _Spectra((_scene(fy, fx) + source.noise) * squares, np.empty((0, 0, 0, 0)))
    y, x = _orders(fy, fx, _ALIASES)
    transfer, scene = source.near.otf(x, y), _scene(y, x)
    power = (transfer**2 * scene).sum(axis=(0, 1)) + source.noise
    inner = slice(_ALIASES - _COPIES, _ALIASES + _COPIES + 1)
    y, x = _orders(fy, fx, _COPIES)
    weighted = kernel.transfer(y) * kernel.transfer(x) * (transfer * scene)[inner, inner]
    return _Spectra(power * squares, weighted)


def _scene(fy: FloatArray, fx: FloatArray) -> FloatArray:
    """Spectrum of a first-order isotropic scene of variance 1."""
    length = 2 * pi * SCENE_CORRELATION_PX
    squares = fx * fx + fy * fy
    return np.asarray(length * SCENE_CORRELATION_PX / (1 + length**2 * squares) ** 1.5)


def _squares(kernel: SamplingKernel, freq: FloatArray) -> FloatArray:
    """Sum of a kernel's squared transfer over all its copies, those beyond 3 cy/px left out."""
    orders = np.arange(-3, 4.0)[:, None, None]
    return np.asarray((kernel.transfer(freq + orders) ** 2).sum(axis=0))


def _half_plane(radius: int) -> tuple[IntArray, IntArray]:
    """One of every two opposite taps, and the centre: offsets along y and x."""
    y, x = np.mgrid[-radius : radius + 1, -radius : radius + 1].reshape(2, -1)
    half = len(y) // 2 + 1
    return y[:half], x[:half]


@lru_cache(maxsize=64)
def _system(source: _Source, radius: int) -> tuple[FloatArray, bool]:
    """Cholesky factor of the normal equations of a symmetric kernel."""
    period = _period(radius)
    covariance = np.fft.irfft2(_spectra(source, period).power, (period, period))
    y, x = _half_plane(radius)
    matrix = covariance[y[:, None] - y, x[:, None] - x] + covariance[y[:, None] + y, x[:, None] + x]
    matrix[np.diag_indices_from(matrix)] += _PIVOT
    return cho_factor(matrix, lower=True, overwrite_a=True, check_finite=False)


def _solved(source: _Source, radius: int, wanted: FloatArray) -> FloatArray:
    """Kernel of the least error ``g' M g - 2 b' g`` among those of a radius."""
    y, x = _half_plane(radius)
    half = cho_solve(_system(source, radius), wanted[y, x], check_finite=False)
    # The centre is its own opposite and stands twice in the system.
    half[-1] *= 2
    return np.concatenate([half, half[-2::-1]]).reshape(2 * radius + 1, -1)


def _cut(kernel: FloatArray, radius: int) -> FloatArray:
    """Middle of a periodic kernel; half weight on its rim, where alternate signs meet the cut."""
    taps = np.arange(-radius, radius + 1)
    kept = kernel[np.ix_(taps, taps)]
    kept[[0, -1], :] *= 0.5
    kept[:, [0, -1]] *= 0.5
    return kept
