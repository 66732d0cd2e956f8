"""Names that a package lists in its stub, each imported from its room when it is first used."""

import ast
from collections.abc import Callable
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from standoff.shadowing import refuse_hidden_packages

_refuse_hidden_packages_once = cache(refuse_hidden_packages)


def front_of(
    package: str, file: str
) -> tuple[Callable[[str], Any], Callable[[], list[str]], list[str]]:
    """Return ``__getattr__``, ``__dir__`` and ``__all__`` of a package by the ``.pyi`` beside it.

    As ``lazy_loader.attach_stub``, which takes names of the package's own modules alone.
    """
    listed = ast.parse(Path(file).with_suffix(".pyi").read_text("utf-8"))
    places = {
        name.name: f"{package}.{line.module}" if line.level else str(line.module)
        for line in listed.body
        if isinstance(line, ast.ImportFrom)
        for name in line.names
    }

    def look_up(name: str) -> Any:  # noqa: ANN401 - whatever the stub lists
        if name not in places:
            raise AttributeError(f"module {package} has no attribute {name}")
        _refuse_hidden_packages_once()
        return getattr(import_module(places[name]), name)

    return look_up, lambda: sorted(places), sorted(places)
