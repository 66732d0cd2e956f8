"""What a page may send about the pose: its reference, the curve and the threshold."""

from typing import Annotated, Literal

from pydantic import Field

from standoff.console.web.messages.fields import Index, Name, PageMessage

MOST_DPRIME = 1000.0
"""Two photographs differ by no such d' in any pixel that is not saturated."""


class PoseReference(PageMessage):
    """Compare the pose with a capture, or with the current picture if none is named."""

    do: Literal["pose-reference"]
    session: Name | None = None
    index: Index | None = None


class PoseClear(PageMessage):
    """Forget the reference."""

    do: Literal["pose-clear"]


class ChoosePoseCurve(PageMessage):
    """Judge the pose by a curve of a file, by its number; by none if no file is named."""

    do: Literal["pose-curve"]
    file: Annotated[str, Field(max_length=1000)]
    curve: Index | None = None


class SetPoseThreshold(PageMessage):
    """Demand another d' of a pose that is good enough."""

    do: Literal["pose-threshold"]
    min_dprime: Annotated[float, Field(gt=0, le=MOST_DPRIME, allow_inf_nan=False)]
