"""Paths of files as a caller gives them."""

from os import PathLike, fspath
from pathlib import Path
from typing import TypeAlias

from simulation.arguments.errors import ArgumentError, ArgumentTypeError, kind_of

FilePath: TypeAlias = str | PathLike[str]


def path_of(path: object, name: str) -> Path:
    """Return the argument as a path, or refuse it.

    Raises
    ------
    ArgumentTypeError
        If it is not a path; the message gives ``name`` and the type of the argument.
    ArgumentError
        If nothing can have such a name.
    """
    if not isinstance(path, str | PathLike):
        raise ArgumentTypeError(f"expected a path, got {kind_of(path)}", argument=name)
    text = fspath(path)
    if not isinstance(text, str) or not text or "\0" in text:
        raise ArgumentError(f"{text!r} is no name of a file or folder", argument=name)
    return path if isinstance(path, Path) else Path(text)
