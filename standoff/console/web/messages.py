"""The messages that a page may send to the console: one JSON object each, fully checked."""

from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, TypeAdapter, ValidationError

from acquisition.choices import FocusMeasure
from acquisition.errors import StageLimitError
from acquisition.printable import on_one_line
from standoff.console.plan_drafts import PlanDraft
from standoff.console.results import ResultKind
from standoff.console.typed_values import NOT_UNDERSTOOD, field_at_fault, words_of_fault
from standoff.console.web.pose import (
    ChoosePoseCurve,
    PoseClear,
    PoseReference,
    SetPoseThreshold,
)
from standoff.errors import ApplicationError

MAX_MESSAGE_CHARS = 4096

Name = Annotated[str, Field(min_length=1, max_length=255)]
Person = Annotated[str, Field(max_length=60), AfterValidator(on_one_line)]
Reason = Annotated[str, Field(max_length=300), AfterValidator(on_one_line)]
Index = Annotated[int, Field(ge=0, lt=10**7)]
Pixels = Annotated[int, Field(ge=0, lt=2**16)]
Coordinate = Annotated[float, Field(ge=-1, lt=2**16, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Milliseconds = Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]
StopId = Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")]
Positive = Annotated[float, Field(gt=0, le=1e8, allow_inf_nan=False)]


class MessageError(ApplicationError, ValueError):
    """A page sent something that is not a message; nothing was done.

    Parameters
    ----------
    text
        For whoever typed it in.
    do, key
        The command, and the key of its field at fault; empty where they are not known.
    """

    def __init__(self, text: str, *, do: str = "", key: str = "") -> None:
        super().__init__(text)
        self.do = do
        self.key = key


class _Message(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Hello(_Message):
    """The first message of a page: who it is; ``pictures`` asks for the live picture."""

    do: Literal["hello"]
    viewer: Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]
    name: Person = ""
    pictures: bool = False


class Acknowledge(_Message):
    """A picture was drawn, some time after it had arrived."""

    do: Literal["ack"]
    sequence: Annotated[int, Field(ge=0, lt=2**32)]
    in_hand_ms: Milliseconds = 0.0


class TakeControl(_Message):
    """Take control, or ask for it; ``name`` is the operator's, for the journal."""

    do: Literal["take"]
    name: Person = ""


class Release(_Message):
    """Give up control."""

    do: Literal["release"]


class Grant(_Message):
    """Hand control to who asks for it."""

    do: Literal["grant"]


class Refuse(_Message):
    """Keep control, or ask for it no more."""

    do: Literal["refuse"]


class Ping(_Message):
    """Answer at once: how long that takes is how old everything is that the page shows."""

    do: Literal["ping"]
    number: Index
    round_trip_ms: Milliseconds | None = None
    """Of the last answer."""


class Stop(_Message):
    """Stop the stage and the current job; one with an id is answered, and counts only once."""

    do: Literal["stop"]
    id: StopId | None = None


class SetExposure(_Message):
    """Set the exposure of the live picture; one above 2 s only where that is said to be wanted."""

    do: Literal["exposure"]
    exposure_us: Positive
    is_long_wanted: bool = False


class BreakOff(_Message):
    """Break a long exposure off, and go back to the shorter one of before."""

    do: Literal["break-off"]


class SetGain(_Message):
    """Set the gain."""

    do: Literal["gain"]
    gain_db: Annotated[float, Field(ge=0, le=100, allow_inf_nan=False)]


class AutoExposure(_Message):
    """Find the exposure for what the camera sees, once."""

    do: Literal["auto-exposure"]


class TakeSnapshot(_Message):
    """Store the newest frame, or the mean of several, as a TIFF file."""

    do: Literal["snapshot"]
    frames: Literal[1, 10]


class Probe(_Message):
    """Read the level of a pixel; anybody may."""

    do: Literal["probe"]
    x: Pixels
    y: Pixels


class Profile(_Message):
    """Read the levels along a line; ends are x and y, with pixel centres at integers."""

    do: Literal["profile"]
    start: tuple[Coordinate, Coordinate]
    end: tuple[Coordinate, Coordinate]


class LookAt(_Message):
    """Measure the focus in a region, or in the whole frame if it is null."""

    do: Literal["region"]
    region: tuple[Pixels, Pixels, Pixels, Pixels] | None


class FocusMetric(_Message):
    """Choose another focus measure."""

    do: Literal["metric"]
    metric: FocusMeasure


class ForgetPeak(_Message):
    """Restart the focus trace."""

    do: Literal["forget-peak"]


class WatchField(_Message):
    """Measure the four regions near the corners, or stop it."""

    do: Literal["watch-field"]
    is_on: bool


class WatchSquareness(_Message):
    """Measure the tilt of the board, or stop it."""

    do: Literal["watch-square"]
    is_on: bool


class SweepFocus(_Message):
    """Sweep the stage through focus: between two heights, or the whole travel."""

    do: Literal["sweep-focus"]
    low_mm: Finite | None = None
    high_mm: Finite | None = None
    steps: Annotated[int, Field(ge=7, le=200)] = 15
    has_field: bool = False
    ends_at_peak: bool = True


class Home(_Message):
    """Home the stage."""

    do: Literal["home"]


class Move(_Message):
    """Move the stage to a height, or by a distance."""

    do: Literal["move"]
    height_mm: Finite
    is_relative: bool = False


class Unlock(_Message):
    """Clear the stage's alarm."""

    do: Literal["unlock"]


class Preview(_Message):
    """Show what a plan will take."""

    do: Literal["preview"]
    plan: Name


class CheckPlan(_Message):
    """Say what is wrong with a draft of a plan, or what it will take."""

    do: Literal["plan-check"]
    draft: PlanDraft


class SavePlan(_Message):
    """Write a draft to the folder of plans, under a name of its own unless it may replace one."""

    do: Literal["plan-save"]
    name: Name
    draft: PlanDraft
    is_replacing: bool = False


class Run(_Message):
    """Run a plan as a new session."""

    do: Literal["run"]
    plan: Name
    session: Name


class Resume(_Message):
    """Resume a session with its own plan."""

    do: Literal["resume"]
    session: Name


class Pause(_Message):
    """Wait before the next capture."""

    do: Literal["pause"]


class GoOn(_Message):
    """End the pause."""

    do: Literal["go-on"]


class TargetMoved(_Message):
    """Ask to place the target again: it is not where it was."""

    do: Literal["target-moved"]


class Retake(_Message):
    """Retake a capture of the session."""

    do: Literal["retake"]
    session: Name
    index: Index


class Answer(_Message):
    """Answer the question that is waiting."""

    do: Literal["answer"]
    number: Index
    choice: Name
    text: Annotated[str, Field(max_length=200)] = ""


class ComputeResult(_Message):
    """Compute a result of a session; a pose or changes compare two captures."""

    do: Literal["result"]
    session: Name
    result: ResultKind
    is_replacing: bool = False
    reference_session: Name | None = None
    reference: Index | None = None
    followup: Index | None = None


class CancelResult(_Message):
    """Cancel the result that is being computed."""

    do: Literal["cancel-result"]


class Exclude(_Message):
    """Keep a capture out of calibration and analysis."""

    do: Literal["exclude"]
    session: Name
    index: Index
    reason: Reason


class Include(_Message):
    """Use an excluded capture again."""

    do: Literal["include"]
    session: Name
    index: Index
    reason: Reason = ""


Message = (
    Hello
    | Acknowledge
    | TakeControl
    | Release
    | Grant
    | Refuse
    | Ping
    | Stop
    | SetExposure
    | BreakOff
    | SetGain
    | AutoExposure
    | TakeSnapshot
    | Probe
    | Profile
    | LookAt
    | FocusMetric
    | ForgetPeak
    | WatchField
    | WatchSquareness
    | SweepFocus
    | Home
    | Move
    | Unlock
    | Preview
    | CheckPlan
    | SavePlan
    | Run
    | Resume
    | Pause
    | GoOn
    | TargetMoved
    | Retake
    | Answer
    | ComputeResult
    | CancelResult
    | Exclude
    | Include
    | PoseReference
    | PoseClear
    | ChoosePoseCurve
    | SetPoseThreshold
)

_ADAPTER: TypeAdapter[Message] = TypeAdapter(Annotated[Message, Field(discriminator="do")])


def parse_message(text: str) -> Message:
    """Read one message.

    Raises
    ------
    MessageError
        If it is not a message; the error gives the reason in one line.
    """
    if len(text) > MAX_MESSAGE_CHARS:
        raise MessageError(
            f"That is too long: the console reads at most {MAX_MESSAGE_CHARS} characters at once."
        )
    try:
        return _ADAPTER.validate_json(text)
    except ValidationError as error:
        do = error.errors()[0]["loc"][:1]
        if not do:
            raise MessageError(NOT_UNDERSTOOD) from error
        key = field_at_fault(error)
        raise MessageError(words_of_fault(error), do=str(do[0]), key=key) from error


def key_at_fault(message: Message, error: Exception) -> str:
    """The key of the field with the height that is beyond the stage's travel; empty for others."""
    if not isinstance(error, StageLimitError):
        return ""
    fields = message.model_dump()
    return next((key for key, value in fields.items() if value == error.height_mm), "")
