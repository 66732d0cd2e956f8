"""``standoff changes``: differences between photographs that their poses do not explain."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from analysis.choices import FALSE_ALARMS
from standoff.errors import ApplicationError
from standoff.terminal import (
    HINT_RULES,
    EncodingName,
    ExpectZoom,
    Force,
    Json,
    Mask,
    Mean,
    Page,
    PartOfShards,
    Points,
    PoseHint,
    Scheduler,
    Strict,
    TransferForm,
    Workers,
    check_options,
    command_line,
    excludes,
    needs,
    note,
    note_at_end,
    photograph_inputs,
    print_few,
    print_json,
    print_json_file,
    print_table,
    refuse_overwriting,
    refuse_suffix,
    refuse_sweep_of_one,
    report_refused,
    say,
    say_part,
    sweep_options,
)

if TYPE_CHECKING:
    from analysis.change_series import ChangesSeries, ComparedFollowup
    from analysis.changes import Change, ChangeSummary
    from standoff.workflows import ComparisonRequest, SeriesRequest, SeriesResult

_RULES = (
    *HINT_RULES,
    needs("transfer", "psf"),
    excludes("false_discovery_rate", "false_alarms", because="either decides the threshold"),
)
_SHOWN_WHOLE, _SHOWN_OF_MANY = 20, 10
_NORMAL_95 = 1.96
_UNPAIRED_SHOWN = 5


def changes(
    context: typer.Context,
    reference: Annotated[
        Path, typer.Argument(help="The earlier photograph, or a folder of them: pairs by name.")
    ],
    followup: Annotated[
        list[Path],
        typer.Argument(
            help="The later photograph, from nearer or further away. Of several, or a folder of "
            "them, each gets a folder.",
            show_default=False,
        ),
    ],
    *,
    out: Annotated[Path, typer.Option(help="Folder for the results; a series is resumed.")],
    psf: Annotated[
        Path | None,
        typer.Option(help="psf.json of the camera; the blur is fitted to the pair by default."),
    ] = None,
    transfer: TransferForm = "best",
    noise: Annotated[
        Path | None, typer.Option(help="noise.json of the camera; the noise is fitted by default.")
    ] = None,
    expect_zoom: ExpectZoom = None,
    homography: PoseHint = None,
    points: Points = None,
    mask: Mask = None,
    white_level: Annotated[
        float | None,
        typer.Option(
            min=1e-6,
            metavar="N",
            help="Level of the files at which they are clipped; the file's own by default.",
        ),
    ] = None,
    false_alarms: Annotated[
        float, typer.Option(min=1e-6, max=1e4, help="Pixels flagged by chance per frame.")
    ] = FALSE_ALARMS,
    false_discovery_rate: Annotated[
        float | None,
        typer.Option(
            min=1e-6,
            max=0.5,
            metavar="R",
            help="Share of false ones among the listed changes, instead of --false-alarms.",
        ),
    ] = None,
    report: Annotated[
        Path | None,
        typer.Option(
            metavar="R.html",
            help="Also write the report here (HTML or PDF); report.html is always in the folder.",
        ),
    ] = None,
    workers: Workers = 1,
    scheduler: Scheduler = None,
    shard: PartOfShards = "1/1",
    strict: Strict = False,
    encoding: EncodingName = "auto",
    page: Page = None,
    mean: Mean = False,
    force: Force = False,
    json: Json = False,
) -> None:
    """Find what changed between two photographs that their poses do not explain.

    Without --psf the blur between them is fitted to the pair.
    """
    check_options(context, _RULES)
    refuse_suffix(report, "--report", {".html", ".htm", ".pdf"})
    inputs_given = [reference, *followup, psf, noise, homography, points, mask]
    refuse_overwriting([report], inputs_given, force=force)
    sweep = sweep_options(workers, scheduler, shard, is_strict=strict)
    _refuse_folder_of_references(reference, followup)
    from analysis.changes import ChangeOptions
    from calibration.files import read_noise
    from standoff.workflows import (
        CHANGE_FILES,
        CHANGES_TABLE,
        FILES_OF_SERIES,
        ComparisonRequest,
        HintFiles,
        SeriesRequest,
        find_changes_of_series,
        holds_series,
        is_series,
        read_hints,
        require_writable,
    )

    hints = HintFiles(zoom=expect_zoom, homography=homography, points=points, mask=mask)
    inputs = photograph_inputs(encoding, page, mean, files=(psf, noise, *hints.paths))
    require_writable([report])
    comparison = ComparisonRequest(
        psf=psf,
        transfer=transfer,
        options=ChangeOptions(
            noise=None if noise is None else read_noise(noise).capture_noise,
            false_alarms=false_alarms,
            false_discovery_rate=false_discovery_rate,
        ),
        hints=read_hints(hints),
        white_level=white_level,
    )
    request = SeriesRequest(
        reference=reference,
        followups=tuple(followup),
        out=out,
        inputs=inputs,
        sweep=sweep,
        report=report,
    )
    if reference.is_dir() or is_series(followup):
        if points is not None:
            raise typer.BadParameter("points are of one follow-up; give one", param_hint="--points")
        if not holds_series(out, CHANGES_TABLE):
            refuse_overwriting([out / name for name in FILES_OF_SERIES], force=force)
        _show_series(request, find_changes_of_series(request, comparison), json=json)
        return
    refuse_sweep_of_one(sweep)
    refuse_overwriting([out / name for name in CHANGE_FILES], inputs_given, force=force)
    _compare_one(request, comparison, json=json)


def _refuse_folder_of_references(reference: Path, followups: list[Path]) -> None:
    """Check that a folder of references comes with a folder of follow-ups, another one."""
    if not reference.is_dir():
        return
    if len(followups) != 1 or not followups[0].is_dir():
        raise ApplicationError(
            f"{reference} is a folder of references, paired by name with one folder of follow-ups; "
            "give that, or one photograph as the reference"
        )
    if followups[0].resolve() == reference.resolve():
        raise ApplicationError(
            f"{reference} is given as both folders: nothing is compared with itself"
        )


def _compare_one(request: SeriesRequest, comparison: ComparisonRequest, *, json: bool) -> None:
    from acquisition.printable import on_one_line
    from standoff.workflows import (
        find_changes_of_files,
        make_folder,
        write_changes,
        write_page,
        written_together,
    )

    inputs, followup = request.inputs, request.followups[0]
    pair = find_changes_of_files(request.reference, followup, comparison, inputs)
    make_folder(request.out)
    summary = pair.found.summary.model_copy(
        update={
            "reference": on_one_line(request.reference),
            "followup": on_one_line(followup),
            "provenance": inputs.provenance(command_line()),
        }
    )
    if request.report is not None:
        write_page(request.report, pair.page(summary))
    with written_together(request.out / "changes.json") as folder:
        write_changes(folder, pair, summary)
    _show_one(request.out, summary, json=json)


def _show_one(out: Path, summary: ChangeSummary, *, json: bool) -> None:
    from analysis.changes import describe_focus
    from calibration.documents import json_object

    for warning in summary.warnings:
        note_at_end(warning)
    if json:
        print_json({"out": str(out), **json_object(summary)})
        return
    if summary.changes:
        shown = _shown(summary.changes)
        print_table(
            _title(len(summary.changes), len(shown)),
            ["change", "x / px", "y / px", "area / px", "amplitude / DN", "significance", "q"],
            [_change_cells(number, change) for number, change in enumerate(shown, 1)],
        )
    say(
        f"{summary.changed_px} of {summary.compared_px} pixels changed by more than "
        f"{summary.threshold_sd:.2f} standard deviations (zoom {summary.zoom:.3f}); wrote {out}"
    )
    focus = describe_focus(summary)
    if focus is not None and summary.kernel != "both":  # of which a warning tells
        say(focus)


def _shown(changes: tuple[Change, ...]) -> tuple[Change, ...]:
    return changes if len(changes) <= _SHOWN_WHOLE else changes[:_SHOWN_OF_MANY]


def _title(count: int, shown: int) -> str:
    if shown < count:
        return f"The {shown} most significant of {count} changes"
    return "1 change" if count == 1 else f"{count} changes"


def _change_cells(number: int, change: Change) -> list[str]:
    from analysis.reports import q_text

    reach_dn = _NORMAL_95 * change.amplitude_err_dn
    return [
        str(number),
        f"{change.x_px:.1f}",
        f"{change.y_px:.1f}",
        f"{change.area_px:.0f}",
        f"{change.amplitude_dn:+.3g} ± {reach_dn:.2g}",
        f"{change.significance:.1f}",
        q_text(change.q_value),
    ]


def _show_series(
    request: SeriesRequest, found: SeriesResult[ChangesSeries, ComparedFollowup], *, json: bool
) -> None:
    document = found.document
    if document is not None and document.unpaired:
        note(_unpaired_sentence(document.unpaired))
    if document is None:
        say_part(request.out, found.sweep, request.sweep, json=json)
    elif json:
        print_json_file(found.summary)
    else:
        print_few(
            ("Follow-ups", "First follow-ups", "Follow-ups with the most changed pixels"),
            ["folder", "changes", "changed px", "compared px", "zoom"],
            _cells,
            found.first,
            found.worst,
        )
        say(
            f"{document.compared} follow-ups compared, {document.changed} with changed pixels "
            f"({found.sweep.found_done} already done); wrote {request.out}"
        )
    report_refused(found.sweep, "the results of the others are complete")


def _cells(one: ComparedFollowup) -> list[str]:
    if one.folder is None:
        return [Path(one.followup).name, "", "", "", "none"]
    counts = (one.changes, one.changed_px, one.compared_px)
    return [one.folder, *map(str, counts), f"{one.zoom:.3f}"]


def _unpaired_sentence(unpaired: tuple[str, ...]) -> str:
    listed = ", ".join(unpaired[:_UNPAIRED_SHOWN])
    more = ", ..." if len(unpaired) > _UNPAIRED_SHOWN else ""
    return (
        f"{len(unpaired)} photographs without a partner of their name, or with several: "
        f"{listed}{more}"
    )
