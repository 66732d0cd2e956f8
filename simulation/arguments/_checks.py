"""Checks arguments by their annotations, which say the types and words, and by `RANGES`."""

import inspect
import warnings
from collections.abc import Callable, Iterable, Mapping
from contextlib import ContextDecorator
from dataclasses import dataclass, fields
from difflib import get_close_matches
from functools import cache, wraps
from numbers import Number
from os import PathLike
from sys import modules
from types import NoneType, UnionType
from typing import (
    Annotated,
    Any,
    Literal,
    ParamSpec,
    SupportsFloat,
    TypeVar,
    Union,
    get_args,
    get_origin,
)

import numpy as np
from numpy.typing import NDArray

from simulation.arguments._errors import ArgumentError, ArgumentTypeError, kind_of, range_of
from simulation.arrays import BoolArray

_COUNTS = frozenset(("", "dimensionless", "adu", "ct", "count", "counts", "dn"))
"""Units of levels, in lower case: the numbers of a camera are counts of its converter."""

_PLAIN = ("",)

_UNITS: Mapping[str, tuple[str, ...]] = {
    "px_per_mm": ("pix/mm", "pixel/mm", "1/mm"),
    "e_per_dn": ("electron/adu", "electron/count", "electron"),
    "px2": ("pix2", "pixel**2"),
    "px": ("pix", "pixel"),
    "um": ("um",),
    "mm": ("mm",),
    "us": ("us",),
    "s": ("s",),
    "deg": ("deg", "degree"),
    "dn": ("adu", "count", "ct"),
    "e": ("electron",),
}
"""By the end of a name, the longest first; in the spellings of both libraries."""


def _unit_of_quantity(value: object) -> str | None:
    """The unit of a quantity, or of astropy's images, as text; None of anything else."""
    for name, number in (("unit", "value"), ("units", "magnitude"), ("unit", "uncertainty")):
        unit = getattr(value, name, None)
        if unit is not None and not callable(value) and hasattr(value, number):
            return str(unit)
    return None


def _number_of_quantity(name: str, value: Any, unit: str) -> Any:  # noqa: ANN401 - of any library
    """The number of a quantity in the unit of an argument; refused if it is of another kind."""
    wanted = next((units for end, units in _UNITS.items() if name.endswith(f"_{end}")), _PLAIN)
    for one in (*wanted, *(_PLAIN if "px" in wanted[0] else ())):
        try:
            found = value.to(one)
        except Exception:  # noqa: BLE001, S112 - each library has errors of its own
            continue
        return getattr(found, "magnitude", getattr(found, "value", found))
    said = f"in {wanted[0]}" if wanted[0] else "without a unit"
    raise ArgumentError(f"expected a number {said}, got one in {unit or 'no unit'}", argument=name)


_TO_THE_PROCESSOR = ("compute", "detach", "cpu")
"""What brings the numbers of Dask and PyTorch here, in this order."""

_HOLDS = ("__array__", "__array_interface__", "to_numpy")


@dataclass(frozen=True, slots=True, eq=False)
class _GivenArray:
    """The numbers of an array, and which of them are masked, of its shape; None if none is."""

    values: NDArray[Any]
    masked: BoolArray | None


def is_array_like(value: object) -> bool:
    """Whether something holds an array by itself: it is no list, no path and no number."""
    return any(hasattr(value, name) for name in _HOLDS) and not isinstance(value, type)


def given_array(value: object, name: str) -> _GivenArray:
    """The numbers of anything that holds an array, with its mask; ``name`` is the argument's.

    Whatever has ``__array__`` is taken, and lists of numbers; refused is what holds none, or is in
    a unit that levels do not have.
    """
    held: Any = value
    if not (is_array_like(value) or isinstance(value, list | tuple | memoryview)):
        raise _no_array(value, name)
    if all(hasattr(held, part) for part in ("dims", "attrs", "data")):  # xarray
        _refuse_unit(held.attrs.get("units"), name)
        held = held.data
    for step in _TO_THE_PROCESSOR:
        if callable(getattr(held, step, None)):
            held = getattr(held, step)()
    unit = _unit_of_quantity(held)
    _refuse_unit(unit, name)
    mask: Any = getattr(held, "mask", None)
    held = getattr(held, "unmasked", held)
    if unit is not None:
        held = getattr(held, "magnitude", getattr(held, "value", held))
    if isinstance(held, np.ma.MaskedArray):
        mask, held = np.ma.getmaskarray(held), held.data
    values = _numbers(held, value, name)
    is_mask = isinstance(mask, np.ndarray) and mask.dtype == np.bool_
    is_masked = is_mask and mask.shape == values.shape and bool(mask.any())
    return _GivenArray(values, mask if is_masked else None)


