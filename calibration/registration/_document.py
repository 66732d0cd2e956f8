"""The contents of an H.json: a follow-up's pose in its reference."""

from typing import Annotated, Final, Literal

import numpy as np
from pydantic import BeforeValidator, Field, PlainSerializer

from acquisition.files import Provenance, StoredModel
from simulation.arguments import CheckedModel
from simulation.arrays import FloatArray
from simulation.by_value import ByValue
from simulation.notebook import Shown
from simulation.pose import homography_fault

HOMOGRAPHY_SCHEMA: Final = "standoff.homography/1"


def _matrix(value: object) -> FloatArray:
    try:
        matrix = np.array(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise ValueError("expected 3 x 3 numbers") from error
    fault = homography_fault(matrix)
    if fault is not None:
        raise ValueError(fault)
    matrix.setflags(write=False)
    return matrix


def _distortion(value: object) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool) and abs(value) < 1:
        return float(value)
    raise ValueError(f"{value!r} is not a number between -1 and 1")


class Homography(
    Shown, ByValue, CheckedModel, StoredModel, allow_inf_nan=False, arbitrary_types_allowed=True
):
    """A homography from a follow-up to its reference.

    Parameters
    ----------
    matrix
        Shape (3, 3): maps follow-up pixel centres ``(x, y, 1)`` to reference pixel centres; if the
        lens distorts, those of an ideal lens.
    size
        ``(width, height)`` of the follow-up in px.
    distortion_k1
        Radial distortion of the common lens, relative, at the corner of the reference.
    """

    schema_name: Literal["standoff.homography/1"] = Field(default=HOMOGRAPHY_SCHEMA, alias="schema")
    matrix: Annotated[
        FloatArray,
        BeforeValidator(_matrix),
        PlainSerializer(lambda matrix: matrix.tolist(), return_type=list[list[float]]),
    ]
    size: tuple[Annotated[int, Field(strict=True, gt=0)], Annotated[int, Field(strict=True, gt=0)]]
    distortion_k1: Annotated[float, BeforeValidator(_distortion)] = 0.0
    provenance: Provenance | None = None

    def __repr__(self) -> str:
        width, height = self.size
        return f"{type(self).__name__}({width} x {height} px, distortion_k1={self.distortion_k1:g})"

    def __str__(self) -> str:
        return repr(self)
