"""``standoff sr-pairs``: aligned training pairs for super-resolution."""

import math
from pathlib import Path
from typing import Annotated

from typer import Argument, BadParameter, Option

from simulation.choices import DEFAULT_MODEL, Model
from standoff import library, terminal
from standoff.errors import ApplicationError


def _checked_fraction(fraction: float) -> float:
    if not (math.isfinite(fraction) and 0 <= fraction <= 1):
        raise BadParameter(f"a fraction must be between 0 and 1, got {fraction:g}")
    return fraction


def sr_pairs(
    images: Annotated[
        list[Path], Argument(help="Photographs, or folders of them.", show_default=False)
    ],
    *,
    psf: Annotated[Path, Option(help="psf.json of the camera.")],
    transfer: terminal.TransferForm = "best",
    zoom: Annotated[
        float, Option(help="Distance ratio, at least 1.", callback=terminal.checked_zoom)
    ],
    out: Annotated[Path, Option(help="Folder for the pairs; an existing one is resumed.")],
    model: Annotated[Model, Option(help="Capture model.")] = DEFAULT_MODEL,
    crop: Annotated[int, Option(min=8, help="Side of the high-resolution crops in px.")] = 192,
    stride: Annotated[
        int | None,
        Option(min=1, help="Distance between crops in px; the side of a crop by default."),
    ] = None,
    test_fraction: Annotated[
        float,
        Option(help="Fraction of the photographs kept for testing.", callback=_checked_fraction),
    ] = 0.1,
    seed: Annotated[int, Option(min=0, help="Seed for the choice of test photographs.")] = 0,
    is_float: Annotated[
        bool, Option("--float", help="Write float32 TIFFs instead of rounded PNGs.")
    ] = False,
    layout: Annotated[
        library.PairFormat,
        Option(
            "--format", help="Image files in folders, or tar files as the library webdataset reads."
        ),
    ] = "folder",
    threads: terminal.Threads = 1,
    workers: terminal.Workers = 1,
    scheduler: terminal.Scheduler = None,
    shard: terminal.PartOfShards = "1/1",
    strict: terminal.Strict = False,
    encoding: terminal.EncodingName = "auto",
    page: terminal.Page = None,
    mean: terminal.Mean = False,
    json: terminal.Json = False,
) -> None:
    """Cut photographs into crops, each paired with its image from ZOOM times further away."""
    sweep = terminal.sweep_options(workers, scheduler, shard, is_strict=strict)
    summary = library.training_pairs(
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
        reading=terminal.reading_options(encoding, page, mean),
        progress=terminal.ShownProgress(),
    )
    terminal.note_once(summary.notes)
    if summary.refused_images > 1:
        terminal.note(*summary.refused)
    if json:
        terminal.print_json({"out": str(out), **summary.to_json()})
    else:
        terminal.say(
            f"{out}: {summary.train} pairs for training, {summary.test} for testing, "
            f"from {summary.images} images ({summary.images_found_done} already done)"
        )
        if sweep.part[1] > 1:
            terminal.say(
                f"part {shard}; the same command without --shard lists the pairs once all parts "
                "are done"
            )
    count = summary.refused_images
    if count == summary.images == 1:
        raise ApplicationError(f"{summary.refused[0]}; no pairs")
    if count:
        why = f"{summary.refused[0]}; " if count == 1 else ""
        listed = f" ({summary.refused_list} lists them)" if count > len(summary.refused) else ""
        raise ApplicationError(
            f"{why}{count} of {summary.images} images gave no pairs{listed}; the pairs of the "
            "others are complete"
        )
