"""Cameras whose optics are known: transfer functions, and photographs of straight edges.

Written from the physics alone and shares nothing with ``simulation``: it judges the capture model.
Verified against GalSim's optics and pyBSM's in ``tests/benchmarks``.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from math import cos, inf, pi, radians, sin

import numpy as np
from scipy.interpolate import CubicSpline

from simulation.arrays import FloatArray

Transfer = Callable[[FloatArray, FloatArray], FloatArray]
"""Of frequencies fx and fy in cycles per reference pixel; they broadcast."""

PIXEL_PITCH_UM = 8.3
WAVELENGTH_UM = 0.55

ROUND = ((1.0, 0.0), (0.0, 1.0))

_TABLE_STEPS = 4001
_PUPIL_NODES = 300
"""Gauss-Legendre nodes over the common part of the pupils: 1e-12 for the defocus used here."""

_EDGE_PERIOD_PX = 8192
"""Edges are those of a bar half as wide: what its other edge adds to diffraction's halo is 1e-5."""

_EDGE_STEPS_PER_PX = 64


@dataclass(frozen=True, slots=True, kw_only=True)
class Camera:
    """A lens before square pixels, or without a pixel a Gaussian in place of both.

    Without a pupil the cut-off is infinite; the defocus is at the pupil's rim, the Gaussian comes
    on top. The lens passes at ``f`` what the round one passes at ``stretch f``: an astigmatic lens.
    """

    name: str
    cut_off_cy_per_px: float = inf
    defocus_waves: float = 0.0
    sigma_px: float = 0.0
    stretch: tuple[tuple[float, float], tuple[float, float]] = ROUND
    has_pixel: bool = True

    def otf(self, fx_cy_per_px: FloatArray, fy_cy_per_px: FloatArray) -> FloatArray:
        """Total transfer function, real and signed; the two broadcast."""
        u, v = fx_cy_per_px, fy_cy_per_px
        if self.stretch != ROUND:  # keeps one-dimensional frequencies so
            (xx, xy), (yx, yy) = self.stretch
            u, v = xx * u + xy * v, yx * u + yy * v
        square = u * u + v * v
        made = np.exp(-2 * pi**2 * self.sigma_px**2 * square)
        if self.cut_off_cy_per_px < inf:
            table = _pupil_table(self.defocus_waves)
            steps = np.linspace(0.0, 1.0, _TABLE_STEPS)
            # The curve is smooth in the root of the distance from the cut-off.
            inside = np.sqrt(np.maximum(1 - np.sqrt(square) / self.cut_off_cy_per_px, 0.0))
            made = made * np.interp(inside, steps, table)
        if self.has_pixel:
            made = made * np.sinc(fx_cy_per_px) * np.sinc(fy_cy_per_px)
        return np.asarray(made)


def f_number(number: float, defocus_waves: float = 0.0) -> Camera:
    """Camera with a perfect lens of this f-number at 550 nm, pixels of 8.3 um."""
    name = f"f/{number:g}" + (f" + {defocus_waves:g} wave" if defocus_waves else "")
    cut_off = PIXEL_PITCH_UM / (WAVELENGTH_UM * number)
    return Camera(name=name, cut_off_cy_per_px=cut_off, defocus_waves=defocus_waves)


def astigmatic(number: float, ratio: float, axis_deg: float) -> Camera:
    """Camera whose lens blurs ``ratio`` times as much along ``axis_deg`` as ``f_number``'s."""
    c, s = cos(radians(axis_deg)), sin(radians(axis_deg))
    excess = ratio - 1
    return Camera(
        name=f"f/{number:g} x {ratio:g} at {axis_deg:g} deg",
        cut_off_cy_per_px=PIXEL_PITCH_UM / (WAVELENGTH_UM * number),
        stretch=((1 + excess * c * c, excess * c * s), (excess * c * s, 1 + excess * s * s)),
    )


def gaussian(sigma_px: float, *, has_pixel: bool) -> Camera:
    """Camera with a Gaussian PSF, before square pixels or in all."""
    over = " over pixels" if has_pixel else ""
    return Camera(name=f"Gaussian {sigma_px:g}{over}", sigma_px=sigma_px, has_pixel=has_pixel)


