"""Arrays as people have them: numpy's, those of other libraries, lists; with masks and units."""

import warnings
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simulation.arguments.errors import ArgumentError, ArgumentTypeError, kind_of
from simulation.arguments.quantities import COUNTS, unit_of_quantity
from simulation.arrays import BoolArray

_TO_THE_PROCESSOR = ("compute", "detach", "cpu")
"""What brings the numbers of Dask and PyTorch here, in this order."""

_HOLDS = ("__array__", "__array_interface__", "to_numpy")


@dataclass(frozen=True, slots=True, eq=False)
class GivenArray:
    """The numbers of an array, and which of them are masked, of its shape; None if none is."""

    values: NDArray[Any]
    masked: BoolArray | None


def is_array_like(value: object) -> bool:
    """Whether something holds an array by itself: it is no list, no path and no number."""
    return any(hasattr(value, name) for name in _HOLDS) and not isinstance(value, type)


def given_array(value: object, name: str) -> GivenArray:
    """Return the numbers of anything that holds an array, with its mask.

    Whatever has ``__array__`` is taken, as of PyTorch, Dask, xarray, astropy, pandas and polars,
    and so are lists of numbers.

    Parameters
    ----------
    value
        As it was given.
    name
        Of the argument.

    Raises
    ------
    ArgumentTypeError
        If it holds no array of numbers.
    ArgumentError
        If it is in a unit that levels do not have.
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
    unit = unit_of_quantity(held)
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
    return GivenArray(values, mask if is_masked else None)


def whole_array(value: object, name: str) -> NDArray[Any]:
    """Return the numbers of an array of which none is masked.

    Raises
    ------
    ArgumentError
        As `given_array`, or if some are masked.
    """
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
    if unit is None or str(unit).strip().lower() in COUNTS:
        return
    raise ArgumentError(
        f"its unit is {unit}, and levels are numbers of the camera (DN); convert it and give the "
        "numbers alone",
        argument=name,
    )


def _no_array(value: object, name: str, said: str = "") -> ArgumentTypeError:
    why = f": {said}" if said else ""
    return ArgumentTypeError(f"expected an array, got {kind_of(value)}{why}", argument=name)
