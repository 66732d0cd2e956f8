"""Documents of results as JSON files: each is made, written and read as one pydantic model."""

import json
from math import inf, isfinite
from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import (
    AllowInfNan,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    PlainSerializer,
    ValidationError,
)

from acquisition.session import atomic_write
from acquisition.untrusted import parse_json
from analysis.errors import ResultsFileError

__all__ = ["InfiniteAsNull", "ResultsDocument", "StoredValues", "read_results", "write_results"]

InfiniteAsNull = Annotated[
    float,
    AllowInfNan(),
    BeforeValidator(lambda value: inf if value is None else value),
    PlainSerializer(lambda value: value if isfinite(value) else None, when_used="json"),
]
"""A number that may be infinite, which JSON cannot hold: there it is null."""


class StoredValues(BaseModel):
    """Values of a document; what a later version adds is passed over."""

    model_config = ConfigDict(frozen=True, extra="ignore", allow_inf_nan=False)


class ResultsDocument(StoredValues):
    """A whole document; subclasses state its schema, with a default."""

    model_config = ConfigDict(populate_by_name=True)

    schema_name: str = Field(alias="schema")

    def as_json(self) -> dict[str, Any]:
        """Return the document as plain lists, texts and numbers."""
        return self.model_dump(mode="json", by_alias=True)


_Document = TypeVar("_Document", bound=ResultsDocument)


def write_results(path: Path, document: ResultsDocument) -> None:
    """Write a document, whole or not at all.

    Raises
    ------
    ResultsFileError
        If the file cannot be written.
    """
    text = json.dumps(document.as_json(), indent=1, allow_nan=False) + "\n"
    try:
        atomic_write(path, text.encode())
    except OSError as error:
        raise ResultsFileError(
            f"cannot write {path}: {error.strerror}", source=str(path)
        ) from error


def read_results(path: Path, kind: type[_Document], name: str, written_by: str) -> _Document:
    """Read a document.

    Parameters
    ----------
    path
        The file.
    kind
        The class of its document.
    name
        What such files are called.
    written_by
        The command that writes them.

    Raises
    ------
    ResultsFileError
        If it cannot be read, is of another schema, or a value is missing or wrong.
    """
    try:
        content = parse_json(path.read_bytes())
    except OSError as error:
        raise ResultsFileError(f"cannot read {path}: {error.strerror}", source=str(path)) from error
    except ValueError as error:
        raise ResultsFileError(f"{path}: not a {name}: {error}", source=str(path)) from error
    expected = kind.model_fields["schema_name"].default
    found = content.get("schema") if isinstance(content, dict) else None
    if found != expected:
        raise ResultsFileError(
            f"{path}: schema is {found!r}, expected {expected!r}; write it with {written_by}",
            source=str(path),
            key="schema",
        )
    try:
        return kind.model_validate(content)
    except ValidationError as error:
        fault = error.errors()[0]
        key = ".".join(str(part) for part in fault["loc"])
        raise ResultsFileError(
            f"{path}: {key}: {fault['msg']}", source=str(path), key=key
        ) from error
