"""Paths of files as a caller gives them."""

from collections.abc import Collection
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


def output_path(path: object, name: str, suffixes: Collection[str]) -> Path:
    """Return the argument as the path of a file to write, or refuse it.

    Raises
    ------
    ArgumentTypeError, ArgumentError
        As ``path_of``, or if its name ends in none of the suffixes of what is written.
    """
    out = path_of(path, name)
    if out.suffix.lower() not in suffixes:
        listed = " or ".join(sorted(suffixes))
        raise ArgumentError(
            f"{str(out)!r} must end in {listed}, which is what is written", argument=name
        )
    return out
