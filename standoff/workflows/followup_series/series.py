"""Runs a series of follow-ups on the sweep engine, and writes its tables."""

import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from heapq import nlargest
from itertools import chain, islice
from pathlib import Path
from typing import Any, Generic, TypeVar

from analysis.change_series import ChangesSeries, ComparedFollowup
from analysis.pose import JudgedFollowup, PoseSeries
from analysis.results_file import ResultsDocument, StoredValues
from analysis.sweep import Manifest, SweepOptions, SweepSummary, run_sweep
from standoff.photographs import Inputs
from standoff.terminal import command_line, progress_bar
from standoff.workflows.comparison import ComparisonRequest
from standoff.workflows.followup_series.change_work import ChangeWork
from standoff.workflows.followup_series.folder_names import FolderNames
from standoff.workflows.followup_series.pose_work import PoseDemand, PoseWork
from standoff.workflows.followup_series.references import (
    OneReference,
    ReferenceFolder,
    References,
    pair_by_stem,
)
from standoff.workflows.followup_series.rows import CommittedRows, Row
from standoff.workflows.followup_series.tables import write_csv, write_summary
from standoff.workflows.followup_series.time_line import (
    PAGE_NAME,
    TIME_LINE_NAME,
    write_series_page,
)
from standoff.workflows.followup_series.work import STATE_NAME, FollowupWork
from standoff.workflows.image_files import each_image
from standoff.workflows.psf_files import psf_and_field

SUMMARY_NAME = "summary.json"
CHANGES_TABLE, POSES_TABLE = "changes.csv", "poses.csv"
FILES_OF_SERIES = (SUMMARY_NAME, CHANGES_TABLE, TIME_LINE_NAME, PAGE_NAME)
"""Written at the end, in the folder that holds those of the follow-ups."""

FILES_OF_POSE_SERIES = (SUMMARY_NAME, POSES_TABLE)
"""The same, where poses are judged."""

_SHOWN_WHOLE, _SHOWN_OF_MANY = 20, 5

Listed = TypeVar("Listed", bound=StoredValues)
Document = TypeVar("Document", bound=ResultsDocument)


@dataclass(frozen=True, slots=True, kw_only=True)
class SeriesRequest:
    """What is compared with what, where the results go, and who works.

    Parameters
    ----------
    reference
        The reference, or a folder of references, one for each follow-up of its stem.
    followups
        Files and folders; of a folder the reference itself is left out. Of pairs, one folder.
    out
        Folder for the results.
    inputs
        Reads the photographs; the PSF, noise or curves are listed already.
    sweep
        Who works, and on what part.
    report
        Where the report goes, besides the folder.
    """

    reference: Path
    followups: tuple[Path, ...]
    out: Path
    inputs: Inputs
    sweep: SweepOptions
    report: Path | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class SeriesResult(Generic[Document, Listed]):
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


@dataclass(frozen=True, slots=True, kw_only=True)
class _Tables(Generic[Document, Listed]):
    """How a series is told: table, order of the worst lines, document, other files and writer."""

    table: str
    columns: tuple[str, ...]
    listed: Callable[[Row], Listed]
    badness: Callable[[Row], float]
    document: Callable[[CommittedRows], Document]
    others: tuple[str, ...] = ()
    finish: Callable[[CommittedRows, Document], None] = lambda rows, document: None


def holds_series(out: Path, table: str) -> bool:
    """Whether a folder holds a series of the kind of ``table``, which a run goes on with."""
    others = {CHANGES_TABLE, POSES_TABLE} - {table}
    return (out / STATE_NAME).is_dir() and not any((out / other).exists() for other in others)


def is_series(followups: Iterable[Path]) -> bool:
    """Whether follow-ups are several, or a folder of them.

    Raises
    ------
    ApplicationError
        If a folder holds no image, or cannot be read.
    """
    paths = list(followups)
    folders = [path for path in paths if path.is_dir()]
    for folder in folders:
        next(iter(each_image([folder])))
    return len(paths) > 1 or bool(folders)


