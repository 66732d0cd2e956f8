"""The names of methods, channels and patterns to choose from; imports no other library."""

from typing import Literal, get_args

CalibrationMethod = Literal["all-angles", "paper", "single-image", "two-distance"]

TargetChoice = Literal["auto", "all"]
"""Whether edges of the scene beside a target are told from its own, or all edges count."""

Channel = Literal["luma", "red", "green", "blue"]

Pattern = Literal["RGGB", "GRBG", "GBRG", "BGGR"]
PATTERNS: tuple[Pattern, ...] = get_args(Pattern)
"""Colours of the first two pixels of the first row, then of the second row (as GenICam, EMVA)."""

DEFAULT_BOARD_TEXT = "11x8:12:9:4X4_50"
"""The default ChArUco board, in the form that ``CharucoBoard.from_text`` reads."""
