"""The messages that a page may send to the console: one JSON object each, fully checked."""

from typing import Annotated

from pydantic import Field, TypeAdapter, ValidationError

from acquisition.errors import StageLimitError
from standoff.console.serving import MAX_MESSAGE_CHARS
from standoff.console.typed_values import NOT_UNDERSTOOD, field_at_fault, words_of_fault
from standoff.console.web.messages.bench_messages import (
    AutoExposure,
    BreakOff,
    FocusMetric,
    ForgetPeak,
    Home,
    LookAt,
    Move,
    Probe,
    Profile,
    SetExposure,
    SetGain,
    SweepFocus,
    TakeSnapshot,
    Unlock,
    WatchField,
    WatchSquareness,
)
from standoff.console.web.messages.page_messages import (
    Acknowledge,
    Grant,
    Hello,
    Ping,
    Refuse,
    Release,
    Stop,
    TakeControl,
)
from standoff.console.web.messages.pose_messages import (
    ChoosePoseCurve,
    PoseClear,
    PoseReference,
    SetPoseThreshold,
)
from standoff.console.web.messages.session_messages import (
    Answer,
    CancelResult,
    CheckPlan,
    ComputeResult,
    Exclude,
    GoOn,
    Include,
    Pause,
    Preview,
    Resume,
    Retake,
    Run,
    SavePlan,
    TargetMoved,
)
from standoff.errors import ApplicationError


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
