"""The names of methods, channels and patterns to choose from; imports no other library."""

from typing import Literal

from acquisition.choices import PATTERNS as PATTERNS, Channel as Channel, Pattern as Pattern

CalibrationMethod = Literal["all-angles", "paper", "single-image", "two-distance"]

TargetChoice = Literal["auto", "all"]
"""Whether edges of the scene beside a target are told from its own, or all edges count."""

DEFAULT_BOARD_TEXT = "11x8:12:9:4X4_50"
"""The default ChArUco board, in the form that ``CharucoBoard.from_text`` reads."""
