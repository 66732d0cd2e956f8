"""Options of every command that reads photographs."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from standoff.errors import ArgumentError

if TYPE_CHECKING:
    from standoff.photographs import ReadOptions

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


def reading_options(
    encoding: str, page: int | None, mean: bool, short: bool | None = None
) -> ReadOptions:
    """Return how photographs are read by the values of these options.

    Raises
    ------
    typer.BadParameter, ArgumentError
        If the encoding is unknown, or two options contradict each other.
    """
    if short is not None and encoding != "auto":
        raise typer.BadParameter(
            "give --encoding or its short form, not both", param_hint="--encoding"
        )
    if mean and page is not None:
        raise typer.BadParameter("give --page or --mean, not both", param_hint="--mean")
    from standoff.library import reading

    try:
        return reading(
            encoding if short is None else "srgb" if short else "linear", page=page, mean=mean
        )
    except ArgumentError as error:
        raise typer.BadParameter(str(error), param_hint="--encoding") from error
