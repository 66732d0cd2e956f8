"""Documents as JSON files: each is a pydantic model that names its schema."""

import json
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import is_dataclass
from functools import cache
from math import isfinite
from types import UnionType
from typing import Annotated, Any, TypeVar, Union, get_args, get_origin, get_type_hints

import numpy as np
from pydantic import BaseModel, ValidationError
from pydantic_core import to_json

from acquisition.regular_files import read_regular_file
from acquisition.session import write_shared
from acquisition.untrusted import parse_json
from acquisition.written_files import NO_NUMBER
from calibration.errors import DocumentError
from simulation.arguments import FilePath, path_of

Document = TypeVar("Document", bound=BaseModel)
_Nested = dict[str, object] | list[object]
_Keys = tuple[str | int, ...]
_Kinds = frozenset[object]


def json_object(document: BaseModel) -> dict[str, Any]:
    """Return the content of a document's file as plain values, with the provenance last."""
    content = document.model_dump(mode="json", by_alias=True)
    if "provenance" in content:
        content["provenance"] = content.pop("provenance")
    return content


def write_document(path: FilePath, document: BaseModel, failure: type[DocumentError]) -> None:
    """Write a document as JSON, whole or not at all; raise ``failure`` if that cannot be."""
    path, content = path_of(path, "path"), json_object(document)
    json.dumps(content, allow_nan=False)  # refuses numbers that are none; indented, it is slow
    try:
        data = to_json(content, indent=1)
    except ValueError as error:
        raise failure(
            f"cannot write {path}: a name in it is not UTF-8; rename that file", source=str(path)
        ) from error
    try:
        write_shared(path, data + b"\n")
    except OSError as error:
        raise failure(f"cannot write {path}: {error.strerror}", source=str(path)) from error


def read_document(
    path: FilePath, model: type[Document], failure: type[DocumentError], remedy: str
) -> Document:
    """Read a JSON file into a model whose ``schema_name`` has its schema as the default.

    ``failure`` is raised, with the ``remedy``, for a file of another schema.
    """
    path = path_of(path, "path")
    source = str(path)
    schema = model.model_fields["schema_name"].default
    try:
        document = parse_json(read_regular_file(path))
    except OSError as error:
        raise failure(f"cannot read {path}: {error.strerror}", source=source) from error
    except ValueError as error:
        raise failure(f"{path}: not JSON: {error}", source=source) from error
    found = document.get("schema") if isinstance(document, dict) else None
    if found != schema:
        raise failure(
            f"{path}: schema is {found!r}, expected {schema!r}; {remedy}",
            source=source,
            key="schema",
        )
    # Such numbers are never written; read, they would fail far from their file.
    infinite = _infinite_key(document)
    if infinite is not None:
        raise failure(
            f"{path}: {infinite}: Input should be a finite number", source=source, key=infinite
        )
    return fitted(document, model, failure, source)


def _infinite_key(document: _Nested) -> str | None:
    """Where a number is infinite or NaN, as ``transfer.x.mtf.3``; None if it is nowhere."""
    # Neither deep nor long ones take more than they are: no recursion, and no list of all parts.
    inside: list[tuple[object, Iterator[tuple[object, object]]]] = [("", _parts(document))]
    while inside:
        for name, value in inside[-1][1]:
            if isinstance(value, float) and not isfinite(value):
                return ".".join(str(key) for key in (*(outer for outer, _ in inside[1:]), name))
            if isinstance(value, dict | list):
                inside.append((name, _parts(value)))
                break
        else:
            inside.pop()
    return None


def _parts(value: _Nested) -> Iterator[tuple[object, object]]:
    return iter(value.items()) if isinstance(value, dict) else enumerate(value)


def fitted(
    document: object, model: type[Document], failure: type[DocumentError], source: str
) -> Document:
    """Return plain lists, numbers and text as a model; ``failure`` names what does not fit."""
    keys = _boolean_for_number(document, frozenset({model}))
    if keys is not None:
        place = _dotted(keys)
        raise failure(f"{source}: {place}: {NO_NUMBER}", source=source, key=place)
    try:
        return model.model_validate(document)
    except ValidationError as error:
        fault = error.errors()[0]
        key = _dotted(fault["loc"]) or None
        problem = fault["msg"].removeprefix("Value error, ")
        where = source if key is None else f"{source}: {key}"
        raise failure(f"{where}: {problem}", source=source, key=key) from error


def _boolean_for_number(value: object, kinds: _Kinds) -> _Keys | None:
    """Where a boolean stands in the place of a number; pydantic would take it for 1 or 0.

    ``kinds`` are the types that a value may have; what no type names is not looked at.
    """
    if isinstance(value, bool):
        return () if kinds & {int, float} and not kinds & {bool, object, Any} else None
    named, others = _kinds_inside(kinds)
    if not isinstance(value, dict | list) or not (named or others):
        return None
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
        if isinstance(inner, bool | dict | list):
            found = _boolean_for_number(inner, named.get(key, others))
            if found is not None:
                return (key, *found)
    return None


@cache
def _kinds_inside(kinds: _Kinds) -> tuple[dict[object, _Kinds], _Kinds]:
    """The types of what these types hold: by key, as models do, and of any other."""
    named = defaultdict[object, _Kinds](frozenset)
    others: _Kinds = frozenset()
    for kind in kinds:
        if isinstance(kind, type) and issubclass(kind, BaseModel):
            for name, field in kind.model_fields.items():
                named[field.alias or name] |= _members(field.annotation)
        elif isinstance(kind, type) and is_dataclass(kind):
            for name, hint in get_type_hints(kind).items():
                named[name] |= _members(hint)
        elif get_origin(kind) is np.ndarray:
            others |= {kind, float}
        else:
            inside = get_args(kind)[1:] if get_origin(kind) is dict else get_args(kind)
            others = others.union(*(_members(one) for one in inside if one is not Ellipsis))
    return {key: one | others for key, one in named.items()}, others


def _members(kind: object) -> _Kinds:
    """The types of a union, or the one type."""
    if get_origin(kind) is Annotated:
        return _members(get_args(kind)[0])
    if get_origin(kind) in (Union, UnionType):
        return frozenset[object]().union(*map(_members, get_args(kind)))
    return frozenset({kind})


def _dotted(keys: Sequence[str | int]) -> str:
    return ".".join(map(str, keys))
