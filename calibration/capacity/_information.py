"""Shannon's information capacity of a camera, in bits a pixel.

A photograph is a channel with noise. Of a real signal each frequency and its negative are one, and
so the capacity is half of the integral over both, ``C = 1/2 integral log2(1 + S(f) / N(f))``, with
the signal power S and the noise power N; a pixel whose S / N is 3 at all frequencies carries 1 bit.
A signal that takes all levels of a range V equally often has the variance ``V^2 / 12``; spread
evenly over the band of the sampling it has ``S(f) = V^2 H(f)^2 / 12`` behind the transfer H of lens
and pixel.

References
----------
Shannon, "Communication in the presence of noise", Proc. IRE 37, 1949, 10. Koren, "Measuring camera
Shannon information capacity with a Siemens star image", Electronic Imaging, 2020, and "Image
information metrics from slanted edges", Electronic Imaging, 2024, for the method by edges.
"""

from collections.abc import Callable
from math import inf, pi

import numpy as np

from calibration.capacity._quanta import SignalAndNoise
from simulation.arrays import FloatArray

_NYQUIST = 0.5
_NODES = 48  # of Gauss and Legendre, from 0 to Nyquist


def information_bits_per_px(camera: SignalAndNoise, range_dn: float) -> float:
    """Return the capacity by the transfer and the noise power over all frequencies.

    Parameters
    ----------
    camera
        Transfer and noise; its signal does not matter.
    range_dn
        Levels from the darkest to the brightest, in DN.

    Returns
    -------
    float
        Bits a pixel, over the square of frequencies that the sampling passes.
    """
    _refuse_range(range_dn)
    freq, weight = _nodes()  # fy above 0 alone is the half of the plane
    fx = np.concatenate([-freq[::-1], freq])[None, :]
    weights = weight[:, None] * np.concatenate([weight[::-1], weight])
    power = range_dn**2 / 12 * np.asarray(camera.transfer(fx, freq[:, None])) ** 2
    bits = np.log2(1 + power / camera.noise.variance_dn2)
    return float(np.sum(weights * bits))


def edge_information_bits_per_px(
    mtf: Callable[[FloatArray], FloatArray], range_dn: float, noise_dn: float
) -> float:
    """Return the capacity by a single edge, as in Koren's method for slanted edges.

    The edge gives the MTF, the range between its levels and, by the scatter of the pixels beside
    and across it, the noise, taken as white. A lens that is round passes
    ``pi integral log2(1 + V^2 MTF^2 / (12 N)) f df`` from 0 to 0.5 cy/px: a disc, 0.785 of the
    square of frequencies that the sampling passes.

    Parameters
    ----------
    mtf
        Contrast at frequencies across the edge in cy/px, shape ``(n,)``.
    range_dn
        Difference of the edge's levels.
    noise_dn
        Standard deviation of a pixel's noise, its mean square over the edge.

    Returns
    -------
    float
        Bits a pixel.
    """
    _refuse_range(range_dn)
    if not 0 < noise_dn < inf:
        raise ValueError(f"noise_dn must be positive, got {noise_dn}")
    freq, weight = _nodes()
    ratio = (range_dn * np.asarray(mtf(freq)) / noise_dn) ** 2 / 12
    return pi * float(np.sum(weight * freq * np.log2(1 + ratio)))


def _nodes() -> tuple[FloatArray, FloatArray]:
    node, weight = np.polynomial.legendre.leggauss(_NODES)
    return 0.5 * _NYQUIST * (node + 1), 0.5 * _NYQUIST * weight


def _refuse_range(range_dn: float) -> None:
    if not 0 < range_dn < inf:
        raise ValueError(f"range_dn must be positive, got {range_dn}")
