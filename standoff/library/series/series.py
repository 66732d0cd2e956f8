"""Runs a series of follow-ups on the sweep engine, and writes its tables."""

import json
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from heapq import nlargest
from itertools import chain, islice
from os import PathLike
from pathlib import Path
from typing import Any, Generic, TypeVar

from analysis.change_series import ChangesSeries, ComparedFollowup
from analysis.choices import FALSE_ALARMS, Criterion
from analysis.detectability import CurveChoice
from analysis.pose import JudgedFollowup, PoseSeries
from analysis.results_file import ResultsDocument, StoredValues
from analysis.sweep import Manifest, SweepOptions, SweepSummary, run_sweep
from simulation.choices import PsfShape
from standoff.errors import ApplicationError
from standoff.library.call import Call, Progress
from standoff.library.comparison import (
    AlignmentHints,
    RegistrationHints,
    comparison_rules,
    hint_files,
)
from standoff.library.detectability import CurveLike, given_curve
from standoff.library.files import each_image
from standoff.library.inputs import FilePath, NoiseLike, PsfLike, path_of
from standoff.library.psf import psf_and_field
from standoff.library.series.change_work import ChangeWork
from standoff.library.series.folder_names import FolderNames
from standoff.library.series.pose_work import PoseDemand, PoseWork, registration_psf
from standoff.library.series.references import (
    OneReference,
    ReferenceFolder,
    References,
    pair_by_stem,
)
from standoff.library.series.rows import CommittedRows, Row
from standoff.library.series.tables import write_csv, write_summary
from standoff.library.series.time_line import (
    PAGE_NAME,
    TIME_LINE_NAME,
    write_series_page,
)
from standoff.library.series.work import STATE_NAME, FollowupWork
from standoff.photographs import ReadOptions

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
class _Series:
    """The call at work, where the results go, and who works."""

    call: Call
    out: Path
    sweep: SweepOptions


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
    notes: tuple[str, ...] = ()

    def to_json(self) -> dict[str, Any]:
        """Return the whole summary, as ``--json`` prints it; it must fit into memory."""
        summary: dict[str, Any] = json.loads(self.summary.read_bytes())
        return summary


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
    reference: FilePath,
    followups: FilePath | Iterable[FilePath],
    out: FilePath,
    psf: PsfLike | None = None,
    *,
    transfer: PsfShape = "best",
    noise: NoiseLike | None = None,
    false_alarms: float = FALSE_ALARMS,
    false_discovery_rate: float | None = None,
    hints: AlignmentHints | RegistrationHints | None = None,
    white_level: float | None = None,
    report: FilePath | None = None,
    sweep: SweepOptions | None = None,
    reading: ReadOptions | None = None,
    progress: Progress | None = None,
) -> SeriesResult[ChangesSeries, ComparedFollowup]:
    """Compare follow-ups with their references; each gets a folder, all of them a table.

    Follow-ups of one reference get a time line, ``series.json``, and a page on all of them. The
    same call resumes.

    Parameters
    ----------
    reference
        The reference, or a folder of references, one for each follow-up of its stem.
    followups
        Files and folders; of a folder the reference itself is left out. Of pairs, one folder.
    out
        Folder for the results.
    psf, transfer, noise, false_alarms, false_discovery_rate, hints, white_level
        As in ``find_changes``.
    report
        Where the page goes, besides the folder.
    sweep
        Who works, and on what part; by default this process, on all.
    reading, progress
        As in ``find_changes``.

    Raises
    ------
    ApplicationError, CalibrationError
        If reference or PSF cannot be read, or results not be written.
    SweepError
        If no worker is fit, or, when strict, a follow-up is refused.

    Examples
    --------
    >>> found = standoff.find_changes_of_series("before.tif", "after", "changes")
    >>> found.document.changed
    """
    call = Call("find_changes_of_series", progress, reading, (psf, noise, *hint_files(hints)))
    rules = comparison_rules(noise, false_alarms, false_discovery_rate, hints, white_level)
    series = _Series(call=call, out=path_of(out, "out"), sweep=sweep or SweepOptions())
    first, given = path_of(reference, "reference"), _listed(followups)
    page = None if report is None else path_of(report, "report")
    known, field = (None, None) if psf is None else psf_and_field(call, psf, "matched", transfer)
    references: References
    unpaired: tuple[str, ...] = ()
    if first.is_dir():
        _refuse_pairs(first, given)
        paired = pair_by_stem(first, given[0])
        unpaired, named = paired.unpaired, iter(paired.followups)
        references = ReferenceFolder.at(first, call.inputs.options)
    else:
        references = OneReference.read(first, call.inputs)
        named = _followups(given, references)
    with Manifest(named, series.out / STATE_NAME) as manifest:
        work = ChangeWork(
            out=_absolute(series.out),
            references=references,
            provenance=call.provenance(),
            psf=known,
            field=field,
            rules=rules,
            shape=transfer,
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
            finish=lambda rows, document: write_series_page(
                call, series.out, page, document, rows, references.shared_dn
            ),
        )
        return _swept(series, work, manifest, tables)


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
    sweep: SweepOptions | None = None,
    reading: ReadOptions | None = None,
    progress: Progress | None = None,
) -> SeriesResult[PoseSeries, JudgedFollowup]:
    """Judge the poses of follow-ups; all get a table. The same call resumes.

    Parameters
    ----------
    reference
        The earlier, nearer photograph.
    followups
        Files and folders; of a folder the reference itself is left out.
    out
        Folder for the results.
    curve, min_d_prime, choice, criterion, psf, hints
        As in ``judge_pose``.
    sweep
        Who works, and on what part; by default this process, on all.
    reading, progress
        As in ``judge_pose``.

    Raises
    ------
    ApplicationError
        If the reference cannot be read, or results not be written.
    SweepError
        If no worker is fit, or, when strict, a follow-up is refused.

    Examples
    --------
    >>> standoff.judge_poses("before.tif", "after", "poses", "curves.json", 2).document.accepted
    """
    call = Call("judge_poses", progress, reading, (curve, psf, *hint_files(hints)))
    demand = PoseDemand(
        curve=given_curve(curve, min_d_prime, choice),
        min_d_prime=min_d_prime,
        criterion=criterion,
        psf=registration_psf(call, psf),
        hints=hints,
    )
    series = _Series(call=call, out=path_of(out, "out"), sweep=sweep or SweepOptions())
    near = OneReference.read(path_of(reference, "reference"), call.inputs)
    followed = _followups(_listed(followups), near)
    with Manifest(followed, series.out / STATE_NAME) as manifest:
        work = PoseWork(
            out=_absolute(series.out),
            references=near,
            provenance=call.provenance(),
            demand=demand,
        )

        def document(rows: CommittedRows) -> PoseSeries:
            return PoseSeries(
                reference=near.name,
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
        return _swept(series, work, manifest, tables)


def _swept(
    series: _Series,
    work: FollowupWork[Any],
    manifest: Manifest,
    tables: _Tables[Document, Listed],
) -> SeriesResult[Document, Listed]:
    call, out = series.call, series.out
    summary = out / SUMMARY_NAME
    for path in (summary, out / tables.table, *map(out.joinpath, tables.others)):
        path.unlink(missing_ok=True)  # of before: there is none until all are done
    with call.bar("follow-ups", len(manifest)) as advance_to:
        sweep = run_sweep(manifest, work, series.sweep, advance_to)
    for sentence in sweep.notes:
        call.announce(sentence)
    with CommittedRows(work, manifest) as rows:
        if not rows.is_whole:
            return SeriesResult(sweep=sweep, summary=summary, notes=call.notes)
        document = tables.document(rows)
        tables.finish(rows, document)
        write_csv(out / tables.table, tables.columns, rows)
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
        notes=call.notes,
    )


def _listed(followups: FilePath | Iterable[FilePath]) -> tuple[Path, ...]:
    listed = [followups] if isinstance(followups, str | PathLike) else followups
    return tuple(path_of(one, "followups") for one in listed)


def _refuse_pairs(references: Path, followups: tuple[Path, ...]) -> None:
    """Check that a folder of references comes with a folder of follow-ups, another one."""
    if len(followups) != 1 or not followups[0].is_dir():
        raise ApplicationError(
            f"{references} is a folder of references, paired by name with one folder of "
            "follow-ups; give that, or one photograph as the reference"
        )
    if followups[0].resolve() == references.resolve():
        raise ApplicationError(
            f"{references} is given as both folders: nothing is compared with itself"
        )


def _followups(given: tuple[Path, ...], reference: OneReference) -> Iterator[Path]:
    named = (path for path in given if not path.is_dir())
    inside = each_image(path for path in given if path.is_dir())
    others = (path for path in inside if _absolute(path) != reference.path)
    return chain(named, others)


def _absolute(path: Path) -> Path:
    return Path(os.path.abspath(path))  # noqa: PTH100  resolve() follows links


def _is_refused(row: Row) -> bool:
    return row["refused"] is not None
