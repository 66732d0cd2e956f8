"""Second derivatives of an image: what it changes by where the focus of a photograph is off.

A PSF whose covariance grows by ``D`` turns a level I into ``I + (D : grad grad I) / 2``, to first
order. The derivatives are those of the cosine series through the pixels, mirrored at the edges, so
that they are exact for every frequency that the pixels hold.
"""

import numpy as np
from scipy.fft import dct, idct, idst

from simulation.arrays import FloatArray


def second_derivatives(image: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the derivatives xx, xy and yy per px^2, each of the shape of ``image``."""
    return (
        _twice(image, 1),
        _once(_once(image, 1), 0),
        _twice(image, 0),
    )


def _orders(image: FloatArray, axis: int) -> FloatArray:
    count = image.shape[axis]
    shape = [1] * image.ndim
    shape[axis] = count
    return np.asarray(np.pi * np.arange(count) / count).reshape(shape)


def _twice(image: FloatArray, axis: int) -> FloatArray:
    waves = dct(image, axis=axis, norm="ortho")
    return np.asarray(idct(-(_orders(image, axis) ** 2) * waves, axis=axis, norm="ortho"))


def _once(image: FloatArray, axis: int) -> FloatArray:
    """First derivative; of a series of cosines, it is one of sines."""
    waves = -_orders(image, axis) * dct(image, axis=axis, norm="ortho")
    # Sine number k of the inverse is the wave number k + 1, and the last one is none of these.
    waves = np.roll(waves, -1, axis=axis)
    last = [slice(None)] * image.ndim
    last[axis] = slice(-1, None)
    waves[tuple(last)] = 0.0
    return np.asarray(idst(waves, axis=axis, norm="ortho"))
