"""How the commands tell of a series of photographs: tables of a few, and the count of refused."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar

import typer

from standoff.errors import ApplicationError
from standoff.terminal.output import note, print_json, print_table, say

if TYPE_CHECKING:
    from analysis.sweep import SweepOptions, SweepSummary

Listed = TypeVar("Listed")


def refuse_sweep_of_one(options: SweepOptions) -> None:
    """Refuse options that have no meaning for one photograph; one worker does for it."""
    for option, is_given in (
        ("--scheduler", options.scheduler is not None),
        ("--shard", options.part != (1, 1)),
    ):
        if is_given:
            raise typer.BadParameter(f"{option} needs several follow-ups, or a folder of them")


def print_few(
    titles: tuple[str, str, str],
    columns: list[str],
    cells: Callable[[Listed], list[str]],
    first: Sequence[Listed],
    worst: Sequence[Listed],
) -> None:
    """Print a table of all, or tables of the first and of the worst few of many.

    Parameters
    ----------
    titles
        Of the table of all, of the first ones, and of the worst.
    columns, cells
        Names of the columns, and the cells of a line.
    first, worst
        All and none, or the first and the worst few.
    """
    whole, begin, end = titles
    print_table(begin if worst else whole, columns, [cells(one) for one in first])
    if worst:
        print_table(end, columns, [cells(one) for one in worst])


def say_part(out: Path, sweep: SweepSummary, options: SweepOptions, *, json: bool) -> None:
    """Tell of one of several parts, while others are not done."""
    shard = f"{options.part[0]}/{options.part[1]}"
    if json:
        print_json(
            {"out": str(out), "shard": shard, "images": sweep.images, "refused": sweep.refused}
        )
        return
    say(
        f"part {shard}: {sweep.images} follow-ups done, {sweep.refused} refused "
        f"({sweep.found_done} already done); the part that ends last writes the tables"
    )


def report_refused(sweep: SweepSummary, given: str) -> None:
    """End with the number of refused photographs, if there are any, and note the first ones.

    Parameters
    ----------
    sweep
        Counts and lines.
    given
        What the others gave, as the end of a sentence.

    Raises
    ------
    ApplicationError
        If a photograph was refused.
    """
    if not sweep.refused:
        return
    if sweep.refused == 1:
        why = f"{sweep.refused_lines[0]}; "
    else:
        why = ""
        for line in sweep.refused_lines:
            note(line)
    images = sweep.images + sweep.refused
    is_cut = sweep.refused > len(sweep.refused_lines)
    listed = f" ({sweep.refused_list} lists them)" if is_cut else ""
    raise ApplicationError(
        f"{why}{sweep.refused} of {images} follow-ups gave nothing{listed}; {given}"
    )
