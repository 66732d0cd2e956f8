"""``standoff changes``: differences between photographs that their poses do not explain."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from analysis.choices import FALSE_ALARMS
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
    ShownProgress,
    Strict,
    TransferForm,
    Workers,
    check_options,
    excludes,
    needs,
    note,
    note_once,
    print_few,
    print_json,
    print_json_file,
    print_table,
    reading_options,
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
    from analysis.sweep import SweepOptions
    from standoff.library import SeriesResult

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
    from standoff.library import (
        CHANGE_FILES,
        CHANGES_TABLE,
        FILES_OF_SERIES,
        alignment_hints,
        find_changes,
        find_changes_of_series,
        holds_series,
        is_series,
        require_writable,
    )

    require_writable([report])
    how: dict[str, Any] = {
        "transfer": transfer,
        "noise": noise,
        "false_alarms": false_alarms,
        "false_discovery_rate": false_discovery_rate,
        "hints": alignment_hints(expect_zoom, homography=homography, points=points, mask=mask),
        "white_level": white_level,
        "reading": reading_options(encoding, page, mean),
        "progress": ShownProgress(),
    }
    if reference.is_dir() or is_series(followup):
        if points is not None:
            raise typer.BadParameter("points are of one follow-up; give one", param_hint="--points")
        if not holds_series(out, CHANGES_TABLE):
            refuse_overwriting([out / name for name in FILES_OF_SERIES], force=force)
        series = find_changes_of_series(
            reference,
            followup,
            out,
            psf,
            **how,
            report=report,
            sweep=sweep,
        )
        _show_series(out, series, sweep, json=json)
        return
    refuse_sweep_of_one(sweep)
    refuse_overwriting([out / name for name in CHANGE_FILES], inputs_given, force=force)
    found = find_changes(
        reference,
        followup[0],
        psf,
        **how,
    )
    if report is not None:
        found.write_report(report)
    found.write(out)
    note_once(found.notes)
    if json:
        print_json({"out": str(out), **found.to_json()})
        return
    _show_one(out, found.summary)


def _show_one(out: Path, summary: ChangeSummary) -> None:
    from analysis.changes import describe_focus

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
    out: Path,
    found: SeriesResult[ChangesSeries, ComparedFollowup],
    options: SweepOptions,
    *,
    json: bool,
) -> None:
    document = found.document
    if document is not None and document.unpaired:
        note(_unpaired_sentence(document.unpaired))
    note_once(found.notes)
    if document is None:
        say_part(out, found.sweep, options, json=json)
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
            f"({found.sweep.found_done} already done); wrote {out}"
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
