"""Equality of what holds arrays: two results are equal where they say the same."""

from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from pathlib import PurePath

import numpy as np


class ByValue:
    """Equal to what is of the same type and holds the same, but for fields marked ``exclude``."""

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        return _is_same(self, other) if type(other) is type(self) else NotImplemented

    def __hash__(self) -> int:
        told = (getattr(self, name) for name in _compared(type(self)))  # type: ignore[arg-type]  # a class has a hash
        return hash((type(self), *(one for one in told if isinstance(one, str | PurePath))))


def _is_same(first: object, second: object) -> bool:
    """Whether two values say the same: arrays by their numbers, NaN as itself."""
    if first is second:
        return True
    if isinstance(first, np.ndarray) or isinstance(second, np.ndarray):
        return _is_same_array(first, second)
    if isinstance(first, list | tuple) and type(first) is type(second):
        assert isinstance(second, list | tuple), "of the same type"
        return len(first) == len(second) and all(map(_is_same, first, second))
    if isinstance(first, Mapping) and isinstance(second, Mapping):
        return first.keys() == second.keys() and all(
            _is_same(value, second[key]) for key, value in first.items()
        )
    if type(first) is type(second) and (names := _compared(type(first))):  # type: ignore[arg-type]  # as above
        return all(_is_same(getattr(first, name), getattr(second, name)) for name in names)
    return bool(first == second) or (_is_nan(first) and _is_nan(second))


def _is_same_array(first: object, second: object) -> bool:
    if not (isinstance(first, np.ndarray) and isinstance(second, np.ndarray)):
        return False
    return np.array_equal(first, second, equal_nan=first.dtype.kind in "fc")


def _is_nan(value: object) -> bool:
    return isinstance(value, float) and value != value


@cache
def _compared(kind: type) -> tuple[str, ...]:
    """The fields of a dataclass or of a pydantic model that count; none of other types."""
    stored = getattr(kind, "model_fields", None)
    if stored is not None:
        return tuple(name for name, one in stored.items() if not one.exclude)
    if is_dataclass(kind):
        return tuple(one.name for one in fields(kind) if one.compare)
    return ()
