"""``standoff changes``: differences between photographs that their poses do not explain."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from analysis.choices import FALSE_ALARMS
from standoff.terminal import (
    EncodingName,
    Json,
    Mean,
    Page,
    PartOfShards,
    Scheduler,
    Strict,
    TransferForm,
    Workers,
    command_line,
    photograph_inputs,
    print_few,
    print_json,
    print_json_file,
    refuse_sweep_of_one,
    report_refused,
    say,
    say_part,
    sweep_options,
)

if TYPE_CHECKING:
    from analysis.changes import ChangesSeries, ChangeSummary, ComparedFollowup
    from standoff.workflows import SeriesRequest, SeriesResult


def changes(
    reference: Annotated[Path, typer.Argument(help="The earlier, nearer photograph.")],
    followup: Annotated[
        list[Path],
        typer.Argument(
            help="The later photograph. Of several, or a folder of them, each gets a folder.",
            show_default=False,
        ),
    ],
    *,
    psf: Annotated[Path, typer.Option(help="psf.json of the camera.")],
    transfer: TransferForm = "best",
    out: Annotated[Path, typer.Option(help="Folder for the results; a series is resumed.")],
    noise: Annotated[
        Path | None, typer.Option(help="noise.json of the camera; the noise is fitted by default.")
    ] = None,
    false_alarms: Annotated[
        float, typer.Option(min=1e-6, max=1e4, help="Pixels flagged by chance per frame.")
    ] = FALSE_ALARMS,
    workers: Workers = 1,
    scheduler: Scheduler = None,
    shard: PartOfShards = "1/1",
    strict: Strict = False,
    encoding: EncodingName = "auto",
    page: Page = None,
    mean: Mean = False,
    json: Json = False,
) -> None:
    """Find what changed between two photographs that their poses do not explain."""
    sweep = sweep_options(workers, scheduler, shard, is_strict=strict)
    from acquisition.printable import on_one_line
    from analysis.changes import ChangeOptions
    from calibration.files import read_noise
    from standoff.workflows import (
        SeriesRequest,
        find_changes_of_files,
        find_changes_of_series,
        is_series,
        make_folder,
        write_changes,
    )

    inputs = photograph_inputs(encoding, page, mean, files=(psf, noise))
    options = ChangeOptions(
        noise=None if noise is None else read_noise(noise).capture_noise,
        false_alarms=false_alarms,
    )
    if is_series(followup):
        request = SeriesRequest(
            reference=reference, followups=tuple(followup), out=out, inputs=inputs, sweep=sweep
        )
        _show_series(request, find_changes_of_series(request, psf, transfer, options), json=json)
        return
    refuse_sweep_of_one(sweep)
    one = followup[0]
    found = find_changes_of_files(reference, one, psf, options, inputs, transfer)
    make_folder(out)
    summary = found.summary.model_copy(
        update={
            "reference": on_one_line(reference),
            "followup": on_one_line(one),
            "provenance": inputs.provenance(command_line()),
        }
    )
    write_changes(out, one.name, found, summary)
    _show_one(out, summary, json=json)


def _show_one(out: Path, summary: ChangeSummary, *, json: bool) -> None:
    from calibration.documents import json_object

    if json:
        print_json({"out": str(out), **json_object(summary)})
        return
    say(
        f"{summary.changed_px} of {summary.compared_px} pixels changed by more than "
        f"{summary.threshold_sd:.2f} standard deviations (zoom {summary.zoom:.3f}); wrote {out}"
    )


def _show_series(
    request: SeriesRequest, found: SeriesResult[ChangesSeries, ComparedFollowup], *, json: bool
) -> None:
    document = found.document
    if document is None:
        say_part(request.out, found.sweep, request.sweep, json=json)
    elif json:
        print_json_file(found.summary)
    else:
        print_few(
            ("Follow-ups", "First follow-ups", "Follow-ups with the most changed pixels"),
            ["folder", "changed px", "compared px", "zoom"],
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
        return [Path(one.followup).name, "", "", "none"]
    return [one.folder, str(one.changed_px), str(one.compared_px), f"{one.zoom:.3f}"]
