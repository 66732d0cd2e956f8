"""``standoff sr-pairs`` and ``standoff change-pairs``: training pairs from photographs."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import Argument, BadParameter, Option

from acquisition.remote_files import url_of
from simulation.choices import DEFAULT_MODEL, Model
from standoff import library, terminal
from standoff.errors import ApplicationError

if TYPE_CHECKING:
    from analysis.evaluation.change_pairs import ChangePairsTask


def _checked_fraction(fraction: float) -> float:
    if not (math.isfinite(fraction) and 0 <= fraction <= 1):
        raise BadParameter(f"a fraction must be between 0 and 1, got {fraction:g}")
    return fraction


def sr_pairs(
    images: Annotated[
        list[Path],
        Argument(help="Photographs, or folders of them; URLs as well.", show_default=False),
    ],
    *,
    psf: Annotated[Path, Option(help="psf.json, or a PSF of your own.")],
    transfer: terminal.TransferForm = "best",
    zoom: Annotated[
        float, Option(help="Distance ratio, at least 1.", callback=terminal.checked_zoom)
    ],
    out: Annotated[
        Path, Option(help="Folder for the pairs, or a URL; an existing one is resumed.")
    ],
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
        terminal.print_json({"out": url_of(out), **summary.to_json()})
    else:
        terminal.say(
            f"{url_of(out)}: {summary.train} pairs for training, {summary.test} for testing, "
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


def change_pairs(
    photographs: Annotated[
        list[Path], Argument(help="Photographs, or folders of them.", show_default=False)
    ],
    *,
    psf: Annotated[
        Path | None,
        Option(help="psf.json, or a PSF of your own; only model bicubic works without it."),
    ] = None,
    transfer: terminal.TransferForm = "best",
    out: Annotated[Path, Option(help="Folder for the pairs; an existing one is resumed.")],
    zooms: Annotated[str, Option(help="Least and largest distance ratio.")] = "1,2.5",
    tilts: Annotated[
        str, Option(help="Least and largest tilt in degrees; with --focal-length-px.")
    ] = "0,0",
    noise: Annotated[
        str, Option(help="Least and largest noise of both photographs in DN.")
    ] = "1,4",
    contrast: Annotated[
        str, Option(help="Least and largest absolute peak of the change in DN.")
    ] = "6,40",
    changes: Annotated[
        library.ChangeSigns,
        Option(help="Whether changes are brighter than the scene, darker, or either."),
    ] = "both",
    signal_sigma: Annotated[
        str,
        Option(help="Least and largest sigma of the Gaussian change in px of the photographs."),
    ] = "1.5,3",
    pairs: Annotated[
        int, Option(min=1, help="Pairs with and pairs without a change for each photograph.")
    ] = 20,
    crop: Annotated[int, Option(min=16, help="Side of the reference of a pair in px.")] = 96,
    focal_length_px: terminal.FocalLengthOfTilts = None,
    focus_scatter: terminal.FocusScatterOfPairs = 0.0,
    light_scatter: terminal.LightScatter = 0.0,
    model: Annotated[Model, Option(help="Capture model.")] = DEFAULT_MODEL,
    reference_zoom: terminal.ReferenceZoom = 1.0,
    test_fraction: Annotated[
        float,
        Option(help="Fraction of the photographs kept for testing.", callback=_checked_fraction),
    ] = 0.2,
    seed: Annotated[int, Option(min=0, help="Seed of all that is random.")] = 0,
    workers: terminal.Workers = 1,
    scheduler: terminal.Scheduler = None,
    shard: terminal.PartOfShards = "1/1",
    strict: terminal.Strict = False,
    encoding: terminal.EncodingName = "auto",
    page: terminal.Page = None,
    mean: terminal.Mean = False,
    json: terminal.Json = False,
) -> None:
    """Cut pairs with and without a change from photographs, for training a change detector."""
    sweep = terminal.sweep_options(workers, scheduler, shard, is_strict=strict)
    found = library.change_pairs(
        photographs,
        out,
        psf,
        _task(
            zooms=_ends(zooms, "--zooms"),
            tilts_deg=_ends(tilts, "--tilts"),
            noises_dn=_ends(noise, "--noise"),
            contrasts_dn=_ends(contrast, "--contrast"),
            changes=changes,
            sigmas_px=_ends(signal_sigma, "--signal-sigma"),
            model=model,
            reference_zoom=reference_zoom,
            crop_px=crop,
            pairs=pairs,
            focal_length_px=focal_length_px,
            focus_scatter_px2=focus_scatter,
            light_scatter=light_scatter,
            test_fraction=test_fraction,
            seed=seed,
        ),
        transfer=transfer,
        sweep=sweep,
        reading=terminal.reading_options(encoding, page, mean),
        progress=terminal.ShownProgress(),
    )
    terminal.note_once(found.notes)
    done, dataset = found.photographs, found.dataset
    if sweep.part[1] > 1:
        counts = {"out": None, "shard": shard, "images": done.images, "refused": done.refused}
        if json:
            terminal.print_json(counts)
        else:
            terminal.say(
                f"part {shard}: {done.images} photographs ({done.found_done} already done); the "
                "same command without --shard lists the pairs once all parts are done"
            )
    elif json:
        from calibration.documents import json_object

        terminal.print_json({"out": str(out), **json_object(dataset)})
    else:
        terminal.say(
            f"{out}: {dataset.train} pairs for training, {dataset.test} for testing, half of them "
            f"with a change, from {done.images} photographs ({done.found_done} already done)"
        )
    terminal.end_refused(
        done,
        "the pairs of the others are complete"
        if done.refused == 1
        else f"{done.refused} photographs could not be used ({done.refused_list} lists them); "
        "the pairs of the others are complete",
    )


def _ends(text: str, option: str) -> tuple[float, float]:
    """Return the least and the largest value; of one number, both."""
    values = terminal.number_list(text, terminal.ListedNumbers(option=option, least=0.0))
    if len(values) > 2:
        raise BadParameter(f"{option}: expected a least and a largest value, got {text}")
    return values[0], values[-1]


def _task(**values: object) -> "ChangePairsTask":
    from pydantic import ValidationError

    from analysis.evaluation.change_pairs import ChangePairsTask

    try:
        return ChangePairsTask.model_validate(values)
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"][:1])
        said = first["msg"].removeprefix("Value error, ")
        raise BadParameter(f"{where}: {said}" if where else said) from error
