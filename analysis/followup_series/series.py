"""Runs a series of follow-ups on the sweep engine, and writes its tables."""

import json
from collections.abc import Callable
from dataclasses import dataclass
from heapq import nlargest
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any, Generic, TypeVar

from acquisition.dataframe import dataframe
from analysis.followup_series.rows import CommittedRows, Row, is_refused
from analysis.followup_series.tables import write_csv, write_summary
from analysis.followup_series.work import FollowupWork
from analysis.parquet_table import column_kinds, require_parquet, write_parquet
from analysis.results_file import ResultsDocument, StoredValues
from analysis.sweep import Manifest, SweepCall, SweepOptions, SweepSummary, announced_sweep
from simulation.notebook import Shown

if TYPE_CHECKING:
    from pandas import DataFrame

SUMMARY_NAME = "summary.json"
_SHOWN_WHOLE, _SHOWN_OF_MANY = 20, 5

Listed = TypeVar("Listed", bound=StoredValues)
Document = TypeVar("Document", bound=ResultsDocument)


@dataclass(frozen=True, slots=True, kw_only=True, repr=False)
class SeriesResult(Shown, Generic[Document, Listed]):
    """What a series gave.

    Parameters
    ----------
    sweep
        Counts of this run and of earlier ones, for its part.
    summary
        Where the whole is written.
    document
        The summary without its follow-ups; None while other parts are not done.
    first, worst
        Every follow-up and none, or, of many, the first and the worst few.
    """

    sweep: SweepSummary
    summary: Path
    document: Document | None = None
    first: tuple[Listed, ...] = ()
    worst: tuple[Listed, ...] = ()
    notes: tuple[str, ...] = ()

    def to_dataframe(self) -> "DataFrame":
        """Return the follow-ups as a pandas table, a line each.

        Raises
        ------
        PandasMissingError
            If pandas is not installed.
        """
        return dataframe(self.to_json()["followups"])

    def to_json(self) -> dict[str, Any]:
        """Return the whole summary, as ``--json`` prints it; it must fit into memory."""
        summary: dict[str, Any] = json.loads(self.summary.read_bytes())
        return summary


@dataclass(frozen=True, slots=True, kw_only=True)
class SeriesTables(Generic[Document, Listed]):
    """How a series is told: table, order of the worst lines, document, other files and writer.

    ``out`` is the folder that they are written to. The table has a column for each value of
    a line but those ``left_out``; with ``has_parquet`` it is written as Parquet as well.
    """

    out: Path
    table: str
    listed: Callable[[Row], Listed]
    badness: Callable[[Row], float]
    document: Callable[[CommittedRows], Document]
    left_out: tuple[str, ...] = ()
    others: tuple[str, ...] = ()
    has_parquet: bool = False
    finish: Callable[[CommittedRows, Document], None] = lambda rows, document: None


def run_series(
    call: SweepCall,
    work: FollowupWork[Any, Any],
    manifest: Manifest,
    tables: SeriesTables[Document, Listed],
    options: SweepOptions | None,
) -> SeriesResult[Document, Listed]:
    """Do the follow-ups that lack a commit and, once all are done, write the tables.

    Raises
    ------
    SweepError
        If no worker is fit, or, when strict, a follow-up is refused.
    ResultsFileError
        If results cannot be written.
    """
    out = tables.out
    summary = out / SUMMARY_NAME
    if tables.has_parquet:
        require_parquet()
    parquet = (out / tables.table).with_suffix(".parquet")
    for path in (summary, out / tables.table, parquet, *map(out.joinpath, tables.others)):
        path.unlink(missing_ok=True)  # of before: there is none until all are done
    sweep = announced_sweep(call, "follow-ups", manifest, work, options)
    with CommittedRows(work, manifest) as rows:
        if not rows.is_whole:
            return SeriesResult(sweep=sweep, summary=summary)
        document = tables.document(rows)
        tables.finish(rows, document)
        columns = [name for name in work.listed.model_fields if name not in tables.left_out]
        write_csv(out / tables.table, columns, rows)
        if tables.has_parquet:
            kinds = column_kinds(work.listed, columns)
            write_parquet(parquet, kinds, rows)
        write_summary(summary, document, rows)
        first, worst = list(islice(rows, _SHOWN_WHOLE + 1)), []
        if len(first) > _SHOWN_WHOLE:
            given = (row for row in rows if not is_refused(row))
            first, worst = first[:_SHOWN_OF_MANY], nlargest(_SHOWN_OF_MANY, given, tables.badness)
    return SeriesResult(
        sweep=sweep,
        summary=summary,
        document=document,
        first=tuple(map(tables.listed, first)),
        worst=tuple(map(tables.listed, worst)),
    )
