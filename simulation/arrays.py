"""Names of the array types that functions take and return; docstrings give the shapes."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
Float32Array = NDArray[np.float32]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

FloatImage = NDArray[np.floating[Any]]
"""Levels in float32 or float64, as in the input image."""

AnyArray = NDArray[np.generic]
"""Pixels of any type, not yet checked."""
