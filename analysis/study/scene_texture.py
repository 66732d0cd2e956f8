"""Scenes of a study without photographs: overlapping discs, which have the statistics of nature.

Discs of all sizes that hide each other (the dead leaves model) have edges, an amplitude spectrum
that falls about as 1/f, and areas of much and of little detail, as photographs do.

References
----------
Lee, Mumford, Huang, "Occlusion models for natural images", Int. J. Computer Vision 41, 2001:
radii by the inverse cube.
"""

import numpy as np

from simulation.arrays import FloatArray
from simulation.psf import GaussianPsf

BUILT_IN = "overlapping discs with radii by the inverse cube, 16 pictures of 192 px, seeded"

_PICTURES = 16
_SIDE_PX = 192
_OVERSAMPLING = 2
_RADII_PX = (1.0, 80.0)
_DISCS = 1500
_SEED = 20010101


def built_in_scenes(low_dn: float, high_dn: float, psf: GaussianPsf) -> tuple[FloatArray, ...]:
    """Return the pictures, seen through a PSF.

    ``low_dn, high_dn``: levels of black and white paper; the discs are evenly between them.
    """
    transfer = _transfer(_SIDE_PX * _OVERSAMPLING, psf)
    return tuple(
        low_dn + (high_dn - low_dn) * _seen(_discs(np.random.default_rng([_SEED, n])), transfer)
        for n in range(_PICTURES)
    )


def _discs(rng: np.random.Generator) -> FloatArray:
    """Reflectances from 0 to 1, on the finer grid."""
    side = _SIDE_PX * _OVERSAMPLING
    picture = np.full((side, side), 0.5)
    least, most = (radius**-2.0 for radius in _RADII_PX)
    radii = _OVERSAMPLING * (most + (least - most) * rng.random(_DISCS)) ** -0.5
    places = rng.uniform(0, side, (_DISCS, 2))
    greys = rng.random(_DISCS)
    for radius, (row, col), grey in zip(
        radii.tolist(), places.tolist(), greys.tolist(), strict=True
    ):
        top, left = max(int(row - radius), 0), max(int(col - radius), 0)
        part = picture[top : int(row + radius) + 2, left : int(col + radius) + 2]
        y, x = np.ogrid[: part.shape[0], : part.shape[1]]
        part[(y + top - row) ** 2 + (x + left - col) ** 2 < radius**2] = grey
    return picture


def _transfer(side: int, psf: GaussianPsf) -> FloatArray:
    """Transfer at the frequencies of the finer grid."""
    fy = np.fft.fftfreq(side)[:, None] * _OVERSAMPLING
    fx = np.fft.rfftfreq(side) * _OVERSAMPLING
    (xx, xy), (_, yy) = psf.covariance_px2.tolist()
    power = xx * fx**2 + 2 * xy * fx * fy + yy * fy**2
    return np.asarray(np.exp(-2 * np.pi**2 * power))


def _seen(picture: FloatArray, transfer: FloatArray) -> FloatArray:
    blurred = np.fft.irfft2(np.fft.rfft2(picture) * transfer, picture.shape)
    return np.asarray(blurred[::_OVERSAMPLING, ::_OVERSAMPLING])
