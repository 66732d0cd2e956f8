"""The table of points that an operator marked in both photographs, as CSV."""

import csv
from io import StringIO
from math import isfinite, nan

import numpy as np

from calibration.registration.feature_matches import FeatureMatches

POINT_COLUMNS = ("followup_x_px", "followup_y_px", "reference_x_px", "reference_y_px")
FEWEST_POINTS = 4
"""A homography has eight unknowns, and each pair of points gives two equations."""

_MOST_POINTS = 100_000


def parse_points(text: str) -> FeatureMatches:
    """Return the pairs of points of a table; columns may stand in any order, among others.

    Raises
    ------
    ValueError
        If it is no table, lacks a column, holds something else than numbers, or fewer than four
        pairs of distinct points; the message says where.
    """
    try:
        table = csv.DictReader(StringIO(text, newline=""), strict=True)
        present = [column.strip() for column in table.fieldnames or ()]
        missing = [column for column in POINT_COLUMNS if column not in present]
        if missing:
            raise ValueError(
                f"no column {missing[0]}; the first line must be {','.join(POINT_COLUMNS)}"
            )
        table.fieldnames = present
        rows = [_numbers(row, f"line {table.line_num}") for row in _few(table)]
    except csv.Error as error:
        raise ValueError(f"not a table of values with commas: {error}") from error
    points = np.array(rows, dtype=np.float64).reshape(-1, len(POINT_COLUMNS))
    for part in (points[:, :2], points[:, 2:]):
        count = len(np.unique(part, axis=0))
        if count < FEWEST_POINTS:
            raise ValueError(
                f"{count} distinct pairs of points; mark at least {FEWEST_POINTS}, well apart and "
                "not on one line"
            )
    return FeatureMatches(points[:, :2], points[:, 2:])


def _few(table: "csv.DictReader[str]") -> list[dict[str, str | None]]:
    rows: list[dict[str, str | None]] = []
    for row in table:
        if len(rows) == _MOST_POINTS:
            raise ValueError(f"more than {_MOST_POINTS} pairs of points")
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
        raise ValueError(f"{where}: {column} {said}")
    return value
