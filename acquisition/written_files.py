"""Files that a person writes: TOML read and validated key by key, with faults in one line."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any, TypeVar, get_args

from pydantic import BaseModel, ConfigDict, ValidationError, ValidationInfo, field_validator
from pydantic_core import ErrorDetails, PydanticCustomError

from acquisition.quantities import (
    ImplausibleQuantityError,
    UnknownUnitError,
    decimal_comma_remedy,
    nearest_key,
    toml_slip,
    understood,
)
from acquisition.regular_files import read_regular_file
from acquisition.untrusted import parse_toml

_MOST_FAULTS = 12
NO_NUMBER = "expected a number; true and false are not numbers"

_BY_A_PERSON = {"is_by_a_person": True}


class WrittenTable(BaseModel):
    """A table of a file that a person writes.

    Read by `validate_written`, its numbers may state their units (``"9 ms"``), and one that is
    implausible without is refused. A boolean is no number.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False, defer_build=True)

    @field_validator("*", mode="before")
    @classmethod
    def _is_understood(cls, value: object, info: ValidationInfo) -> object:
        if info.field_name is not None and _holds_boolean(value):
            kind = cls.model_fields[info.field_name].annotation
            kinds = {kind, *_arguments(kind)}
            if kinds & {int, float} and bool not in kinds:
                raise PydanticCustomError("boolean", "{text}", {"text": NO_NUMBER})
        if info.context != _BY_A_PERSON or info.field_name is None:
            return value
        return understood(info.field_name, value)


Written = TypeVar("Written", bound=WrittenTable)


def read_toml(path: Path) -> dict[str, Any]:
    """Read a TOML file."""
    data = read_regular_file(path)
    try:
        return parse_toml(data)
    except ValueError as error:
        slip = toml_slip(data.decode("utf-8", "replace"))
        raise ValueError(f"not valid TOML: {slip or error}") from error


def validate_written(model: type[Written], table: dict[str, Any]) -> Written:
    """Validate a table that a person wrote, whose numbers may state their units."""
    return model.model_validate(table, context=_BY_A_PERSON)


def validation_lines(error: ValidationError, model: type[BaseModel] | None = None) -> str:
    """One line that names each key at fault, or the first of many; unknown ones by ``model``'s."""
    known = [] if model is None else list(dotted_keys(model))
    faults = error.errors()
    lines = [_line(fault, known) for fault in faults[:_MOST_FAULTS]]
    if len(faults) > _MOST_FAULTS:
        lines.append(f"and {len(faults) - _MOST_FAULTS} more")
    return "; ".join(lines)


def validation_keys(error: ValidationError) -> tuple[str, ...]:
    """The dotted key of each fault; empty where the whole is at fault."""
    return tuple(_dotted(fault["loc"]) for fault in error.errors())


def dotted_keys(model: type[BaseModel], prefix: str = "") -> Iterator[str]:
    """Every key of a model and of the tables in it, such as ``camera`` and ``camera.gain_db``."""
    for name, field in model.model_fields.items():
        key = prefix + (field.alias or name)
        yield key
        for kind in (field.annotation, *_arguments(field.annotation)):
            if isinstance(kind, type) and issubclass(kind, BaseModel):
                yield from dotted_keys(kind, f"{key}.")


def _arguments(kind: object) -> Iterator[object]:
    for argument in get_args(kind):
        yield argument
        yield from _arguments(argument)


def _line(fault: ErrorDetails, known: list[str]) -> str:
    key = _dotted(fault["loc"])
    cause = fault.get("ctx", {}).get("error")
    if isinstance(cause, ImplausibleQuantityError | UnknownUnitError):
        return f"{key} {cause}"
    if fault["type"] == "extra_forbidden":
        nearest = _nearest(fault["loc"], known)
        return f"unknown key {key}" + (f"; did you mean {nearest}?" if nearest else "")
    if fault["type"] == "float_parsing" and isinstance(fault["input"], str):
        name = next((part for part in reversed(fault["loc"]) if isinstance(part, str)), "")
        remedy = decimal_comma_remedy(fault["input"], name)
        if remedy is not None:
            return f'{key} = "{fault["input"]}": {remedy}'
    what = fault["msg"]
    sizes = fault.get("ctx", {})
    if fault["type"] == "too_long" and sizes.get("actual_length") == 2 * sizes["max_length"]:
        what += "; write decimals with a point, as commas separate the numbers"
    return f"{key}: {what}" if key else what


def _holds_boolean(value: object) -> bool:
    if isinstance(value, list | tuple):
        return any(map(_holds_boolean, value))
    return isinstance(value, bool)


def _nearest(loc: tuple[int | str, ...], known: list[str]) -> str | None:
    """The known key that an unknown one resembles, in the same entry of a list if it is there."""
    nearest = nearest_key(_dotted(part for part in loc if isinstance(part, str)), known)
    if nearest is None:
        return None
    names = [part for part in loc[:-1] if isinstance(part, str)]
    section, _, name = nearest.rpartition(".")
    return _dotted((*loc[:-1], name)) if section == ".".join(names) else nearest


def _dotted(loc: Iterable[int | str]) -> str:
    return ".".join(map(str, loc))
