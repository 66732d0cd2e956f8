"""How the commands tell of a series of photographs: tables of a few, and the count of refused."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from typer import BadParameter

from standoff.errors import ApplicationError
from standoff.terminal.output import note, print_json, print_table, say

if TYPE_CHECKING:
    from analysis.results_file import StoredValues
    from analysis.sweep import SweepOptions, SweepSummary
    from standoff.library import SeriesResult

Listed = TypeVar("Listed", bound="StoredValues")


def refuse_sweep_of_one(options: SweepOptions, *, parquet: bool) -> None:
    """Refuse options that have no meaning for one photograph; one worker does for it."""
    given = {
        "--scheduler": options.scheduler is not None,
        "--shard": options.part != (1, 1),
        "--parquet": parquet,
    }
    for option in (name for name, is_given in given.items() if is_given):
        raise BadParameter(f"{option} needs several follow-ups, or a folder of them")


def print_few(
    columns: Sequence[str],
    cells: Callable[[Listed], Sequence[str]],
    found: SeriesResult[Any, Listed],
    title_of_worst: str,
) -> None:
    """Print a table of all follow-ups, or tables of the first and of the worst few of many."""
    title = "First follow-ups" if found.worst else "Follow-ups"
    print_table(title, columns, [cells(one) for one in found.first])
    if found.worst:
        print_table(title_of_worst, columns, [cells(one) for one in found.worst])


def say_part(out: Path, sweep: SweepSummary, options: SweepOptions, *, json: bool) -> None:
    """Tell of one of several parts, while others are not done."""
    shard = f"{options.part[0]}/{options.part[1]}"
    if json:
        counts = {"images": sweep.images, "refused": sweep.refused}
        print_json({"out": str(out), "shard": shard, **counts})
    else:
        say(
            f"part {shard}: {sweep.images} follow-ups done, {sweep.refused} refused "
            f"({sweep.found_done} already done); the part that ends last writes the tables"
        )


def say_part_of_curves(shard: str, sweep: SweepSummary, done: str, *, json: bool) -> None:
    """Tell of one of several parts of photographs that were ``done``; curves come at the end."""
    if json:
        print_json({"out": None, "shard": shard, "images": sweep.images, "refused": sweep.refused})
    else:
        say(
            f"part {shard}: {sweep.images} photographs {done} ({sweep.found_done} already done); "
            "the same command without --shard writes the curves once all parts are done"
        )


def report_refused(sweep: SweepSummary, given: str) -> None:
    """End with the number of refused follow-ups, if there are any; ``given`` is of the others."""
    images = sweep.images + sweep.refused
    is_cut = sweep.refused > len(sweep.refused_lines)
    listed = f" ({sweep.refused_list} lists them)" if is_cut else ""
    end_refused(sweep, f"{sweep.refused} of {images} follow-ups gave nothing{listed}; {given}")


def end_refused(sweep: SweepSummary, sentence: str) -> None:
    """End with a sentence on the refused photographs, if there are any.

    Raises
    ------
    ApplicationError
        If a photograph was refused; it says why, and remarks say it for the first of several.
    """
    if sweep.refused == 1:
        raise ApplicationError(f"{sweep.refused_lines[0]}; {sentence}")
    note(*sweep.refused_lines)
    if sweep.refused:
        raise ApplicationError(sentence)
