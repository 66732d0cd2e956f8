"""``standoff sr-pairs`` and ``standoff change-pairs``: training pairs from photographs."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import BadParameter, Option

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


@terminal.command()
def sr_pairs(
    images: list[Path],
    *,
    psf: Path,
    transfer: terminal.TransferForm = "best",
    zoom: Annotated[float, Option(callback=terminal.checked_zoom)],
    out: Path,
    model: Model = DEFAULT_MODEL,
    crop_px: Annotated[int, Option("--crop", min=8)] = 192,
    stride_px: Annotated[int | None, Option("--stride", min=1)] = None,
    test_fraction: Annotated[float, Option(callback=_checked_fraction)] = 0.1,
    seed: Annotated[int, Option(min=0)] = 0,
    is_float: Annotated[bool, Option("--float")] = False,
    layout: Annotated[library.PairFormat, Option("--format")] = "folder",
    threads: terminal.Threads = 1,
    sweep: terminal.Sweep,
    reading: terminal.Reading,
) -> None:
    """Cut photographs into crops, each paired with its image from ZOOM times further away.

    Options
    -------
    images: Photographs, or folders of them; may be URLs.
    psf: psf.json, or a PSF of your own.
    zoom: Distance ratio, at least 1.
    out: Folder for the pairs, or a URL; an existing one is resumed.
    model: Capture model.
    crop_px: Side of the high-resolution crops in px.
    stride_px: Distance between crops in px; the side of a crop by default.
    test_fraction: Fraction of the photographs kept for testing.
    seed: Seed for the choice of test photographs.
    is_float: Write float32 TIFFs instead of rounded PNGs.
    layout: Image files in folders, or tar files for the webdataset library.
    """
    how = terminal.keywords_of(library.training_pairs, format=layout)
    summary = library.training_pairs(images, out, **how)
    terminal.note_once(summary.notes)
    if summary.refused_images > 1:
        terminal.note(*summary.refused)

    def show() -> None:
        terminal.say(
            f"{url_of(out)}: {summary.train} pairs for training, {summary.test} for testing, "
            f"from {summary.images} images ({summary.images_found_done} already done)"
        )
        part, of_parts = sweep.part
        if of_parts > 1:
            terminal.say(
                f"part {part}/{of_parts}; the same command without --shard lists the pairs once "
                "all parts are done"
            )

    terminal.answer(lambda: {"out": url_of(out), **summary.to_json()}, show)
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


@terminal.command()
def change_pairs(
    photographs: list[Path],
    *,
    psf: Path | None = None,
    transfer: terminal.TransferForm = "best",
    out: Path,
    zooms: str = "1,2.5",
    tilts: str = "0,0",
    noise: str = "1,4",
    contrast: str = "6,40",
    changes: library.ChangeSigns = "both",
    signal_sigma: str = "1.5,3",
    depth: terminal.DepthFolder = None,
    pairs: Annotated[int, Option(min=1)] = 20,
    crop: Annotated[int, Option(min=16)] = 96,
    focal_length_px: terminal.FocalLengthOfTilts = None,
    focus_scatter: terminal.FocusScatterOfPairs = 0.0,
    light_scatter: terminal.LightScatter = 0.0,
    model: Model = DEFAULT_MODEL,
    reference_zoom: terminal.ReferenceZoom = 1.0,
    test_fraction: Annotated[float, Option(callback=_checked_fraction)] = 0.2,
    seed: Annotated[int, Option(min=0)] = 0,
    sweep: terminal.Sweep,
    reading: terminal.Reading,
) -> None:
    """Cut pairs with and without a change from photographs, for training a change detector.

    Options
    -------
    photographs: Photographs, or folders of them.
    psf: psf.json, or a PSF of your own; only model bicubic works without it.
    out: Folder for the pairs; an existing one is resumed.
    zooms: Smallest and largest distance ratio.
    tilts: Smallest and largest tilt in degrees; with --focal-length-px.
    noise: Smallest and largest noise of both photographs in DN.
    contrast: Smallest and largest absolute peak of the change in DN.
    changes: Whether changes are brighter than the scene, darker, or either.
    signal_sigma: Smallest and largest sigma of the Gaussian change in px of the photographs.
    pairs: Number of pairs with a change, and of pairs without, per photograph.
    crop: Side of the reference of a pair in px.
    model: Capture model.
    test_fraction: Fraction of the photographs kept for testing.
    seed: Seed for everything random.
    """
    from calibration.documents import json_object

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
        **terminal.keywords_of(library.change_pairs),
    )
    terminal.note_once(found.notes)
    done, dataset = found.photographs, found.dataset
    if sweep.part[1] > 1:
        terminal.say_part(sweep, done, "photographs", writes="lists the pairs")
    else:
        terminal.answer(
            lambda: {"out": str(out), **json_object(dataset)},
            lambda: terminal.say(
                f"{out}: {dataset.train} pairs for training, {dataset.test} for testing, half of "
                f"them with a change, from {done.images} photographs ({done.found_done} already "
                "done)"
            ),
        )
    terminal.end_refused(done, "used", "the pairs of the others are complete")


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