def further(camera: Camera, zoom: float) -> Transfer:
    """Transfer function of a camera ``zoom`` times as far, in cycles per reference pixel."""
    return lambda fx, fy: camera.otf(zoom * fx, zoom * fy)


def elsewhere(camera: Camera, jacobian: FloatArray) -> Transfer:
    """Transfer function ``H(A^T f)`` of a camera at another pose, in cycles per reference pixel.

    ``jacobian`` is A, shape (2, 2), order (x, y): reference pixels by follow-up pixel.
    """
    (xx, xy), (yx, yy) = jacobian.tolist()
    return lambda fx, fy: camera.otf(xx * fx + yx * fy, xy * fx + yy * fy)


def defocused_pupil_otf(relative_freq: FloatArray, defocus_waves: float) -> FloatArray:
    """Autocorrelation of a circular pupil with a quadratic phase, by quadrature.

    Two unit circles with centres ``2 s`` apart have in common, at the distance ``x`` from the line
    midway between them, a chord of ``2 sqrt(1 - (|x| + s)^2)``, along which the path difference is
    ``4 s x`` times the defocus at the rim. Frequencies are relative to the cut-off, 0 to 1.

    H. H. Hopkins, "The frequency response of a defocused optical system", Proc. R. Soc. A 231
    (1955), 91-103, equation (10).
    """
    s = np.asarray(relative_freq, dtype=np.float64)[..., None]
    nodes, weights = np.polynomial.legendre.leggauss(_PUPIL_NODES)
    t = (nodes + 1) / 2
    x = (1 - s) * (1 - t * t)  # takes the square root's end at x = 1 - s away
    chord = np.sqrt(np.maximum(1 - (x + s) ** 2, 0.0))
    integrand = chord * np.cos(8 * pi * defocus_waves * s * x) * 2 * t * (1 - s)
    return np.asarray(4 / pi * (integrand @ (weights / 2)))


@lru_cache(maxsize=32)
def _pupil_table(defocus_waves: float) -> FloatArray:
    root = np.linspace(0.0, 1.0, _TABLE_STEPS)
    return defocused_pupil_otf(1 - root * root, defocus_waves)


def edge_response(camera: Camera, normal_deg: float, distance_px: FloatArray) -> FloatArray:
    """Level 0 to 1 across an endless straight edge, at distances along its normal.

    The projection-slice theorem: ``E(d) = 1/2 + integral of H(f n) sin(2 pi f d) / (pi f) df``,
    as the Fourier series of a bar of half a period.
    """
    n_x, n_y = cos(radians(normal_deg)), sin(radians(normal_deg))
    size = _EDGE_PERIOD_PX * _EDGE_STEPS_PER_PX
    order = np.arange(size // 2 + 1)
    freq = order / _EDGE_PERIOD_PX
    series = np.zeros(len(order), dtype=np.complex128)
    odd = order % 2 == 1
    series[odd] = -1j * size / (pi * order[odd]) * camera.otf(freq[odd] * n_x, freq[odd] * n_y)
    series[0] = size / 2
    reach = int(np.ceil(np.abs(distance_px).max() + 1)) * _EDGE_STEPS_PER_PX
    steps = np.arange(-reach, reach + 1)
    profile = np.fft.irfft(series, size)[steps % size]
    return np.asarray(CubicSpline(steps / _EDGE_STEPS_PER_PX, profile)(distance_px))


def edge_photographs(
    camera: Camera, angles_deg: Sequence[float], side_px: int, snr: float, seed: int
) -> list[FloatArray]:
    """Photographs of one straight edge each, 60 to 180 DN, through nearly the middle.

    Angles are of the edges' normals against +x, y down; the SNR is the step over the noise.
    """
    rng = np.random.default_rng(seed)
    row, col = np.mgrid[:side_px, :side_px] - (side_px - 1) / 2
    photographs = []
    for angle_deg in angles_deg:
        angle = radians(angle_deg)
        distance = cos(angle) * col + sin(angle) * row - rng.uniform(-2, 2)
        level = 60 + 120 * edge_response(camera, angle_deg, distance)
        photographs.append(level + rng.normal(0, 120 / snr, level.shape))
    return photographs
