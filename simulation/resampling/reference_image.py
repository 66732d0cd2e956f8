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
    if image.dtype.kind != "f":
        return
    if image.flags.c_contiguous:
        # One pass at memory speed; huge values may overflow, and are looked at again.
        flat = image.reshape(-1)
        with np.errstate(over="ignore", invalid="ignore"):
            if np.isfinite(np.dot(flat, flat)):
                return
    # The extremes are NaN or infinite if any value is.
    if not (np.isfinite(image.min()) and np.isfinite(image.max())):
        raise ValueError("the image has NaN or infinite values")
