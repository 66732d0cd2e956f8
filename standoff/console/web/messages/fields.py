"""What messages are made of: values within their limits, and no key that is not known."""

from typing import Annotated

from pydantic import AfterValidator, BaseModel, ConfigDict, Field

from acquisition.printable import on_one_line

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


class PageMessage(BaseModel):
    """A message of a page; ``do`` is the command."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)