def find_changes_of_series(
    request: SeriesRequest, comparison: ComparisonRequest
) -> SeriesResult[ChangesSeries, ComparedFollowup]:
    """Compare follow-ups with their references; each gets a folder, all of them a table.

    Follow-ups of one reference get a time line, ``series.json``, and a page on all of them.

    Raises
    ------
    ApplicationError, CalibrationError
        If reference or PSF cannot be read, or results not be written.
    SweepError
        If no worker is fit, or, when strict, a follow-up is refused.
    """
    psf, field = None, None
    if comparison.psf is not None:
        psf, field = psf_and_field(comparison.psf, "matched", comparison.transfer)
    references: References
    unpaired: tuple[str, ...] = ()
    if request.reference.is_dir():
        paired = pair_by_stem(request.reference, request.followups[0])
        unpaired, followups = paired.unpaired, iter(paired.followups)
        references = ReferenceFolder.at(request.reference, request.inputs.options)
    else:
        references = OneReference.read(request.reference, request.inputs)
        followups = _followups(request, references)
    with Manifest(followups, request.out / STATE_NAME) as manifest:
        work = ChangeWork(
            out=_absolute(request.out),
            references=references,
            provenance=request.inputs.provenance(command_line()),
            psf=psf,
            field=field,
            request=comparison,
            names=FolderNames.of(manifest, (STATE_NAME, *FILES_OF_SERIES)),
        )

        def document(rows: CommittedRows) -> ChangesSeries:
            refused = rows.count(_is_refused)
            return ChangesSeries(
                reference=references.name,
                compared=len(manifest) - refused,
                changed=rows.count(lambda row: bool(row["changed_px"])),
                refused=refused,
                unpaired=unpaired,
                provenance=work.provenance,
            )

        tables = _Tables(
            table=CHANGES_TABLE,
            columns=tuple(ComparedFollowup.model_fields),
            listed=ComparedFollowup.model_validate,
            badness=lambda row: row["changed_px"],
            document=document,
            others=(TIME_LINE_NAME, PAGE_NAME),
            finish=lambda rows, series: write_series_page(
                request.out, request.report, series, rows, references.shared_dn
            ),
        )
        return _series(work, manifest, request, tables)


def judge_series(
    request: SeriesRequest, demand: PoseDemand
) -> SeriesResult[PoseSeries, JudgedFollowup]:
    """Judge the poses of follow-ups; all get a table.

    Raises
    ------
    ApplicationError
        If the reference cannot be read, or results not be written.
    SweepError
        If no worker is fit, or, when strict, a follow-up is refused.
    """
    reference = OneReference.read(request.reference, request.inputs)
    with Manifest(_followups(request, reference), request.out / STATE_NAME) as manifest:
        work = PoseWork(
            out=_absolute(request.out),
            references=reference,
            provenance=request.inputs.provenance(command_line()),
            demand=demand,
        )

        def document(rows: CommittedRows) -> PoseSeries:
            return PoseSeries(
                reference=reference.name,
                criterion=demand.criterion,
                min_dprime=demand.min_d_prime,
                curve=demand.curve.choice,
                accepted=rows.count(lambda row: row["is_accepted"] is True),
                rejected=rows.count(lambda row: row["is_accepted"] is False),
                refused=rows.count(_is_refused),
                provenance=work.provenance,
            )

        tables = _Tables(
            table=POSES_TABLE,
            columns=tuple(name for name in JudgedFollowup.model_fields if name != "homography"),
            listed=JudgedFollowup.model_validate,
            badness=lambda row: -row["dprime_decisive"],
            document=document,
        )
        return _series(work, manifest, request, tables)


def _series(
    work: FollowupWork[Any],
    manifest: Manifest,
    request: SeriesRequest,
    tables: _Tables[Document, Listed],
) -> SeriesResult[Document, Listed]:
    summary = request.out / SUMMARY_NAME
    for path in (summary, request.out / tables.table, *map(request.out.joinpath, tables.others)):
        path.unlink(missing_ok=True)  # of before: there is none until all are done
    with progress_bar("follow-ups", len(manifest)) as bar:
        sweep = run_sweep(manifest, work, request.sweep, bar.advance_to)
    for sentence in sweep.notes:
        request.inputs.announce(sentence)
    with CommittedRows(work, manifest) as rows:
        if not rows.is_whole:
            return SeriesResult(sweep=sweep, summary=summary)
        document = tables.document(rows)
        tables.finish(rows, document)
        write_csv(request.out / tables.table, tables.columns, rows)
        write_summary(summary, document, rows)
        first, worst = list(islice(rows, _SHOWN_WHOLE + 1)), []
        if len(first) > _SHOWN_WHOLE:
            given = (row for row in rows if not _is_refused(row))
            first, worst = first[:_SHOWN_OF_MANY], nlargest(_SHOWN_OF_MANY, given, tables.badness)
    return SeriesResult(
        sweep=sweep,
        summary=summary,
        document=document,
        first=tuple(map(tables.listed, first)),
        worst=tuple(map(tables.listed, worst)),
    )


def _followups(request: SeriesRequest, reference: OneReference) -> Iterator[Path]:
    named = (path for path in request.followups if not path.is_dir())
    inside = each_image(path for path in request.followups if path.is_dir())
    others = (path for path in inside if _absolute(path) != reference.path)
    return chain(named, others)


def _absolute(path: Path) -> Path:
    return Path(os.path.abspath(path))  # noqa: PTH100  resolve() follows links


def _is_refused(row: Row) -> bool:
    return row["refused"] is not None
