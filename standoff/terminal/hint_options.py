"""Options by which an operator says what is known of a pose, for ``changes`` and ``pose``."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from standoff.terminal.option_rules import excludes

ExpectZoom = Annotated[
    float | None,
    typer.Option(
        min=0.05,
        max=20,
        metavar="Z",
        help="Approximate ratio of the distances, follow-up over reference; below 1 if the "
        "follow-up is nearer.",
    ),
]
PoseHint = Annotated[
    Path | None,
    typer.Option(
        "--homography",
        metavar="H.json",
        help="Approximate pose, follow-up to reference pixels; it is refined.",
    ),
]
Points = Annotated[
    Path | None,
    typer.Option(
        metavar="P.csv",
        help="At least four pairs of points, good to a few pixels, with the header "
        "followup_x_px,followup_y_px,reference_x_px,reference_y_px.",
    ),
]
Mask = Annotated[
    Path | None,
    typer.Option(
        metavar="M.png",
        help="Image of the follow-up's size; pixels that are not 0 are left out.",
    ),
]

_ENOUGH = "each says what the pose is about"
HINT_RULES = (
    excludes("expect_zoom", "homography", "points", because=_ENOUGH),
    excludes("homography", "points", because=_ENOUGH),
)
"""Rules for a command with the parameters ``expect_zoom``, ``homography`` and ``points``."""
