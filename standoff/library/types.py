"""Readers of documents, and the types that the public functions take and return.

Each lies in the room that makes it, and is imported when it is first asked for.
"""

import ast
from importlib import import_module
from pathlib import Path
from typing import Any

_LISTED = ast.parse(Path(__file__).with_suffix(".pyi").read_text("utf-8"))
_PLACES = {
    name.asname or name.name: (line.module, name.name)
    for line in _LISTED.body
    if isinstance(line, ast.ImportFrom) and line.module is not None
    for name in line.names
}
__all__ = list(_PLACES)


def __getattr__(name: str) -> Any:  # noqa: ANN401 - whatever the stub lists
    if name not in _PLACES:
        raise AttributeError(f"module {__name__} has no attribute {name}")
    module, of_module = _PLACES[name]
    return getattr(import_module(module), of_module)
