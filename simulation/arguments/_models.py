"""Documents that are arguments as well: made by hand, they are checked as arguments are."""

from typing import Any

from pydantic import BaseModel, ValidationError

from simulation.arguments._checks import accepted, hints_of
from simulation.arguments._errors import ArgumentError


class CheckedModel(BaseModel):
    """A model whose constructor raises `ArgumentError`; reading a file raises the usual errors."""

    def __init__(self, /, **given: Any) -> None:  # noqa: ANN401 - of the fields' types
        hints = hints_of(type(self))
        found = {name: accepted(name, value, hints.get(name, Any)) for name, value in given.items()}
        try:
            super().__init__(**found)
        except ValidationError as error:
            first = error.errors()[0]
            name = str(first["loc"][0]) if first["loc"] else None
            said = first["msg"].removeprefix("Value error, ")
            if isinstance(error.__cause__, ArgumentError):
                raise error.__cause__ from error
            raise ArgumentError(said, argument=name) from error

    # Of a file: pydantic validates it without calling this, and says where a fault is.
    __init__.__pydantic_base_init__ = True  # type: ignore[attr-defined]
