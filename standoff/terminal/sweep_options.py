"""Options of the commands that work through many photographs: who works, and on what part."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Annotated

import typer

if TYPE_CHECKING:
    from analysis.sweep import SweepOptions

Workers = Annotated[int, typer.Option("--workers", min=1, help="Worker processes on this machine.")]
Scheduler = Annotated[
    str | None,
    typer.Option("--scheduler", help="Dask scheduler, tcp://HOST:PORT, instead of --workers."),
]
PartOfShards = Annotated[
    str,
    typer.Option(
        "--shard",
        metavar="K/N",
        help="Do the K-th of N parts only: for jobs of a queue that share the folder of results.",
    ),
]
Strict = Annotated[
    bool, typer.Option("--strict", help="Stop at the first photograph that gives nothing.")
]


def sweep_options(
    workers: int, scheduler: str | None, shard: str, *, is_strict: bool
) -> SweepOptions:
    """Return what these options ask for.

    Raises
    ------
    typer.BadParameter
        If there is no such part, or both a scheduler and workers are given.
    """
    from analysis.sweep import SweepOptions

    if scheduler is not None and workers != 1:
        raise typer.BadParameter(
            "give --scheduler or --workers, not both", param_hint="--scheduler"
        )
    found = re.fullmatch(r"([0-9]{1,9})/([0-9]{1,9})", shard)
    part = (int(found[1]), int(found[2])) if found else (0, 0)
    if not 1 <= part[0] <= part[1]:
        raise typer.BadParameter(
            f"expected K/N with K from 1 to N, such as 3/16, got {shard!r}", param_hint="--shard"
        )
    return SweepOptions(workers=workers, scheduler=scheduler, part=part, strict=is_strict)
