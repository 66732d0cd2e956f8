"""What every page may send: who it is, control, and STOP."""

from typing import Annotated, Literal

from pydantic import Field

from standoff.console.web.messages.fields import Index, Milliseconds, PageMessage, Person, StopId


class Hello(PageMessage):
    """The first message of a page: who it is; ``pictures`` asks for the live picture."""

    do: Literal["hello"]
    viewer: Annotated[str, Field(pattern=r"^[0-9a-f]{32}$")]
    name: Person = ""
    pictures: bool = False


class Acknowledge(PageMessage):
    """A picture was drawn, some time after it had arrived."""

    do: Literal["ack"]
    sequence: Annotated[int, Field(ge=0, lt=2**32)]
    in_hand_ms: Milliseconds = 0.0


class TakeControl(PageMessage):
    """Take control, or ask for it; ``name`` is the operator's, for the journal."""

    do: Literal["take"]
    name: Person = ""


class Release(PageMessage):
    """Give up control."""

    do: Literal["release"]


class Grant(PageMessage):
    """Hand control to who asks for it."""

    do: Literal["grant"]


class Refuse(PageMessage):
    """Keep control, or ask for it no more."""

    do: Literal["refuse"]


class Ping(PageMessage):
    """Answer at once: how long that takes is how old everything is that the page shows."""

    do: Literal["ping"]
    number: Index
    round_trip_ms: Milliseconds | None = None
    """Of the last answer."""


class Stop(PageMessage):
    """Stop the stage and the current job; one with an id is answered, and counts only once."""

    do: Literal["stop"]
    id: StopId | None = None