def whole_array(value: object, name: str) -> NDArray[Any]:
    """The numbers of an array as by `given_array`; refused if some are masked."""
    found = given_array(value, name)
    if found.masked is not None:
        count = np.count_nonzero(found.masked)
        raise ArgumentError(
            f"{count} of its {found.values.size} numbers are masked; give numbers for them "
            "(filled), or leave them out",
            argument=name,
        )
    return found.values


def _numbers(held: Any, value: object, name: str) -> NDArray[Any]:  # noqa: ANN401 - of any library
    if not hasattr(held, "__array__") and hasattr(held, "to_numpy"):
        held = held.to_numpy()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            values = np.asarray(held)
    except Exception as error:
        said = str(error).strip().splitlines()
        raise _no_array(value, name, said[0] if said else type(error).__name__) from error
    if values.dtype.kind not in "uifb":
        if isinstance(held, list | tuple):
            raise _no_array(value, name)
        raise ArgumentTypeError(
            f"its numbers are of type {values.dtype}; convert them to float or integers",
            argument=name,
        )
    return values


def _refuse_unit(unit: object, name: str) -> None:
    if unit is None or str(unit).strip().lower() in _COUNTS:
        return
    raise ArgumentError(
        f"its unit is {unit}, and levels are numbers of the camera (DN); convert it and give the "
        "numbers alone",
        argument=name,
    )


def _no_array(value: object, name: str, said: str = "") -> ArgumentTypeError:
    why = f": {said}" if said else ""
    return ArgumentTypeError(f"expected an array, got {kind_of(value)}{why}", argument=name)


_P = ParamSpec("_P")
_R = TypeVar("_R")


def checked(function: Callable[_P, _R]) -> Callable[_P, _R]:
    """Check the arguments of a public function at each call, which raises `ArgumentError`."""
    signature = inspect.signature(function)

    @wraps(function)
    def called(*args: _P.args, **kwargs: _P.kwargs) -> _R:
        try:
            bound = signature.bind(*args, **kwargs)
        except TypeError:
            return function(*args, **kwargs)  # Python says best which argument there is not
        hints = hints_of(function)
        for name, value in bound.arguments.items():
            if value is not signature.parameters[name].default:
                bound.arguments[name] = accepted(name, value, hints.get(name, Any))
        return function(*bound.args, **bound.kwargs)

    return called


def check_fields(document: Any) -> None:  # noqa: ANN401 - a dataclass
    """Check the fields of a dataclass once it is made, as `checked` does arguments."""
    hints = hints_of(type(document))  # type: ignore[arg-type]  # a class can be hashed
    for one in fields(document):
        given = getattr(document, one.name)
        value = accepted(one.name, given, hints.get(one.name, Any))
        if value is not given:
            object.__setattr__(document, one.name, value)


def accepted(name: str, value: object, hint: object) -> Any:  # noqa: ANN401 - of the hint's type
    """The value of an argument as its annotation ``hint`` says, a number in the argument's unit."""
    members = _members(hint)
    if members is None:
        return value
    fault: ArgumentError | None = None
    for member in members:
        try:
            return _as_member(name, value, member)
        except ArgumentTypeError:
            continue
        except ArgumentError as error:
            fault = fault or error
    if fault is not None:
        raise fault
    raise ArgumentTypeError(f"expected {_named(members)}, got {kind_of(value)}", argument=name)


class arguments_at_fault(ContextDecorator):  # noqa: N801 - a context and a decorator, as of the library
    """Whatever pure functions refuse as a value is an argument of the function that calls them."""

    def __enter__(self) -> None:
        """Begin."""

    def __exit__(self, _kind: object, error: BaseException | None, _trace: object) -> None:
        """Turn a `ValueError` into an `ArgumentError`."""
        if type(error) is ValueError:
            raise ArgumentError(str(error)) from error


