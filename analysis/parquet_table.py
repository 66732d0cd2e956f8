"""Tables of results as Parquet, for programs that read very many lines."""

import json
from collections.abc import Iterable, Mapping
from itertools import islice
from pathlib import Path
from types import NoneType
from typing import Any, get_args

from pydantic import BaseModel

from acquisition.session import whole_file
from analysis.errors import ResultsFileError

_ROWS_AT_ONCE = 10_000


def require_parquet() -> None:
    """Check, before long work, that Parquet can be written.

    Raises
    ------
    ResultsFileError
        If pyarrow is missing; the message says how to install it.
    """
    try:
        import pyarrow  # noqa: F401  # an optional dependency
    except ImportError as error:
        raise ResultsFileError(
            f"a Parquet table needs pyarrow ({error}): pip install 'standoff[parquet]'",
            source="--parquet",
        ) from error


def column_kinds(model: type[BaseModel], names: Iterable[str]) -> dict[str, type]:
    """Return what the columns of a model's values hold: numbers, truth values, or text."""
    kinds: dict[str, type] = {}
    for name in names:
        annotation = model.model_fields[name].annotation
        options = {one for one in get_args(annotation) or (annotation,) if one is not NoneType}
        kinds[name] = next((one for one in (bool, int, float) if options == {one}), str)
    return kinds


def write_parquet(
    path: Path, columns: Mapping[str, type], rows: Iterable[Mapping[str, Any]]
) -> None:
    """Write a line for each row, which need not all fit into memory.

    Parameters
    ----------
    path
        The file, there whole or not at all.
    columns
        Their names, in order, and what they hold: bool, int, float or str. What is no text goes
        into a column of text as JSON; None is null.
    rows
        Values by the names of the columns.

    Raises
    ------
    ResultsFileError
        If pyarrow is missing, or the file cannot be written.
    """
    require_parquet()
    import pyarrow as pa  # an optional dependency
    from pyarrow.parquet import ParquetWriter

    types = {bool: pa.bool_(), int: pa.int64(), float: pa.float64(), str: pa.string()}
    schema = pa.schema([(name, types[kind]) for name, kind in columns.items()])
    each = iter(rows)
    try:
        with whole_file(path, is_synced=True) as file, ParquetWriter(file, schema) as writer:
            while some := list(islice(each, _ROWS_AT_ONCE)):
                cells = {
                    name: [_cell(row[name], kind) for row in some] for name, kind in columns.items()
                }
                writer.write_table(pa.table(cells, schema=schema))
    except OSError as error:
        raise ResultsFileError(
            f"cannot write {path}: {error.strerror}", source=str(path)
        ) from error


def _cell(value: object, kind: type) -> object:
    if kind is not str or value is None or isinstance(value, str):
        return value
    return json.dumps(value)
