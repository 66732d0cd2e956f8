"""What every model requires of a reference image."""

import numpy as np

from simulation.arrays import AnyArray


def reference_shape(image: AnyArray) -> tuple[int, int]:
    """Return rows and columns of an image that a model accepts.

    Raises
    ------
    ValueError
        If it is not ``(rows, cols)`` or ``(rows, cols, channels)``, is empty, or is not uint8,
        uint16, float32 or float64.
    """
    if image.ndim not in (2, 3) or image.size == 0:
        raise ValueError(
            f"an image must be (rows, cols) or (rows, cols, channels), got {image.shape}"
        )
    if image.dtype.type not in (np.uint8, np.uint16, np.float32, np.float64):
        raise ValueError(f"an image must be uint8, uint16, float32 or float64, got {image.dtype}")
    return image.shape[0], image.shape[1]


def refuse_non_finite(image: AnyArray) -> None:
    """Raise ``ValueError`` if a value is NaN or infinite."""
    # The extremes are NaN or infinite if any value is, and are found at memory speed.
    if image.dtype.kind == "f" and not (np.isfinite(image.min()) and np.isfinite(image.max())):
        raise ValueError("the image has NaN or infinite values")
