"""What a caller of this package may choose from: names and bounds, without any library."""

from typing import Literal

CaptureKind = Literal["edge", "texture", "chart", "board", "flat", "dark"]

FocusMeasure = Literal["squared-gradient", "tenengrad", "brenner", "laplacian"]

FEWEST_POSITIONS = 7
"""Of a focus sweep: its curve has five parameters, and two positions more judge it."""
