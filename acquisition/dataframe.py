"""Lists of results as pandas' tables, for whoever has pandas."""

from collections.abc import Iterable, Mapping, Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from pandas import DataFrame


class PandasMissingError(ImportError):
    """pandas is not installed."""


def dataframe(rows: Iterable[Mapping[str, object]]) -> "DataFrame":
    """Return a table with a line for each mapping, and a column for each of their keys.

    A list of words is one cell, the words separated by spaces; a mapping becomes columns
    ``key.name``.
    """
    try:
        import pandas as pd
    except ImportError as error:
        raise PandasMissingError(
            f"to_dataframe needs pandas ({error}): pip install standoff[pandas]"
        ) from error
    return pd.DataFrame([_flat(row) for row in rows])


def _flat(row: Mapping[str, object]) -> dict[str, object]:
    flat: dict[str, object] = {}
    for key, value in row.items():
        if isinstance(value, Mapping):
            flat.update({f"{key}.{name}": inner for name, inner in _flat(value).items()})
        elif _are_words(value):
            flat[key] = " ".join(value)  # type: ignore[arg-type]  # they are words
        else:
            flat[key] = value
    return flat


def _are_words(value: object) -> bool:
    if not isinstance(value, Sequence) or isinstance(value, str | bytes):
        return False
    return all(isinstance(one, str) for one in value)
