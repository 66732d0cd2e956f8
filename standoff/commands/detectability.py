"""``standoff detectability``: how a change's detectability falls with the change of distance."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

from typer import Argument, BadParameter, Option

from acquisition.remote_files import url_of
from analysis.choices import ALL_OBSERVERS, OBSERVERS, REFERENCE_ZOOM, WINDOW_PX
from simulation.choices import MODELS, Model
from standoff import library, terminal
from standoff.errors import ArgumentError

if TYPE_CHECKING:
    from analysis.detectability import DetectabilityCurve, DetectabilityCurves

_Name = TypeVar("_Name", bound=str)

_ZOOMS = terminal.ListedNumbers(option="--zooms", least=1.0, pair_most=10.0)
_NOISES = terminal.ListedNumbers(option="--noise")
_CONTRASTS = terminal.ListedNumbers(option="--contrast")
_MODELS: tuple[Model, ...] = ("bicubic", "paper", "matched")


def _odd(window: int) -> int:
    if window % 2 == 0:
        raise BadParameter(f"the window must be odd, got {window}")
    return window


def detectability(
    images: Annotated[
        list[Path],
        Argument(
            help="Photographs of the scene, or folders of them; URLs as well.", show_default=False
        ),
    ],
    *,
    out: Annotated[
        Path,
        Option(help="Where to write curves.json, a URL as well; figures come beside it."),
    ],
    psf: Annotated[Path | None, Option(help="psf.json, or a PSF of your own.")] = None,
    transfer: terminal.TransferForm = "best",
    zooms: Annotated[
        str, Option(help="Distance ratios, each at least 1.")
    ] = "1,1.01,1.1,1.2,1.35,1.5,1.75,2,2.5,3,4",
    noise: Annotated[
        str, Option(help="Standard deviations of the noise in DN, S[,S...], or a noise.json.")
    ] = "1,2,4",
    contrast: Annotated[str, Option(help="Peaks of the change in DN, C[,C...].")] = "12",
    signal_sigma: Annotated[
        float, Option(min=0.3, help="Sigma of the Gaussian change, in px of the photographs.")
    ] = 2.0,
    signal: Annotated[
        Path | None, Option(help="Image patch to use as the change, instead of a Gaussian.")
    ] = None,
    observer: Annotated[
        str,
        Option(
            help=f"Observers: any of {', '.join(ALL_OBSERVERS)}; the last one predicts what "
            "standoff changes finds."
        ),
    ] = ",".join(OBSERVERS),
    model: Annotated[str, Option(help=f"Capture models: any of {', '.join(MODELS)}.")] = ",".join(
        _MODELS
    ),
    reference_zoom: terminal.ReferenceZoom = REFERENCE_ZOOM,
    window: Annotated[
        int, Option(min=5, help="Side of the observer's window in px; odd.", callback=_odd)
    ] = WINDOW_PX,
    focus_scatter: terminal.FocusScatter = None,
    registration_error: Annotated[
        float | None,
        Option(min=0, help="Standard deviation of a pair's registration error in px, each axis."),
    ] = None,
    parquet: terminal.AsParquet = False,
    workers: terminal.Workers = 1,
    scheduler: terminal.Scheduler = None,
    shard: terminal.PartOfShards = "1/1",
    strict: terminal.Strict = False,
    encoding: terminal.EncodingName = "auto",
    page: terminal.Page = None,
    mean: terminal.Mean = False,
    force: terminal.Force = False,
    json: terminal.Json = False,
) -> None:
    """Measure how well a change can be detected, at best, from different distances."""
    terminal.refuse_suffix(out, "--out", {".json"})
    zoom_list = terminal.number_list(zooms, _ZOOMS)
    contrasts = terminal.number_list(contrast, _CONTRASTS)
    observers = _chosen(observer, "--observer", ALL_OBSERVERS)
    models = _chosen(model, "--model", MODELS)
    noises = None if noise.endswith(".json") else terminal.number_list(noise, _NOISES)
    if psf is None and set(models) != {"bicubic"}:
        raise BadParameter(f"model {model} needs --psf psf.json", param_hint="--psf")
    sweep = terminal.sweep_options(workers, scheduler, shard, is_strict=strict)
    is_part = sweep.part[1] > 1  # which writes no curves
    replaces = force or is_part or terminal.is_same_command(library.curves_made_by(out))
    terminal.refuse_overwriting([out], [*images, psf, signal], force=replaces)
    from analysis.detectability import DetectionTask, GaussianSignal
    from analysis.parquet_table import require_parquet

    tables = [library.curve_table_path(out)] if parquet else []
    if parquet:
        require_parquet()
    terminal.refuse_overwriting([*library.curve_figure_paths(out), *tables], force=replaces)
    library.require_writable([out])
    try:
        measured = library.measure_curves(
            images,
            library.state_of_curves(out),
            psf,
            DetectionTask(
                signal=GaussianSignal(sigma_px=signal_sigma),
                contrasts_dn=tuple(contrasts),
                noises_dn=tuple(noises or (1.0,)),  # a noise.json tells its own by the levels
                zooms=tuple(sorted(zoom_list)),
                models=models,
                observers=observers,
                reference_zoom=reference_zoom,
                window_px=window,
            ),
            transfer=transfer,
            signal=signal,
            noise=noise if noises is None else None,
            focus_scatter_px2=focus_scatter,
            registration_err_px=registration_error,
            sweep=sweep,
            reading=terminal.reading_options(encoding, page, mean),
            progress=terminal.ShownProgress(),
        )
    except ArgumentError as error:
        raise BadParameter(str(error), param_hint="--window") from error
    terminal.note_once(measured.notes)
    done, found = measured.photographs, measured.curves
    if found is None:
        terminal.say_part_of_curves(shard, done, "measured", json=json)
    else:
        written = [*measured.write(out, parquet=parquet), *tables]
        _show_curves(out, written, found, json=json)
    terminal.end_refused(
        done,
        "the curves are of the others"
        if done.refused == 1
        else f"{done.refused} photographs could not be measured ({done.refused_list} lists them); "
        f"the curves are of the {done.images} others",
    )


def _show_curves(out: Path, figures: list[Path], found: DetectabilityCurves, *, json: bool) -> None:
    """Show the curves of the first contrast."""
    files = [url_of(path) for path in figures]
    if json:
        from calibration.documents import json_object

        terminal.print_json({"out": url_of(out), "figures": files, **json_object(found)})
        return
    shown = [one for one in found.curves if one.contrast_dn == found.curves[0].contrast_dn]
    terminal.print_table(
        "d' against zoom; it is proportional to the contrast",
        ["zoom", *(f"{zoom:g}" for zoom in shown[0].zoom)],
        [[curve.name, *(f"{value:.2f}" for value in curve.dprime)] for curve in shown],
    )
    terminal.say(
        *_which_row(shown),
        "d' is an upper bound: exposure, registration, gloss, parallax and defocus only lower it",
        *filter(None, (found.too_few_sentence, found.unknown_sentence)),
        f"wrote {url_of(out)} and {', '.join(files)}",
    )


_READS_AS = {
    "bicubic": "bicubic knows no PSF and is too optimistic",
    "npw": "npw takes the scene's detail for white noise",
    "hotelling": "hotelling is the best that any linear detector does",
    "cho": "cho comes near the best linear detector, with six channels alone",
    "changes": "changes is what standoff changes does",
}


def _which_row(shown: list[DetectabilityCurve]) -> list[str]:
    """What tells the rows apart, where there are several models or observers."""
    models = dict.fromkeys(str(curve.model) for curve in shown)
    observers = dict.fromkeys(str(curve.observer) for curve in shown)
    told = [_READS_AS[name] for name in models if len(models) > 1 and name in _READS_AS]
    told += [_READS_AS[name] for name in observers if len(observers) > 1 and name in _READS_AS]
    return [f"which row to read: {'; '.join(told)}"] if told else []


def _chosen(text: str, option: str, known: tuple[_Name, ...]) -> tuple[_Name, ...]:
    names = {str(name): name for name in known}
    for part in text.split(","):
        if part not in names:
            raise BadParameter(f"{part!r} is not one of {', '.join(names)}", param_hint=option)
    return tuple(names[part] for part in dict.fromkeys(text.split(",")))
