"""Pictures that scikit-image ships: nobody here drew them."""

import numpy as np
from skimage import data

from simulation.arrays import FloatArray


def shipped(name: str) -> FloatArray:
    """Levels of one of them, from 0 to 255 or 0 to 1, shape ``(rows, cols)`` or with 3 colours."""
    return np.asarray(getattr(data, name)(), dtype=np.float64)
