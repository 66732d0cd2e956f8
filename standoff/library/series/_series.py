"""Comparison of many follow-ups with their references, and verdicts on their poses."""

import os
from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path
from typing import Unpack

from acquisition.files import PAGES, write_file, write_page
from acquisition.photographs import ReadOptions, each_image, is_folder
from analysis.change_series import ChangesSeries, ComparedFollowup, time_line_of
from analysis.choices import Criterion
from analysis.detectability import CurveChoice
from analysis.followup_series import (
    STATE_NAME,
    SUMMARY_NAME,
    FolderNames,
    FollowupRows,
    References,
    SeriesResult as SeriesResult,
    SeriesTables,
    is_refused,
    run_series,
)
from analysis.pose import JudgedFollowup, PoseSeries
from analysis.reports import series_report
from analysis.results_file import write_results
from analysis.sweep import Manifest, Row, SweepOptions
from calibration.registration import RegistrationHints
from simulation.arguments import FilePath, checked, output_path, path_of
from simulation.arrays import AnyArray
from standoff.errors import ApplicationError
from standoff.library.call import Call, Progress, PsfLike, listed_paths, with_keywords_of
from standoff.library.changes import ComparisonKeywords, begun_comparison, find_changes
from standoff.library.detectability import CurveLike, given_curve
from standoff.library.psf import psf_and_field
from standoff.library.registration import AlignmentHints, hint_files
from standoff.library.series._change_work import ChangeWork
from standoff.library.series._pose_work import PoseDemand, PoseWork, registration_psf
from standoff.library.series._references import OneReference, ReferenceFolder, pair_by_stem

TIME_LINE_NAME, PAGE_NAME = "series.json", "report.html"
CHANGES_TABLE, POSES_TABLE = "changes.csv", "poses.csv"
FILES_OF_SERIES = (SUMMARY_NAME, CHANGES_TABLE, TIME_LINE_NAME, PAGE_NAME)
"""Written at the end, in the folder that holds those of the follow-ups."""

FILES_OF_POSE_SERIES = (SUMMARY_NAME, POSES_TABLE)
"""The same, where poses are judged."""

_TIME_LINE_MOST = 500
"""Follow-ups of a time line: it says something of every track in every follow-up."""

_ON_PAGE_MOST = 1000


def holds_series(out: Path, table: str) -> bool:
    """Whether a folder holds a series with this table, which a run would continue."""
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
    folders = [path for path in paths if is_folder(path)]
    for folder in folders:
        next(iter(each_image([folder])))
    return len(paths) > 1 or bool(folders)


