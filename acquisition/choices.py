"""Names and bounds that callers of this package choose from; imports no library."""

from typing import Literal, get_args

CaptureKind = Literal["edge", "texture", "chart", "board", "flat", "dark"]

FocusMeasure = Literal["squared-gradient", "tenengrad", "brenner", "laplacian"]

StageAction = Literal["status", "home", "move", "stop", "unlock"]

FEWEST_POSITIONS = 7
"""Fewest positions of a focus sweep: its curve has five parameters, two more test the fit."""

Channel = Literal["luma", "red", "green", "blue"]

Pattern = Literal["RGGB", "GRBG", "GBRG", "BGGR"]
PATTERNS: tuple[Pattern, ...] = get_args(Pattern)
"""Colours of the first two pixels of the first row, then of the second row (as GenICam, EMVA)."""
