"""``standoff detectability``: how a change's detectability falls with the change of distance."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

from typer import BadParameter, Option

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


@terminal.command()
def detectability(
    images: list[Path],
    *,
    out: Annotated[Path, terminal.Result(".json", is_resumed=True)],
    psf: Path | None = None,
    transfer: terminal.TransferForm = "best",
    zooms: str = "1,1.01,1.1,1.2,1.35,1.5,1.75,2,2.5,3,4",
    noise: str = "1,2,4",
    contrast: str = "12",
    signal_sigma: Annotated[float, Option(min=0.3)] = 2.0,
    signal: Path | None = None,
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
    window: Annotated[int, Option(min=5, callback=_odd)] = WINDOW_PX,
    focus_scatter_px2: terminal.FocusScatter = None,
    registration_err_px: Annotated[float | None, Option("--registration-error", min=0)] = None,
    parquet: terminal.AsParquet = False,
    sweep: terminal.Sweep,
    reading: terminal.Reading,
    force: terminal.Force = False,
) -> None:
    """Measure how well a change can be detected, at best, from different distances.

    Options
    -------
    images: Photographs of the scene, or folders of them; may be URLs.
    out: Where to write curves.json; may be a URL. The figures are written beside it.
    psf: psf.json, or a PSF of your own.
    zooms: Distance ratios, each at least 1.
    noise: Standard deviations of the noise in DN, S[,S...], or a noise.json.
    contrast: Peaks of the change in DN, C[,C...].
    signal_sigma: Sigma of the Gaussian change, in px of the photographs.
    signal: Image patch to use as the change, instead of a Gaussian.
    window: Side of the observer's window in px; odd.
    registration_err_px: Standard deviation of a pair's registration error in px, each axis.
    """
    zoom_list = terminal.number_list(zooms, _ZOOMS)
    contrasts = terminal.number_list(contrast, _CONTRASTS)
    observers = _chosen(observer, "--observer", ALL_OBSERVERS)
    models = _chosen(model, "--model", MODELS)
    noises = None if noise.endswith(".json") else terminal.number_list(noise, _NOISES)
    if psf is None and set(models) != {"bicubic"}:
        raise BadParameter(f"model {model} needs --psf psf.json", param_hint="--psf")
    is_part = sweep.part[1] > 1  # which writes no curves
    replaces = is_part or terminal.is_same_command(library.curves_made_by(out))
    terminal.refuse_replacing(out, may_replace=replaces)
    from analysis.detectability import DetectionTask, GaussianSignal
    from analysis.parquet_table import require_parquet
    from calibration.documents import json_object

    tables = [library.curve_table_path(out)] if parquet else []
    if parquet:
        require_parquet()
    terminal.refuse_replacing(*library.curve_figure_paths(out), *tables, may_replace=replaces)
    library.require_writable([out])
    how = terminal.keywords_of(library.measure_curves, noise=noise if noises is None else None)
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
            **how,
        )
    except ArgumentError as error:
        raise BadParameter(str(error), param_hint="--window") from error
    terminal.note_once(measured.notes)
    done, found = measured.photographs, measured.curves
    if found is None:
        terminal.say_part(sweep, done, "photographs measured", writes="writes the curves")
    else:
        written = [*measured.write(out, parquet=parquet), *tables]
        files = [url_of(path) for path in written]
        terminal.answer(
            lambda: {"out": url_of(out), "figures": files, **json_object(found)},
            lambda: _show_curves(out, files, found),
        )
    terminal.end_refused(done, "measured", "the curves are from the {others}")


def _show_curves(out: Path, files: list[str], found: DetectabilityCurves) -> None:
    """Show the curves of the first contrast."""
    shown = [one for one in found.curves if one.contrast_dn == found.curves[0].contrast_dn]
    terminal.print_table(
        "d' against zoom; it is proportional to the contrast",
        ["zoom", *(f"{zoom:g}" for zoom in shown[0].zoom)],
        [[curve.name, *(f"{value:.2f}" for value in curve.dprime)] for curve in shown],
    )
    terminal.say(
        *_which_row(shown),
        *_of_reference(found.reference_zoom),
        "d' is an upper bound: exposure, registration, gloss, parallax and defocus only lower it",
        *filter(None, (found.too_few_sentence, found.unknown_sentence)),
        f"wrote {url_of(out)} and {', '.join(files)}",
    )


def _of_reference(reference_zoom: float | None) -> list[str]:
    """What a zoom of 1 is: easily taken for the distance of the photographs."""
    if reference_zoom is None:  # older files
        return []
    where = (
        "that is, of the photographs"
        if reference_zoom == 1
        else f"which is from {reference_zoom:g} times as far as the photographs (--reference-zoom)"
    )
    return [f"zoom: the follow-up's distance over that of the reference, {where}"]


_READS_AS = {
    "bicubic": "bicubic ignores the PSF and is too optimistic",
    "npw": "npw takes the scene's detail for white noise",
    "hotelling": "hotelling is the best linear detector",
    "cho": "cho comes near the best linear detector with only six channels",
    "changes": "changes predicts what the command standoff changes finds",
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