@checked
@with_keywords_of(find_changes)
def find_changes_of_series(
    reference: FilePath,
    followups: FilePath | Iterable[FilePath],
    out: FilePath,
    psf: PsfLike | None = None,
    *,
    report: FilePath | None = None,
    parquet: bool = False,
    sweep: SweepOptions | None = None,
    **how: Unpack[ComparisonKeywords],
) -> SeriesResult[ChangesSeries, ComparedFollowup]:
    """Compare follow-ups with their references: a folder for each follow-up, one table for all.

    A report page shows all of them. Up to 500 follow-ups of one reference also get a time line,
    ``series.json``. The same call resumes an interrupted run.

    Parameters
    ----------
    reference
        The reference, or a folder that holds, for each follow-up, a reference with the same file
        stem.
    followups
        Files and folders of follow-ups; if a folder contains the reference, it is left out there.
        With a folder of references, exactly one folder.
    out
        Folder for the results.
    psf
        As in ``find_changes``.
    report
        Path of a second copy of the report page, besides the one in ``out``.
    parquet
        Whether the table is also written as Parquet, which needs pyarrow.
    sweep
        Number of worker processes, and which part of the work to do, see `SweepOptions`; by
        default this process does all of it.
    how
        As in ``find_changes``.

    Returns
    -------
    SeriesResult
        ``document`` holds the counts; it is None until all parts of the work are done.

    Raises
    ------
    ApplicationError, CalibrationError
        If a reference or the PSF cannot be read.
    ApplicationError, ResultsFileError
        If results cannot be written.
    SweepError
        If no usable worker is available, or, with ``strict``, a follow-up cannot be used.

    Examples
    --------
    >>> found = standoff.find_changes_of_series("before.tif", "after", "changes", "psf.json")
    >>> found.document.changed
    1
    """
    call, rules = begun_comparison("find_changes_of_series", psf, how)
    transfer = how.get("transfer", "best")
    folder, first = path_of(out, "out"), path_of(reference, "reference")
    given = tuple(listed_paths(followups, "followups"))
    page = None if report is None else output_path(report, "report", PAGES)
    known, field = (None, None) if psf is None else psf_and_field(call, psf, "matched", transfer)
    references: References
    shared: OneReference | None = None
    unpaired: tuple[str, ...] = ()
    if first.is_dir():
        paired = pair_by_stem(_folder_of_pairs(first, given), given[0])
        unpaired, named = paired.unpaired, iter(paired.followups)
        references = ReferenceFolder.at(first, call.inputs.options)
    else:
        references = shared = OneReference.read(first, call.inputs)
        named = _followups(given, shared)
    with Manifest(named, folder / STATE_NAME) as manifest:
        work = ChangeWork(
            out=_absolute(folder),
            references=references,
            provenance=call.provenance(),
            psf=known,
            field=field,
            rules=rules,
            shape=transfer,
            names=FolderNames.of(manifest, (STATE_NAME, *FILES_OF_SERIES)),
        )

        def document(rows: FollowupRows) -> ChangesSeries:
            refused = rows.count(is_refused)
            return ChangesSeries(
                reference=references.name,
                compared=len(manifest) - refused,
                changed=rows.count(lambda row: bool(row["changed_px"])),
                refused=refused,
                unpaired=unpaired,
                provenance=work.provenance,
            )

        tables = SeriesTables(
            out=folder,
            table=CHANGES_TABLE,
            listed=ComparedFollowup.model_validate,
            badness=lambda row: row["changed_px"],
            document=document,
            has_parquet=parquet,
            others=(TIME_LINE_NAME, PAGE_NAME),
            finish=lambda rows, document: _write_pages(
                call, (folder, page), document, rows, None if shared is None else shared.shown_dn
            ),
        )
        return replace(run_series(call, work, manifest, tables, sweep), notes=call.notes)


