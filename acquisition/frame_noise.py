"""Temporal noise of frames that nobody averaged, from two of them."""

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

__all__ = ["variance_between"]

Levels = NDArray[np.integer[Any] | np.floating[Any]]


def variance_between(first_dn: Levels, second_dn: Levels, black_level_dn: float) -> float:
    """Temporal variance of one frame, in DN^2, averaged over the pixels of two frames.

    The light of the second frame is scaled to that of the first, so that flicker does not count.
    What moved between the frames does: over several pairs, the smallest value is the noise.

    Parameters
    ----------
    first_dn, second_dn
        Frames of the same shape ``(rows, cols)``, of the same scene.

    Raises
    ------
    ValueError
        If the shapes differ.
    """
    if first_dn.shape != second_dn.shape:
        raise ValueError(f"frames of {first_dn.shape} and {second_dn.shape}")
    pixels = first_dn.size
    means = cv2.mean(first_dn)[0], cv2.mean(second_dn)[0]
    # Sums of squares above black, without copies of the frames.
    first, second = (
        cv2.norm(frame, cv2.NORM_L2SQR) - pixels * black_level_dn * (2 * mean - black_level_dn)
        for frame, mean in zip((first_dn, second_dn), means, strict=True)
    )
    apart = cv2.norm(first_dn, second_dn, cv2.NORM_L2SQR)
    light = (means[0] - black_level_dn, means[1] - black_level_dn)
    scale = light[0] / light[1] if min(light) > 0 else 1.0
    product = 0.5 * (first + second - apart)
    left = first + scale**2 * second - 2 * scale * product
    return max(left / pixels / (1.0 + scale**2), 0.0)
