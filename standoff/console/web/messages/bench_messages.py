"""What a page may send about the camera, the live picture and the stage."""

from typing import Annotated, Literal

from pydantic import Field

from acquisition.choices import FocusMeasure
from standoff.console.web.messages.fields import Coordinate, Finite, PageMessage, Pixels, Positive


class SetExposure(PageMessage):
    """Set the exposure of the live picture; one above 2 s only where that is said to be wanted."""

    do: Literal["exposure"]
    exposure_us: Positive
    is_long_wanted: bool = False


class BreakOff(PageMessage):
    """Break a long exposure off, and go back to the shorter one of before."""

    do: Literal["break-off"]


class SetGain(PageMessage):
    """Set the gain."""

    do: Literal["gain"]
    gain_db: Annotated[float, Field(ge=0, le=100, allow_inf_nan=False)]


class AutoExposure(PageMessage):
    """Find the exposure for what the camera sees, once."""

    do: Literal["auto-exposure"]


class TakeSnapshot(PageMessage):
    """Store the newest frame, or the mean of several, as a TIFF file."""

    do: Literal["snapshot"]
    frames: Literal[1, 10]


class Probe(PageMessage):
    """Read the level of a pixel; anybody may."""

    do: Literal["probe"]
    x: Pixels
    y: Pixels


class Profile(PageMessage):
    """Read the levels along a line; ends are x and y, with pixel centres at integers."""

    do: Literal["profile"]
    start: tuple[Coordinate, Coordinate]
    end: tuple[Coordinate, Coordinate]


class LookAt(PageMessage):
    """Measure the focus in a region, or in the whole frame if it is null."""

    do: Literal["region"]
    region: tuple[Pixels, Pixels, Pixels, Pixels] | None


class FocusMetric(PageMessage):
    """Choose another focus measure."""

    do: Literal["metric"]
    metric: FocusMeasure


class ForgetPeak(PageMessage):
    """Restart the focus trace."""

    do: Literal["forget-peak"]


class WatchField(PageMessage):
    """Measure the four regions near the corners, or stop it."""

    do: Literal["watch-field"]
    is_on: bool


class WatchSquareness(PageMessage):
    """Measure the tilt of the board, or stop it."""

    do: Literal["watch-square"]
    is_on: bool


class SweepFocus(PageMessage):
    """Sweep the stage through focus: between two heights, or the whole travel."""

    do: Literal["sweep-focus"]
    low_mm: Finite | None = None
    high_mm: Finite | None = None
    steps: Annotated[int, Field(ge=7, le=200)] = 15
    has_field: bool = False
    ends_at_peak: bool = True


class Home(PageMessage):
    """Home the stage."""

    do: Literal["home"]


class Move(PageMessage):
    """Move the stage to a height, or by a distance."""

    do: Literal["move"]
    height_mm: Finite
    is_relative: bool = False


class Unlock(PageMessage):
    """Clear the stage's alarm."""

    do: Literal["unlock"]
