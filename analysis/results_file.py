"""Writes results as one JSON document, whole or not at all."""

import json
from collections.abc import Mapping
from math import isfinite
from pathlib import Path
from typing import Any

from acquisition.session import atomic_write
from analysis.errors import ResultsFileError

__all__ = ["finite_or_null", "write_results"]


def write_results(path: Path, document: Mapping[str, Any]) -> None:
    """Write the document, whole or not at all.

    Raises
    ------
    ResultsFileError
        If the file cannot be written.
    """
    try:
        atomic_write(path, (json.dumps(document, indent=1, allow_nan=False) + "\n").encode())
    except OSError as error:
        raise ResultsFileError(f"cannot write {path}: {error.strerror}") from error


def finite_or_null(values: Mapping[str, Any]) -> dict[str, Any]:
    """Null for what JSON cannot hold: the PSNR of equal images."""
    return {
        name: None if isinstance(value, float) and not isfinite(value) else value
        for name, value in values.items()
    }
