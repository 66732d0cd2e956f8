"""Options of every command that reads photographs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from standoff.terminal.invocation import note_at_end

if TYPE_CHECKING:
    from standoff.photographs import Encoding, Inputs

EncodingName = Annotated[
    str,
    typer.Option(
        "--encoding",
        metavar="ENCODING",
        help="How stored levels follow from light: auto (as the file states, or as is usual for "
        "its format), linear, srgb or gamma:G.",
    ),
]
ShortEncoding = Annotated[
    bool | None,
    typer.Option("--srgb/--linear", help="Short for --encoding srgb and --encoding linear."),
]
Page = Annotated[
    int | None, typer.Option("--page", min=1, help="Which image of a stack to read, from 1.")
]
Mean = Annotated[
    bool, typer.Option("--mean", help="Read a stack as one capture: its mean and variance.")
]


def photograph_inputs(
    encoding: str = "auto",
    page: int | None = None,
    mean: bool = False,
    short: bool | None = None,
    *,
    files: Sequence[Path | None] = (),
) -> Inputs:
    """Return the reader that these options ask for; what it finds out is noted at the end.

    Parameters
    ----------
    encoding, page, mean, short
        Values of the options.
    files
        Other files that the command reads, for the provenance; None for what is not given.

    Raises
    ------
    typer.BadParameter
        If the encoding is unknown, or two options contradict each other.
    """
    if short is not None and encoding != "auto":
        raise typer.BadParameter(
            "give --encoding or its short form, not both", param_hint="--encoding"
        )
    if mean and page is not None:
        raise typer.BadParameter("give --page or --mean, not both", param_hint="--mean")
    from standoff.photographs import Inputs, ReadOptions

    if short is not None:
        encoding = "srgb" if short else "linear"
    options = ReadOptions(encoding=_encoding(encoding), page=page, is_mean=mean)
    inputs = Inputs(options, note_at_end)
    for path in files:
        inputs.add(path)
    return inputs


def _encoding(name: str) -> Encoding | None:
    from standoff.photographs import Encoding

    if name == "auto":
        return None
    try:
        return Encoding(name=name)
    except ValueError as error:
        raise typer.BadParameter(
            f"expected auto, linear, srgb or gamma:G such as gamma:2.2, got {name!r}",
            param_hint="--encoding",
        ) from error