@cache
def hints_of(owner: Any) -> dict[str, Any]:  # noqa: ANN401 - a function or a class
    """Annotations by name; those that only a type checker can resolve are left out."""
    found: dict[str, Any] = {}
    for one in reversed(inspect.getmro(owner)) if inspect.isclass(owner) else (owner,):
        names = vars(modules[one.__module__]) if one.__module__ in modules else {}
        for name, hint in inspect.get_annotations(one).items():
            try:
                found[name] = eval(hint, names) if isinstance(hint, str) else hint  # noqa: S307 - ours
            except NameError:
                found.pop(name, None)
    return found


def _members(hint: object) -> tuple[Any, ...] | None:
    """The types of a union, without what is beside them; None if anything may be given."""
    try:
        return _known_members(hint)
    except TypeError:  # an annotation that cannot be hashed
        return _flat_members(hint)


@cache
def _known_members(hint: object) -> tuple[Any, ...] | None:
    return _flat_members(hint)


def _flat_members(hint: object) -> tuple[Any, ...] | None:
    if get_origin(hint) is Annotated:
        return _flat_members(get_args(hint)[0])
    if get_origin(hint) in (Union, UnionType):
        found: list[Any] = []
        for one in get_args(hint):
            inner = _flat_members(one)
            if inner is None:
                return None
            found += inner
        return tuple(dict.fromkeys(found))
    is_open = hint in (Any, object, complex) or isinstance(hint, TypeVar | str)
    is_any_array = get_origin(hint) is np.ndarray and _scalar_of(hint) is None
    of_numpy = getattr(hint, "__module__", "").startswith("numpy._typing")
    return None if is_open or is_any_array or of_numpy else (hint,)


def _scalar_of(hint: object) -> type[np.generic] | None:
    """The type of an array's numbers; None if any may be in it."""
    scalar = get_args(get_args(hint)[1])[0]
    return scalar if inspect.isclass(scalar) and issubclass(scalar, np.number | np.bool_) else None


def _as_member(name: str, value: Any, member: Any) -> Any:  # noqa: ANN401 - of the hint's type
    """The value as one type of an annotation."""
    origin = get_origin(member)
    if origin is Literal:
        return _word(name, value, get_args(member))
    if member in (int, float):
        return _number(name, value, is_whole=member is int)
    if origin is tuple:
        return _tuple(name, value, get_args(member))
    if origin is np.ndarray:
        return _array(name, value, member)
    if origin is not None and issubclass(origin, Iterable) and not issubclass(origin, Mapping):
        return _several(name, value, get_args(member))
    if member is bool and isinstance(value, np.bool_):
        return bool(value)
    if _is_of(value, origin or member):
        return value
    raise ArgumentTypeError("of another type", argument=name)


def _is_of(value: object, kind: Any) -> bool:  # noqa: ANN401 - a class, or what is no hint
    if not inspect.isclass(kind):
        return True
    if getattr(kind, "_is_protocol", False) and not getattr(kind, "_is_runtime_protocol", False):
        wanted = [one for one in vars(kind) if not one.startswith("_")]
        return all(hasattr(value, one) for one in wanted) and not inspect.isclass(value)
    return isinstance(value, kind)


def _word(name: str, value: object, words: tuple[object, ...]) -> object:
    if not isinstance(value, str):
        raise ArgumentTypeError("no word", argument=name)
    if value in words:
        return value
    near = get_close_matches(value, [str(one) for one in words], n=1)
    meant = f"; {near[0]} was probably meant" if near else ""
    listed = _listed([str(one) for one in words])
    raise ArgumentError(f"expected {listed}, got {value!r}{meant}", argument=name)


def _number(name: str, value: Any, *, is_whole: bool) -> float:  # noqa: ANN401 - of any library
    unit = _unit_of_quantity(value)
    given = value if unit is None else _number_of_quantity(name, value, unit)
    if is_array_like(given) and getattr(given, "shape", None) == ():
        given = given.item() if not isinstance(given, np.ma.MaskedArray) else np.ma.masked
    if given is np.ma.masked:
        raise ArgumentError("expected a number, got one that is masked", argument=name)
    if isinstance(given, bool | np.bool_ | complex) or not isinstance(given, Number):
        raise ArgumentTypeError("no number", argument=name)
    assert isinstance(given, SupportsFloat), "every number but a complex one"
    try:
        number = float(given)
    except (OverflowError, ValueError):
        number = np.inf
    allowed = range_of(name)
    if not allowed.holds(number) or (is_whole and not number.is_integer()):
        what = "a whole number" if is_whole else "a number"
        what = f"{what} {allowed.said_of(number)}".rstrip()
        raise ArgumentError(f"expected {what}, got {given!s:.40}", argument=name)
    if isinstance(given, int):
        return int(given)
    return int(number) if is_whole else number


