"""A simulated follow-up with what a camera adds to it: light, noise, sharpening, in this order."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from simulation import GaussianPsf, Model, SamplingGrid, zoom_operator
from simulation.capture_noise import CaptureNoise, propagated_variance, with_capture_noise
from simulation.capture_options import exposed, unsharp_masked, vignetted
from simulation.zoom import FloatImage

__all__ = ["CaptureOptions", "captured", "own_variance"]


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureOptions:
    """What the follow-up's camera does beyond the capture model.

    ``exposure`` is times the light of the reference, ``vignetting`` the relative loss of light
    at the corner, ``sharpening`` an amount and a width in px, ``noise`` that of a capture.
    """

    exposure: float = 1.0
    vignetting: float = 0.0
    sharpening: tuple[float, float] | None = None
    noise: CaptureNoise | None = None
    seed: int = 0


def captured(
    followup: FloatImage, options: CaptureOptions, own_variance_dn2: NDArray[np.float64] | None
) -> FloatImage:
    """Follow-up as the camera delivers it.

    Parameters
    ----------
    followup
        The simulated image, shape ``(rows, cols)`` or ``(rows, cols, channels)``.
    options
        What the camera does.
    own_variance_dn2
        Noise that the reference left in it, same shape; needed where noise is asked for.

    Raises
    ------
    ValueError
        If an option is out of its range.
    """
    black_dn = options.noise.black_level_dn if options.noise else 0.0
    image = _lit(followup, options, black_dn)
    if options.noise is not None and own_variance_dn2 is not None:
        light = _lit(np.ones_like(own_variance_dn2), options, 0.0)
        rng = np.random.default_rng(options.seed)
        image = with_capture_noise(image, light**2 * own_variance_dn2, options.noise, rng)
    if options.sharpening is not None:
        image = unsharp_masked(image, *options.sharpening)
    return image


def own_variance(
    reference: NDArray[np.generic],
    zoom: float,
    psf: GaussianPsf | None,
    model: Model,
    noise: CaptureNoise,
) -> NDArray[np.float64]:
    """Variance that the reference's noise leaves in its follow-up; it is taken to have ``noise``.

    Returns
    -------
    ndarray of float64, shape of the follow-up
    """
    shape = reference.shape[0], reference.shape[1]
    operator = zoom_operator(shape, SamplingGrid.centred(shape, zoom), psf, model)
    variance = noise.variance_dn2(reference.astype(np.float64))
    if variance.ndim == 2:
        return propagated_variance(operator, variance)
    planes = [propagated_variance(operator, variance[:, :, k]) for k in range(variance.shape[2])]
    return np.stack(planes, axis=-1)


def _lit(image: FloatImage, options: CaptureOptions, black_dn: float) -> FloatImage:
    if options.exposure != 1.0:
        image = exposed(image, options.exposure, black_dn)
    if options.vignetting != 0.0:
        image = vignetted(image, options.vignetting, black_dn)
    return image
