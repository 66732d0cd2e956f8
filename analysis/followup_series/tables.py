"""Tables of very many follow-ups, as CSV and JSON, written line by line."""

import csv
import json
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from io import TextIOWrapper
from pathlib import Path
from typing import Any

from acquisition.session import whole_file
from analysis.errors import ResultsFileError
from analysis.results_file import ResultsDocument
from calibration.documents import json_object

LIST_KEY = "followups"
"""The one list of a summary that is as long as the sweep."""


def write_csv(path: Path, columns: Sequence[str], rows: Iterable[dict[str, Any]]) -> None:
    """Write a line for each row, and the names of the columns above; None is an empty cell.

    Raises
    ------
    ResultsFileError
        If the file cannot be written.
    """
    with _text_file(path) as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(columns)
        writer.writerows([row[column] for column in columns] for row in rows)


def write_summary(path: Path, document: ResultsDocument, rows: Iterable[dict[str, Any]]) -> None:
    """Write a document with its list of follow-ups, which need not fit into memory.

    Raises
    ------
    ResultsFileError
        If the file cannot be written.
    """
    with _text_file(path) as file:
        separator = "{"
        for key, value in json_object(document).items():
            file.write(f"{separator}\n {json.dumps(key)}: ")
            if key == LIST_KEY:
                _write_list(file, rows)
            else:
                file.write(json.dumps(value, allow_nan=False))
            separator = ","
        file.write("\n}\n")


def _write_list(file: TextIOWrapper, rows: Iterable[dict[str, Any]]) -> None:
    separator = "["
    for row in rows:
        file.write(f"{separator}\n  {json.dumps(row, allow_nan=False)}")
        separator = ","
    file.write("[]" if separator == "[" else "\n ]")


@contextmanager
def _text_file(path: Path) -> Iterator[TextIOWrapper]:
    """Open a text file that is there whole or not at all; the last of several writers wins."""
    try:
        with whole_file(path, is_synced=True) as file:
            text = TextIOWrapper(file, encoding="utf-8", newline="")
            yield text
            text.detach()  # flushed; whoever opened the file closes it
    except OSError as error:
        raise ResultsFileError(
            f"cannot write {path}: {error.strerror}", source=str(path)
        ) from error