def _tuple(name: str, value: object, kinds: tuple[Any, ...]) -> tuple[Any, ...]:
    listed = _listed_values(name, value)
    if isinstance(value, set | frozenset):
        raise ArgumentError("expected values in an order, got a set", argument=name)
    if not listed and kinds:
        raise ArgumentError("expected at least one value, got none", argument=name)
    if len(kinds) == 2 and kinds[1] is Ellipsis:
        kinds = (kinds[0],) * len(listed)
    if len(kinds) != len(listed):
        raise ArgumentError(f"expected {len(kinds)} values, got {len(listed)}", argument=name)
    return tuple(_item(name, one, kind) for one, kind in zip(listed, kinds, strict=True))


def _several(name: str, value: Any, kinds: tuple[Any, ...]) -> Any:  # noqa: ANN401 - as given
    """What can be gone through; of a list or a column every item is looked at."""
    if isinstance(value, str | bytes | Mapping | PathLike) or not isinstance(value, Iterable):
        raise ArgumentTypeError("not several", argument=name)
    is_column = is_array_like(value)
    if not (is_column or isinstance(value, list | tuple | set | frozenset)) or not kinds:
        return value
    found = [_item(name, one, kinds[0]) for one in _listed_values(name, value)]
    return (
        found if is_column or any(a is not b for a, b in zip(found, value, strict=True)) else value
    )


def _item(name: str, value: object, kind: object) -> Any:  # noqa: ANN401 - of the hint's type
    try:
        return accepted(name, value, kind)
    except ArgumentTypeError as error:  # that it is several is right: no other type is meant
        raise ArgumentError(f"one of its values: {error.reason}", argument=name) from error


def _listed_values(name: str, value: object) -> list[Any]:
    if isinstance(value, str | bytes | Mapping) or not isinstance(value, Iterable):
        raise ArgumentTypeError("not several", argument=name)
    try:
        return list(value)
    except Exception as error:
        raise ArgumentTypeError("not several", argument=name) from error


def _array(name: str, value: object, member: object) -> np.ndarray[Any, Any]:
    if not (is_array_like(value) or isinstance(value, list | tuple)):
        raise ArgumentTypeError("no array", argument=name)
    values = whole_array(value, name)
    scalar = _scalar_of(member)
    if scalar is np.bool_:
        values = np.asarray(values != 0)
    elif scalar is not None and not issubclass(values.dtype.type, scalar):
        values = values.astype(scalar)
    return values


def _named(members: tuple[Any, ...]) -> str:
    """The types of an annotation in words."""
    names: list[str] = []
    for one in members:
        origin = get_origin(one)
        if one is str and any(
            inspect.isclass(two) and issubclass(two, PathLike) for two in members
        ):
            continue
        if origin is Literal:
            names.append(_listed([str(word) for word in get_args(one)]))
        elif (origin or one) in _WORDS:
            names.append(_WORDS[origin or one])
        elif origin is tuple:
            kinds = [kind for kind in get_args(one) if kind is not Ellipsis]
            many = "several" if Ellipsis in get_args(one) else str(len(kinds))
            names.append(f"{many}, each {_named(tuple(dict.fromkeys(kinds)))}")
        elif origin is not None and issubclass(origin, Iterable) and get_args(one):
            inner = _members(get_args(one)[0])
            names.append("several" if inner is None else f"several, each {_named(inner)}")
        else:
            names.append(getattr(origin or one, "__name__", str(one)))
    return _listed(list(dict.fromkeys(names)))


_WORDS: Mapping[Any, str] = {
    NoneType: "None",
    float: "a number",
    int: "a whole number",
    bool: "True or False",
    str: "text",
    PathLike: "a path",
    np.ndarray: "an array",
    Callable: "a function",
    Mapping: "a mapping",
}


def _listed(words: list[str]) -> str:
    *first, last = words
    return f"{', '.join(first)} or {last}" if first else last
