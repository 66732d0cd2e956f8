"""JSON and TOML from files that others wrote: whatever is wrong with it is a ``ValueError``."""

import json
import tomllib
from typing import Any

__all__ = ["parse_json", "parse_toml"]

_TOO_DEEP = "its brackets are nested too deeply"


def parse_json(text: str | bytes) -> Any:  # noqa: ANN401 - the reader checks what it needs
    """Read one JSON document.

    Raises
    ------
    ValueError
        If it is none, not UTF-8, or nested deeper than the parser goes.
    """
    try:
        return json.loads(text if isinstance(text, str) else text.decode("utf-8"))
    except RecursionError as error:
        raise ValueError(_TOO_DEEP) from error


def parse_toml(text: str | bytes) -> dict[str, Any]:
    """Read one TOML document.

    Raises
    ------
    ValueError
        If it is none, not UTF-8, nested deeper than the parser goes, or holds a number of
        thousands of digits.
    """
    try:
        return tomllib.loads(text if isinstance(text, str) else text.decode("utf-8"))
    except RecursionError as error:
        raise ValueError(_TOO_DEEP) from error
