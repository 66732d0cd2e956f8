"""``standoff sr-pairs``: aligned training pairs for super-resolution."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from simulation.choices import DEFAULT_MODEL, Model
from standoff.errors import ApplicationError
from standoff.library import PairFormat
from standoff.terminal import (
    EncodingName,
    Json,
    Mean,
    Page,
    PartOfShards,
    Scheduler,
    ShownProgress,
    Strict,
    Threads,
    TransferForm,
    Workers,
    checked_zoom,
    note,
    note_once,
    print_json,
    reading_options,
    say,
    sweep_options,
)

if TYPE_CHECKING:
    from standoff.library import SrDatasetSummary


def _checked_fraction(fraction: float) -> float:
    if not (math.isfinite(fraction) and 0 <= fraction <= 1):
        raise typer.BadParameter(f"a fraction must be between 0 and 1, got {fraction:g}")
    return fraction


def sr_pairs(
    images: Annotated[
        list[Path], typer.Argument(help="Photographs, or folders of them.", show_default=False)
    ],
    *,
    psf: Annotated[Path, typer.Option(help="psf.json of the camera.")],
    transfer: TransferForm = "best",
    zoom: Annotated[float, typer.Option(help="Distance ratio, at least 1.", callback=checked_zoom)],
    out: Annotated[Path, typer.Option(help="Folder for the pairs; an existing one is resumed.")],
    model: Annotated[Model, typer.Option(help="Capture model.")] = DEFAULT_MODEL,
    crop: Annotated[
        int, typer.Option(min=8, help="Side of the high-resolution crops in px.")
    ] = 192,
    stride: Annotated[
        int | None,
        typer.Option(min=1, help="Distance between crops in px; the side of a crop by default."),
    ] = None,
    test_fraction: Annotated[
        float,
        typer.Option(
            help="Fraction of the photographs kept for testing.", callback=_checked_fraction
        ),
    ] = 0.1,
    seed: Annotated[int, typer.Option(min=0, help="Seed for the choice of test photographs.")] = 0,
    is_float: Annotated[
        bool, typer.Option("--float", help="Write float32 TIFFs instead of rounded PNGs.")
    ] = False,
    layout: Annotated[
        PairFormat,
        typer.Option(
            "--format", help="Image files in folders, or tar files as the library webdataset reads."
        ),
    ] = "folder",
    threads: Threads = 1,
    workers: Workers = 1,
    scheduler: Scheduler = None,
    shard: PartOfShards = "1/1",
    strict: Strict = False,
    encoding: EncodingName = "auto",
    page: Page = None,
    mean: Mean = False,
    json: Json = False,
) -> None:
    """Cut photographs into crops, each paired with its image from ZOOM times further away."""
    from standoff.library import training_pairs

    sweep = sweep_options(workers, scheduler, shard, is_strict=strict)
    summary = training_pairs(
        images,
        out,
        psf=psf,
        zoom=zoom,
        model=model,
        transfer=transfer,
        crop_px=crop,
        stride_px=stride,
        test_fraction=test_fraction,
        seed=seed,
        is_float=is_float,
        format=layout,
        threads=threads,
        sweep=sweep,
        reading=reading_options(encoding, page, mean),
        progress=ShownProgress(),
    )
    note_once(summary.notes)
    if summary.refused_images > 1:
        for line in summary.refused:
            note(line)
    if json:
        print_json({"out": str(out), **summary.to_json()})
    else:
        _say_summary(out, summary)
        if sweep.part[1] > 1:
            say(
                f"part {shard}; the same command without --shard lists the pairs once all parts "
                "are done"
            )
    if summary.refused_images:
        raise ApplicationError(_refusal(summary))


def _refusal(summary: SrDatasetSummary) -> str:
    count = summary.refused_images
    if count == 1:
        if summary.images == 1:
            return f"{summary.refused[0]}; no pairs"
        why = f"{summary.refused[0]}; "
    else:
        why = ""
    listed = f" ({summary.refused_list} lists them)" if count > len(summary.refused) else ""
    return (
        f"{why}{count} of {summary.images} images gave no pairs{listed}; the pairs of the others "
        "are complete"
    )


def _say_summary(out: Path, summary: SrDatasetSummary) -> None:
    say(
        f"{out}: {summary.train} pairs for training, {summary.test} for testing, "
        f"from {summary.images} images ({summary.images_found_done} already done)"
    )
