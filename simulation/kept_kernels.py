"""Kernels whose design takes seconds, kept from run to run by whoever has a place for them.

The capture model knows no files: here a design gets a name that holds all that decides it, and
``keep_kernels`` takes what keeps designs by their names. Without it every process makes its own.
"""

from collections.abc import Callable
from dataclasses import fields, is_dataclass

import numpy as np

from simulation.arrays import FloatArray

Arrays = tuple[FloatArray, ...]
Design = Callable[[], Arrays]

Keeper = Callable[[str, Design], Arrays]
"""Returns what it keeps by a name, or else what the design returns, and keeps that."""

_OUR_PACKAGE = __name__.partition(".")[0] + "."

_keeper: Keeper | None = None


def keep_kernels(keeper: Keeper | None) -> None:
    """Keep the kernels that are designed from here on; with None, no longer."""
    global _keeper
    _keeper = keeper


def kept(what: str, decided_by: tuple[object, ...], design: Design) -> Arrays:
    """Arrays of a design, as they were kept or else new; the same to the bit.

    ``decided_by`` is all that it depends on: numbers, strings, arrays, tuples, dataclasses of ours;
    with anything else nothing is kept. Arrays are float64 of at least one dimension.
    """
    keeper = _keeper
    try:
        arrays = design() if keeper is None else keeper(f"{what}{_described(decided_by)}", design)
    except _UndescribedError:
        arrays = design()
    # Sums depend on the order in memory in their last bits, and files have but one.
    return tuple(np.ascontiguousarray(array) for array in arrays)


class _UndescribedError(TypeError):
    """Nothing says what decides the value's numbers."""


def _described(value: object) -> str:
    """Text that differs wherever the values do; a ``repr`` may leave numbers out."""
    if isinstance(value, float):
        return float(value).hex()
    if value is None or isinstance(value, int | str):
        return repr(value)
    if isinstance(value, tuple):
        return f"({','.join(map(_described, value))})"
    if isinstance(value, np.ndarray):
        return f"{value.dtype.str}{value.shape}{value.tobytes().hex()}"
    kind = type(value)
    if is_dataclass(value) and kind.__module__.startswith(_OUR_PACKAGE):
        parts = (f"{f.name}={_described(getattr(value, f.name))}" for f in fields(value))
        return f"{kind.__qualname__}({','.join(parts)})"
    raise _UndescribedError
