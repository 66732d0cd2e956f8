"""Colours of all figures, which the colour-blind tell apart as well; imports no library.

M. Okabe, K. Ito, "Color Universal Design: how to make figures and presentations that are friendly
to colorblind people", 2008.
"""

BLUE, VERMILION, GREEN = "#0072B2", "#D55E00", "#009E73"
PURPLE, ORANGE, SKY_BLUE, YELLOW = "#CC79A7", "#E69F00", "#56B4E9", "#F0E442"
PALETTE = (BLUE, VERMILION, GREEN, PURPLE, ORANGE, SKY_BLUE)
"""In the order in which curves take them."""

INK = "#1b1f24"
"""Of axes, text and what is fitted."""

POINTS = "#8b95a1"
"""Of points that many lie over each other."""
