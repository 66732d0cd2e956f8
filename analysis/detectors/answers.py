"""What a detector returned, as a number or a map."""

import traceback
from numbers import Real

import numpy as np

from acquisition.printable import on_one_line
from analysis.errors import DetectorError
from simulation.arrays import Float32Array

_LINE_LETTERS = 300


def plain_answer(answer: object) -> float | Float32Array:
    """Return a number as float and an array as float32; a 0-d array is a number.

    Raises
    ------
    DetectorError
        With reason ``output``, if it is neither; the message lacks the detector's name.
    """
    if isinstance(answer, Real) or (isinstance(answer, np.ndarray) and answer.ndim == 0):
        answer = np.asarray(answer)
    elif not isinstance(answer, np.ndarray):
        # Tensors become arrays; a list would too, and text.
        if not hasattr(answer, "__array__"):
            raise DetectorError(
                f"it returned {_kind(answer)}; a detector returns a number or an array",
                reason="output",
            )
        answer = np.asarray(answer)
    if answer.dtype.kind not in "biuf":
        raise DetectorError(
            f"it returned {answer.dtype} values; a detector's are real numbers", reason="output"
        )
    if answer.ndim == 0:
        return float(answer)
    with np.errstate(over="ignore"):  # infinite levels are refused by whoever checks
        return np.ascontiguousarray(answer, dtype=np.float32)


def exception_line(error: BaseException) -> str:
    """Return the last line of what Python prints for an exception."""
    lines = "".join(traceback.format_exception_only(error)).strip().splitlines()
    return short_line(lines[-1] if lines else type(error).__name__)


def short_line(text: str) -> str:
    """Return a text as one printable line of bounded length."""
    shown = on_one_line(text.strip())
    return shown if len(shown) <= _LINE_LETTERS else f"{shown[:_LINE_LETTERS]}..."


def _kind(value: object) -> str:
    return "None" if value is None else f"a {type(value).__name__}"
