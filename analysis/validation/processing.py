"""What the paper does to two aligned images before it compares them, step by step."""

import numpy as np
from scipy.ndimage import gaussian_filter

from simulation.arrays import AnyArray, FloatArray

BACKGROUND_SIGMA_PX = 10.0
"""Width of the Gaussian that is subtracted, from the paper."""

FULL_SCALE_DN = 255.0
"""Levels run from 0 to this after ``normalise``, from the paper."""


def process_for_comparison(image: AnyArray) -> FloatArray:
    """Processed image of the paper: normalised, background subtracted, centre half.

    ``image``: shape ``(rows, cols)``, the area that both images cover. Returns levels around 0;
    full scale is 255.
    """
    return crop_centre_half(subtract_background(normalise(image)))


def normalise(image: AnyArray) -> FloatArray:
    """Image stretched to [0, 255]: its own minimum to 0, its own maximum to 255.

    The extremes are those of the array handed in. Images that are compared must therefore be cut to
    the area both cover first.
    """
    values = np.asarray(image, dtype=np.float64)
    if values.size == 0 or not np.isfinite(values).all():
        raise ValueError("only finite pixels can be normalised")
    low, high = values.min(), values.max()
    if low == high:
        raise ValueError(f"a constant image ({low}) cannot be normalised")
    return np.asarray((values - low) * (FULL_SCALE_DN / (high - low)))


def subtract_background(image: AnyArray, sigma_px: float = BACKGROUND_SIGMA_PX) -> FloatArray:
    """Image minus its own blur by a Gaussian of ``sigma_px``, mirrored at the border."""
    values = np.asarray(image, dtype=np.float64)
    return np.asarray(values - gaussian_filter(values, sigma_px, mode="reflect"))


def crop_centre_half(image: FloatArray) -> FloatArray:
    """Middle half of each axis, shape ``(rows // 2, cols // 2)``.

    The PSF is that of the image centre, and the borders carry the marks of filtering.
    """
    rows, cols = image.shape
    top, left = rows // 4, cols // 4
    return image[top : top + rows // 2, left : left + cols // 2]
