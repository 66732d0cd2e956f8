"""The messages that a page may send to the console: one JSON object each, fully checked.

Most are commands: a method that `command` marks, whose arguments are the fields of its message.
"""

import inspect
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal, Union, get_type_hints

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Field,
    TypeAdapter,
    ValidationError,
    create_model,
)

from acquisition.errors import StageLimitError
from acquisition.printable import on_one_line
from standoff.console.page_words import NOT_UNDERSTOOD, field_at_fault, words_of_fault
from standoff.console.server import MAX_MESSAGE_CHARS
from standoff.errors import ApplicationError

Name = Annotated[str, Field(min_length=1, max_length=255)]
Person = Annotated[str, Field(max_length=60), AfterValidator(on_one_line)]
Reason = Annotated[str, Field(max_length=300), AfterValidator(on_one_line)]
Index = Annotated[int, Field(ge=0, lt=10**7)]
Pixels = Annotated[int, Field(ge=0, lt=2**16)]
Coordinate = Annotated[float, Field(ge=-1, lt=2**16, allow_inf_nan=False)]
Finite = Annotated[float, Field(allow_inf_nan=False)]
Milliseconds = Annotated[float, Field(ge=0, le=1e6, allow_inf_nan=False)]
Positive = Annotated[float, Field(gt=0, le=1e8, allow_inf_nan=False)]


class MessageError(ApplicationError, ValueError):
    """A page sent something that is not a message; nothing was done.

    The text is for whoever typed it in. ``do`` and ``key`` are the command and the key of its field
    at fault, empty where they are not known.
    """

    def __init__(self, text: str, *, do: str = "", key: str = "") -> None:
        super().__init__(text)
        self.do = do
        self.key = key


class PageMessage(BaseModel):
    """A message of a page; ``do`` is the command."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)

    do: str

    @property
    def arguments(self) -> dict[str, Any]:
        """All fields but ``do``, as they were validated."""
        return {name: getattr(self, name) for name in type(self).model_fields if name != "do"}


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


class Ping(PageMessage):
    """Answer at once: how long that takes is how old everything is that the page shows."""

    do: Literal["ping"]
    number: Index
    round_trip_ms: Milliseconds | None = None
    """Of the last answer."""


class Stop(PageMessage):
    """Stop the stage and the current job; one with an id is answered, and counts only once."""

    do: Literal["stop"]
    id: Annotated[str, Field(pattern=r"^[0-9a-f]{16}$")] | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Command:
    """A method that executes a message; ``message`` checks its fields.

    ``needs_control`` is False of what those who watch may send, too; ``wants_viewer`` says that the
    method is told which page sent it.
    """

    do: str
    message: type[PageMessage]
    execute: Callable[..., dict[str, Any] | None]
    needs_control: bool
    wants_viewer: bool


def command(do: str, *, needs_control: bool = True) -> Callable[[Callable[..., Any]], Command]:
    """Make a method the one that executes a message; its arguments are the message's fields.

    An argument called ``viewer`` is no field, but the identity of the page.
    """

    def declare(method: Callable[..., Any]) -> Command:
        kinds = get_type_hints(method, include_extras=True)
        literal: Any = Literal
        arguments = inspect.signature(method).parameters
        fields: dict[str, Any] = {
            name: (kinds[name], ... if field.default is field.empty else field.default)
            for name, field in arguments.items()
            if name not in ("self", "viewer")
        }
        message = create_model(
            method.__name__,
            __base__=PageMessage,
            __doc__=method.__doc__,
            do=(literal[do], ...),
            **fields,
        )
        return Command(
            do=do,
            message=message,
            execute=method,
            needs_control=needs_control,
            wants_viewer="viewer" in arguments,
        )

    return declare


def commands_of(handler: type) -> Mapping[str, Command]:
    """The commands of a class and its bases, by what their messages say."""
    found = (getattr(handler, name) for name in dir(handler))
    return {each.do: each for each in found if isinstance(each, Command)}


class MessageReader:
    """Reads messages: those of some commands, and those about the connection itself."""

    def __init__(self, commands: Iterable[Command]) -> None:
        own = (Hello, Acknowledge, Ping, Stop)
        self.kinds: tuple[type[PageMessage], ...] = (*own, *(each.message for each in commands))
        kind: Any = Annotated[Union[self.kinds], Field(discriminator="do")]  # noqa: UP007  # of a tuple
        self._adapter: TypeAdapter[PageMessage] = TypeAdapter(kind)

    def read(self, text: str) -> PageMessage:
        """Read one message; what is none is a `MessageError` that gives the reason in one line."""
        if len(text) > MAX_MESSAGE_CHARS:
            raise MessageError(
                "That is too long: the console reads at most "
                f"{MAX_MESSAGE_CHARS} characters at once."
            )
        try:
            return self._adapter.validate_json(text)
        except ValidationError as error:
            do = error.errors()[0]["loc"][:1]
            if not do:
                raise MessageError(NOT_UNDERSTOOD) from error
            key = field_at_fault(error)
            raise MessageError(words_of_fault(error), do=str(do[0]), key=key) from error


def key_at_fault(message: PageMessage, error: Exception) -> str:
    """The key of the field with the height that is beyond the stage's travel; empty for others."""
    if not isinstance(error, StageLimitError):
        return ""
    fields = message.model_dump()
    return next((key for key, value in fields.items() if value == error.height_mm), "")
