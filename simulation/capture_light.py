"""Effects of a camera on an image beyond the paper's model: light, vignetting, sharpening."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from simulation.arrays import FloatImage


def exposed(image_dn: FloatImage, factor: float, black_level_dn: float = 0.0) -> FloatImage:
    """Image with ``factor`` times the light; levels are not clipped.

    Raises
    ------
    ValueError
        If ``factor`` is negative or not finite.
    """
    if not (factor >= 0 and np.isfinite(factor)):
        raise ValueError(f"an exposure factor must be finite and not negative, got {factor}")
    return _like(image_dn, (image_dn - black_level_dn) * factor + black_level_dn)


def vignetted(
    image_dn: FloatImage, corner_fall_off: float, black_level_dn: float = 0.0
) -> FloatImage:
    """Image with the natural vignetting of a lens.

    Parameters
    ----------
    image_dn
        Shape ``(rows, cols)`` or ``(rows, cols, channels)``.
    corner_fall_off
        Relative loss of light at the corner pixel, from 0 to below 1; towards the centre it
        follows the fourth power of the cosine of the field angle.
    black_level_dn
        Level without light.

    Raises
    ------
    ValueError
        If ``corner_fall_off`` is outside [0, 1).
    """
    if not 0 <= corner_fall_off < 1:
        raise ValueError(f"a corner fall-off must be in [0, 1), got {corner_fall_off}")
    rows, cols = image_dn.shape[:2]
    y = (np.arange(rows) - (rows - 1) / 2)[:, None]
    x = np.arange(cols) - (cols - 1) / 2
    corner2 = ((rows - 1) / 2) ** 2 + ((cols - 1) / 2) ** 2
    # cos^4 = (1 + tan^2)^-2, with tan^2 growing as the square of the radius.
    tan2_at_corner = (1 - corner_fall_off) ** -0.5 - 1
    light = (1 + tan2_at_corner * (x**2 + y**2) / max(corner2, 1.0)) ** -2
    if image_dn.ndim == 3:
        light = light[:, :, None]
    return _like(image_dn, (image_dn - black_level_dn) * light + black_level_dn)


def unsharp_masked(image_dn: FloatImage, amount: float, sigma_px: float) -> FloatImage:
    """Image after a camera's sharpening: plus ``amount`` times (image minus its blur).

    Parameters
    ----------
    image_dn
        Shape ``(rows, cols)`` or ``(rows, cols, channels)``.
    amount
        At least 0; phones use 0.3 to 1.5.
    sigma_px
        Width of the blur, positive.

    Raises
    ------
    ValueError
        If ``amount`` is negative, ``sigma_px`` not positive, or either is not finite.
    """
    if not (amount >= 0 and np.isfinite(amount)):
        raise ValueError(f"the sharpening amount must be finite and not negative, got {amount}")
    if not (sigma_px > 0 and np.isfinite(sigma_px)):
        raise ValueError(f"sigma_px must be positive, got {sigma_px}")
    widths = (sigma_px, sigma_px, 0.0)[: image_dn.ndim]
    blurred = gaussian_filter(np.asarray(image_dn, dtype=np.float64), widths, mode="reflect")
    return _like(image_dn, image_dn + amount * (image_dn - blurred))


def _like(image_dn: FloatImage, values: NDArray[np.floating]) -> FloatImage:
    return values.astype(image_dn.dtype, copy=False)
