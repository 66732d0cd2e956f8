"""``standoff detectability``: how a change's detectability falls with the change of distance."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from analysis.choices import OBSERVERS, REFERENCE_ZOOM, WINDOW_PX
from simulation.choices import MODELS, Model
from standoff.errors import ApplicationError
from standoff.terminal import (
    EncodingName,
    Force,
    Json,
    ListedNumbers,
    Mean,
    Page,
    PartOfShards,
    Scheduler,
    Strict,
    TransferForm,
    Workers,
    checked_zoom,
    command_line,
    is_same_command,
    note,
    number_list,
    photograph_inputs,
    print_json,
    print_table,
    refuse_overwriting,
    refuse_suffix,
    say,
    sweep_options,
)

if TYPE_CHECKING:
    from analysis.detectability import ChangeSignal, DetectabilityCurve, DetectabilityCurves
    from standoff.photographs import Inputs
    from standoff.workflows import MeasuredCurves


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
    table = Path(noise) if noises is None else None
    inputs = photograph_inputs(encoding, page, mean, files=(psf, table))
    change = _change(signal, signal_sigma, inputs)
    if 2 * change.reach_px / reference_zoom > window:
        raise typer.BadParameter(
            f"the change exceeds the window of {window} px; widen it", param_hint="--window"
        )
    from analysis.detectability import DetectionTask
    from calibration.files import read_noise
    from standoff.workflows import (
        CurvesRequest,
        curve_figure_paths,
        each_image,
        measure_curves,
        require_writable,
    )

    refuse_overwriting(curve_figure_paths(out), force=replaces)
    require_writable([out])
    request = CurvesRequest(
        images=each_image(images),
        psf=psf,
        transfer=transfer,
        task=DetectionTask(
            signal=change,
            contrasts_dn=tuple(contrasts),
            noises_dn=tuple(noises or ()),
            zooms=tuple(sorted(zoom_list)),
            models=models,
            observers=observers,
            reference_zoom=reference_zoom,
            window_px=window,
        ),
        noise=None if table is None else read_noise(table).capture_noise,
        sweep=sweep,
        inputs=inputs,
    )
    measured = measure_curves(request, out.with_suffix(".sweep"))
    if measured.curves is None:
        _say_part(shard, measured, is_json=json)
    else:
        found = measured.curves.model_copy(
            update={
                "signal": measured.curves.signal if signal is None else signal.name,
                "provenance": inputs.provenance(command_line()),
            }
        )
        _note_copies(measured)
        _write_curves(out, found, is_json=json)
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


def _write_curves(out: Path, found: DetectabilityCurves, *, is_json: bool) -> None:
    """Write the document and its figures, and show the curves of the first contrast."""
    from analysis.results_file import write_results
    from calibration.documents import json_object
    from standoff.workflows import curve_figure_paths, write_curve_figures, written_together

    contrast_dn = found.curves[0].contrast_dn
    with written_together(out) as folder:
        write_results(folder / out.name, found)
        write_curve_figures(folder / out.name, found.curves, contrast_dn)
    figures = curve_figure_paths(out)
    if is_json:
        files = [str(path) for path in figures]
        print_json({"out": str(out), "figures": files, **json_object(found)})
        return
    _print_curves([curve for curve in found.curves if curve.contrast_dn == contrast_dn])
    say(f"wrote {out} and {', '.join(str(path) for path in figures)}")


def _note_copies(measured: MeasuredCurves) -> None:
    if measured.copies:
        have = "photograph has" if measured.copies == 1 else "photographs have"
        note(
            f"{measured.copies} {have} the content of another; each counts as often as it comes; "
            f"see {measured.copies_list}"
        )


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


def _change(patch: Path | None, sigma_px: float, inputs: Inputs) -> ChangeSignal:
    from analysis.detectability import GaussianSignal, PatchSignal

    if patch is None:
        return GaussianSignal(sigma_px=sigma_px)
    try:
        return PatchSignal(levels_dn=inputs.grey(patch))
    except ValueError as error:
        raise ApplicationError(f"{patch}: {error}") from error


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