@checked
def judge_poses(
    reference: FilePath,
    followups: FilePath | Iterable[FilePath],
    out: FilePath,
    curve: CurveLike,
    min_d_prime: float,
    *,
    choice: CurveChoice | None = None,
    criterion: Criterion = "min",
    psf: PsfLike | None = None,
    hints: AlignmentHints | RegistrationHints | None = None,
    focus_scatter_px2: float | None = None,
    parquet: bool = False,
    sweep: SweepOptions | None = None,
    reading: ReadOptions | None = None,
    progress: Progress | None = None,
) -> SeriesResult[PoseSeries, JudgedFollowup]:
    """Judge the poses of follow-ups and write a table of the verdicts.

    The same call resumes an interrupted run.

    Parameters
    ----------
    reference
        The earlier, nearer photograph.
    followups
        Files and folders of follow-ups; if a folder contains the reference, it is left out there.
    out
        Folder for the results.
    curve, min_d_prime, choice, criterion, psf, hints, focus_scatter_px2
        As in ``judge_pose``.
    parquet
        Whether the table is also written as Parquet, which needs pyarrow.
    sweep
        Number of worker processes, and which part of the work to do, see `SweepOptions`; by
        default this process does all of it.
    reading, progress
        As in ``judge_pose``.

    Returns
    -------
    SeriesResult
        As ``find_changes_of_series`` returns it, with a verdict for each follow-up.

    Raises
    ------
    ApplicationError, ResultsFileError
        If the reference cannot be read, or results cannot be written.
    SweepError
        If no usable worker is available, or, with ``strict``, a follow-up cannot be used.

    Examples
    --------
    >>> judged = standoff.judge_poses("before.tif", "after", "poses", "curves.json", 2)
    >>> judged.document.accepted
    2
    """
    call = Call("judge_poses", progress, reading, (curve, psf, *hint_files(hints)))
    demand = PoseDemand(
        curve=given_curve(curve, min_d_prime, choice, focus_scatter_px2),
        min_d_prime=min_d_prime,
        criterion=criterion,
        psf=registration_psf(call, psf),
        hints=hints,
    )
    folder = path_of(out, "out")
    near = OneReference.read(path_of(reference, "reference"), call.inputs)
    followed = _followups(tuple(listed_paths(followups, "followups")), near)
    with Manifest(followed, folder / STATE_NAME) as manifest:
        work = PoseWork(
            out=_absolute(folder),
            references=near,
            provenance=call.provenance(),
            demand=demand,
        )

        def document(rows: FollowupRows) -> PoseSeries:
            return PoseSeries(
                reference=near.name,
                criterion=demand.criterion,
                min_dprime=demand.min_d_prime,
                curve=demand.curve.choice,
                accepted=rows.count(lambda row: row["is_accepted"] is True),
                rejected=rows.count(lambda row: row["is_accepted"] is False),
                unsure=rows.count(lambda row: row.get("verdict") == "unsure"),
                refused=rows.count(is_refused),
                provenance=work.provenance,
            )

        tables = SeriesTables(
            out=folder,
            table=POSES_TABLE,
            left_out=("homography",),
            listed=JudgedFollowup.model_validate,
            badness=lambda row: -row["dprime_decisive"],
            document=document,
            has_parquet=parquet,
        )
        return replace(run_series(call, work, manifest, tables, sweep), notes=call.notes)


def _write_pages(
    call: Call,
    where: tuple[Path, Path | None],
    series: ChangesSeries,
    rows: Iterable[Row],
    reference_dn: AnyArray | None,
) -> None:
    """Write the time line of the changes, if they have one reference, and a page on all.

    ``where`` is the folder that holds the follow-ups' own, and where the page goes, too.
    """
    out, report = where
    listed = [ComparedFollowup.model_validate(row) for row in islice(rows, _ON_PAGE_MOST)]
    line = None
    if reference_dn is not None and series.compared <= _TIME_LINE_MOST:
        line = time_line_of(out, series, rows, reference_dn.shape[:2])
        write_results(out / TIME_LINE_NAME, line)
    elif reference_dn is not None:
        call.note(
            f"no time line for more than {_TIME_LINE_MOST} follow-ups; each has its changes.json"
        )
    page = series_report(series, listed, line, reference_dn).html()
    write_file(out / PAGE_NAME, page.encode("utf-8"))
    if report is not None:
        write_page(report, page)


def _folder_of_pairs(references: Path, followups: tuple[Path, ...]) -> Path:
    """Check that a folder of references comes with a folder of follow-ups, another one."""
    if len(followups) != 1 or not is_folder(followups[0]):
        raise ApplicationError(
            f"{references} is a folder of references, paired by name with one folder of "
            "follow-ups; give that, or one photograph as the reference"
        )
    if followups[0].resolve() == references.resolve():
        raise ApplicationError(
            f"{references} is given as both folders: give two different ones, or, for a series of "
            "photographs in one folder, the earliest of them and the folder"
        )
    return references


def _followups(given: tuple[Path, ...], reference: OneReference) -> Iterator[Path]:
    named = (path for path in given if not is_folder(path))
    inside = each_image(path for path in given if is_folder(path))
    others = (path for path in inside if _absolute(path) != reference.path)
    return chain(named, others)


def _absolute(path: Path) -> Path:
    return Path(os.path.abspath(path))  # noqa: PTH100  resolve() follows links
