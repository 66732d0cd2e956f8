"""``standoff sr-pairs``: aligned training pairs for super-resolution."""

from __future__ import annotations

import math
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from simulation.choices import DEFAULT_MODEL, Model
from standoff.errors import ApplicationError
from standoff.terminal import (
    EncodingName,
    Json,
    Mean,
    Page,
    Threads,
    TransferForm,
    checked_zoom,
    note,
    photograph_inputs,
    print_json,
    progress_bar,
    say,
)

if TYPE_CHECKING:
    from standoff.workflows import SrDatasetSummary


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
    threads: Threads = 1,
    encoding: EncodingName = "auto",
    page: Page = None,
    mean: Mean = False,
    json: Json = False,
) -> None:
    """Cut photographs into crops, each paired with its image from ZOOM times further away."""
    from standoff.workflows import (
        SrDatasetSettings,
        expanded_images,
        psf_and_field,
        write_sr_dataset,
    )

    inputs = photograph_inputs(encoding, page, mean, files=(psf,))
    one, field = psf_and_field(psf, model, transfer)
    settings = SrDatasetSettings(
        zoom=zoom,
        model=model,
        psf=one,
        field=field,
        threads=threads,
        crop_px=crop,
        stride_px=stride or crop,
        test_fraction=test_fraction,
        seed=seed,
        is_float=is_float,
    )
    paths = expanded_images(images)
    with progress_bar("cutting pairs", len(paths)) as bar:
        summary = write_sr_dataset(out, paths, settings, inputs, bar.advance_to)
    if len(summary.refused) > 1:
        for line in summary.refused:
            note(line)
    if json:
        print_json({"out": str(out), **asdict(summary)})
    else:
        _say_summary(out, summary, len(paths))
    if summary.refused:
        count = len(summary.refused)
        why = f"{summary.refused[0]}; " if count == 1 else ""
        others = (
            f"{count} of {len(paths)} images gave no pairs; the pairs of the others are complete"
        )
        raise ApplicationError(why + ("no pairs" if len(paths) == 1 else others))


def _say_summary(out: Path, summary: SrDatasetSummary, images: int) -> None:
    say(
        f"{out}: {summary.train} pairs for training, {summary.test} for testing, "
        f"from {images} images ({summary.images_found_done} already done)"
    )
