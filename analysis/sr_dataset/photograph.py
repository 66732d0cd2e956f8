"""A photograph as pairs are cut from it; whoever makes a dataset reads it."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from simulation.arrays import AnyArray, FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairPhotograph:
    """A photograph that was read from a file.

    Parameters
    ----------
    stored
        Levels as the file has them, shape ``(rows, cols)`` or ``(rows, cols, 3)``.
    linear
        The same, linear in light.
    encode
        From linear levels to those that the file stores.
    marked
        Makes a PNG file state the encoding.
    encoding
        Name of the encoding.
    sha256
        Of the file.
    notes
        What is worth saying of how it was read, by kind.
    """

    path: Path
    stored: NDArray[Any] = field(repr=False)
    linear: AnyArray = field(repr=False)
    encode: Callable[[AnyArray], FloatArray]
    marked: Callable[[bytes], bytes]
    encoding: str
    sha256: str
    notes: Mapping[str, str] = field(default_factory=dict)


PairReader = Callable[[Path], PairPhotograph]
"""Reads a photograph or raises a `RefusedPhotographError`; a worker can import it."""
