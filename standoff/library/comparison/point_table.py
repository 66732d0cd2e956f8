"""The table of points that an operator marked in both photographs, as CSV."""

import csv
from io import StringIO
from math import isfinite, nan
from pathlib import Path

import numpy as np

from acquisition.printable import on_one_line
from calibration.registration import FeatureMatches
from simulation.arrays import FloatArray
from standoff.errors import HintError
from standoff.photographs import read_file

POINT_COLUMNS = ("followup_x_px", "followup_y_px", "reference_x_px", "reference_y_px")
FEWEST_POINTS = 4
"""A homography has eight unknowns, and each pair of points gives two equations."""

_MOST_POINTS = 100_000
_MOST_BYTES = 16 << 20
"""Twice the four numbers of the most points, written out in full."""


def read_points(path: Path) -> FeatureMatches:
    """Read pairs of points; columns may stand in any order, among others.

    Raises
    ------
    HintError, ImageFileError
        If the file cannot be read, lacks a column, holds something else than numbers, or fewer
        than four pairs of distinct points.
    """
    name = on_one_line(path)
    try:
        text = read_file(path, _MOST_BYTES).decode("utf-8-sig")
        table = csv.DictReader(StringIO(text, newline=""), strict=True)
        present = [column.strip() for column in table.fieldnames or ()]
        missing = [column for column in POINT_COLUMNS if column not in present]
        if missing:
            raise HintError(
                f"{name}: no column {missing[0]}; the first line must be {','.join(POINT_COLUMNS)}"
            )
        table.fieldnames = present
        rows = [_numbers(row, f"{name}: line {table.line_num}") for row in _few(table, name)]
    except UnicodeDecodeError as error:
        raise HintError(f"{name}: not a table of text in UTF-8") from error
    except csv.Error as error:
        raise HintError(f"{name}: not a table of values with commas: {error}") from error
    points = np.array(rows, dtype=np.float64).reshape(-1, len(POINT_COLUMNS))
    for part in (points[:, :2], points[:, 2:]):
        count = len(np.unique(part, axis=0))
        if count < FEWEST_POINTS:
            raise HintError(
                f"{name}: {count} distinct pairs of points; mark at least {FEWEST_POINTS}, well "
                "apart and not on one line"
            )
    return FeatureMatches(points[:, :2], points[:, 2:])


def _few(table: "csv.DictReader[str]", name: str) -> list[dict[str, str | None]]:
    rows: list[dict[str, str | None]] = []
    for row in table:
        if len(rows) == _MOST_POINTS:
            raise HintError(f"{name}: more than {_MOST_POINTS} pairs of points")
        rows.append(row)
    return rows


def _numbers(row: dict[str, str | None], where: str) -> list[float]:
    return [_number(row[column], column, where) for column in POINT_COLUMNS]


def _number(text: str | None, column: str, where: str) -> float:
    written = (text or "").strip()
    try:
        value = float(written)
    except ValueError:
        value = nan
    if not isfinite(value):
        said = f"{written[:40]!r} is no number" if written else "is missing"
        raise HintError(f"{where}: {column} {said}")
    return value


def refuse_points_outside(
    points_px: FloatArray, shape: tuple[int, int], name: str, photograph: str
) -> None:
    """Check that points ``(x, y)``, shape (n, 2), lie in a photograph of ``(rows, cols)``.

    Raises
    ------
    HintError
        If one does not.
    """
    rows, cols = shape
    is_outside = np.any((points_px < -0.5) | (points_px > [cols - 0.5, rows - 0.5]), axis=1)
    if is_outside.any():
        x_px, y_px = points_px[is_outside][0]
        raise HintError(
            f"{name}: the point {x_px:g}, {y_px:g} lies outside {photograph}, which has "
            f"{cols} x {rows} px"
        )
