"""``standoff detectability``: how a change's detectability falls with the change of distance."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from analysis.choices import OBSERVERS, REFERENCE_ZOOM, WINDOW_PX
from simulation.choices import MODELS, Model
from standoff.errors import ApplicationError, ArgumentError
from standoff.terminal import (
    EncodingName,
    Force,
    Json,
    ListedNumbers,
    Mean,
    Page,
    PartOfShards,
    Scheduler,
    ShownProgress,
    Strict,
    TransferForm,
    Workers,
    checked_zoom,
    is_same_command,
    note,
    note_once,
    number_list,
    print_json,
    print_table,
    reading_options,
    refuse_overwriting,
    refuse_suffix,
    say,
    sweep_options,
)

if TYPE_CHECKING:
    from analysis.detectability import DetectabilityCurve, DetectabilityCurves
    from standoff.library import MeasuredCurves


_Name = TypeVar("_Name", bound=str)

_ZOOMS = ListedNumbers(option="--zooms", least=1.0, pair_most=10.0)
_NOISES = ListedNumbers(option="--noise")
_CONTRASTS = ListedNumbers(option="--contrast")
_MODELS: tuple[Model, ...] = ("bicubic", "paper", "matched")


def _odd(window: int) -> int:
    if window % 2 == 0:
        raise typer.BadParameter(f"the window must be odd, got {window}")
    return window


def detectability(
    images: Annotated[
        list[Path],
        typer.Argument(help="Photographs of the scene, or folders of them.", show_default=False),
    ],
    *,
    out: Annotated[
        Path, typer.Option(help="Where to write curves.json; the figures are written beside it.")
    ],
    psf: Annotated[Path | None, typer.Option(help="psf.json of the camera.")] = None,
    transfer: TransferForm = "best",
    zooms: Annotated[
        str, typer.Option(help="Distance ratios, each at least 1.")
    ] = "1,1.01,1.1,1.2,1.35,1.5,1.75,2,2.5,3,4",
    noise: Annotated[
        str, typer.Option(help="Standard deviations of the noise in DN, S[,S...], or a noise.json.")
    ] = "1,2,4",
    contrast: Annotated[str, typer.Option(help="Peaks of the change in DN, C[,C...].")] = "12",
    signal_sigma: Annotated[
        float, typer.Option(min=0.3, help="Sigma of the Gaussian change, in px of the photographs.")
    ] = 2.0,
    signal: Annotated[
        Path | None, typer.Option(help="Image patch to use as the change, instead of a Gaussian.")
    ] = None,
    observer: Annotated[
        str, typer.Option(help=f"Observers: any of {', '.join(OBSERVERS)}.")
    ] = ",".join(OBSERVERS),
    model: Annotated[
        str, typer.Option(help=f"Capture models: any of {', '.join(MODELS)}.")
    ] = ",".join(_MODELS),
    reference_zoom: Annotated[
        float, typer.Option(help="Zoom from photograph to reference.", callback=checked_zoom)
    ] = REFERENCE_ZOOM,
    window: Annotated[
        int,
        typer.Option(min=5, help="Side of the observer's window in px; odd.", callback=_odd),
    ] = WINDOW_PX,
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
    """Measure how well a change can be detected, at best, from different distances."""
    refuse_suffix(out, "--out", {".json"})
    zoom_list, contrasts = number_list(zooms, _ZOOMS), number_list(contrast, _CONTRASTS)
    observers = tuple(_chosen(observer, "--observer", OBSERVERS))
    models = tuple(_chosen(model, "--model", MODELS))
    noises = None if noise.endswith(".json") else number_list(noise, _NOISES)
    if psf is None and set(models) != {"bicubic"}:
        raise typer.BadParameter(f"model {model} needs --psf psf.json", param_hint="--psf")
    sweep = sweep_options(workers, scheduler, shard, is_strict=strict)
    replaces = force or sweep.part[1] > 1 or _is_of_same_command(out)  # a part writes no curves
    refuse_overwriting([out], [*images, psf, signal], force=replaces)
    from analysis.detectability import DetectionTask, GaussianSignal
    from standoff.library import curve_figure_paths, measure_curves, require_writable

    refuse_overwriting(curve_figure_paths(out), force=replaces)
    require_writable([out])
    try:
        measured = measure_curves(
            images,
            out.with_suffix(".sweep"),
            psf,
            DetectionTask(
                signal=GaussianSignal(sigma_px=signal_sigma),
                contrasts_dn=tuple(contrasts),
                noises_dn=tuple(noises or ()),
                zooms=tuple(sorted(zoom_list)),
                models=models,
                observers=observers,
                reference_zoom=reference_zoom,
                window_px=window,
            ),
            transfer=transfer,
            signal=signal,
            noise=noise if noises is None else None,
            sweep=sweep,
            reading=reading_options(encoding, page, mean),
            progress=ShownProgress(),
        )
    except ArgumentError as error:
        raise typer.BadParameter(str(error), param_hint="--window") from error
    note_once(measured.notes)
    if measured.curves is None:
        _say_part(shard, measured, is_json=json)
    else:
        _show_curves(out, measured.write(out), measured.curves, is_json=json)
    _refuse_refused(measured)


def _is_of_same_command(out: Path) -> bool:
    """Whether there are curves of the same command, which goes on with what it measured."""
    from analysis.detectability import read_curves
    from analysis.errors import ResultsFileError

    if not out.is_file():
        return False
    try:
        stored = read_curves(out).provenance
    except ResultsFileError:
        return False
    return stored is not None and is_same_command(stored.command)


def _show_curves(
    out: Path, figures: list[Path], found: DetectabilityCurves, *, is_json: bool
) -> None:
    """Show the curves of the first contrast."""
    from calibration.documents import json_object

    if is_json:
        files = [str(path) for path in figures]
        print_json({"out": str(out), "figures": files, **json_object(found)})
        return
    first_dn = found.curves[0].contrast_dn
    _print_curves([curve for curve in found.curves if curve.contrast_dn == first_dn])
    say(f"wrote {out} and {', '.join(str(path) for path in figures)}")


def _say_part(shard: str, measured: MeasuredCurves, *, is_json: bool) -> None:
    done = measured.photographs
    if is_json:
        print_json({"out": None, "shard": shard, "images": done.images, "refused": done.refused})
        return
    say(
        f"part {shard}: {done.images} photographs measured ({done.found_done} already done); the "
        "same command without --shard writes the curves once all parts are done"
    )


def _refuse_refused(measured: MeasuredCurves) -> None:
    """End with status 1 if photographs could not be measured, having named ten at most."""
    done = measured.photographs
    if done.refused == 0:
        return
    if done.refused == 1:
        raise ApplicationError(f"{done.refused_lines[0]}; the curves are of the others")
    for line in done.refused_lines:
        note(line)
    raise ApplicationError(
        f"{done.refused} photographs could not be measured ({done.refused_list} lists them); the "
        f"curves are of the {done.images} others"
    )


def _print_curves(curves: list[DetectabilityCurve]) -> None:
    print_table(
        "d' against zoom; it is proportional to the contrast",
        ["zoom", *(f"{zoom:g}" for zoom in curves[0].zoom)],
        [[curve.name, *(f"{value:.2f}" for value in curve.dprime)] for curve in curves],
    )
    say("d' is an upper bound: exposure, registration, gloss, parallax and defocus only lower it")


def _chosen(text: str, option: str, known: tuple[_Name, ...]) -> list[_Name]:
    names = {str(name): name for name in known}
    for part in text.split(","):
        if part not in names:
            raise typer.BadParameter(
                f"{part!r} is not one of {', '.join(names)}", param_hint=option
            )
    return [names[part] for part in dict.fromkeys(text.split(","))]
