"""``standoff evaluate``: how well a change detector does from other poses of the camera."""

from __future__ import annotations

from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import BadParameter, Option

from simulation.choices import DEFAULT_MODEL, Model
from standoff import library, terminal

if TYPE_CHECKING:
    from analysis.evaluation import Evaluation, EvaluationTask

_ZOOMS = terminal.ListedNumbers(option="--zooms", least=1.0, pair_most=10.0)
_TILTS = terminal.ListedNumbers(option="--tilts", least=0.0)
_NOISES = terminal.ListedNumbers(option="--noise", least=0.0)
_CONTRASTS = terminal.ListedNumbers(option="--contrast", least=-inf)


@terminal.command(
    terminal.needs("after", "masks"),
    terminal.needs("masks", "after"),
    terminal.excludes("patch", "after", because="both define the change"),
)
def evaluate(
    detector: str,
    *,
    photographs: list[Path],
    out: Annotated[Path, terminal.Result(".json", is_resumed=True)],
    psf: Path | None = None,
    transfer: terminal.TransferForm = "best",
    zooms: str = "1,1.1,1.25,1.5,2,2.5",
    tilts: str = "0",
    noise: str = "2",
    contrast: str | None = None,
    signal_sigma: Annotated[float, Option(min=0.3)] = 2.0,
    patch: Path | None = None,
    after: Path | None = None,
    masks: Path | None = None,
    depth: terminal.DepthFolder = None,
    pairs: Annotated[int, Option(min=1)] = 20,
    crop: Annotated[int, Option(min=16)] = 128,
    focal_length_px: terminal.FocalLengthOfTilts = None,
    focus_scatter: terminal.FocusScatterOfPairs = 0.0,
    light_scatter: terminal.LightScatter = 0.0,
    model: Model = DEFAULT_MODEL,
    reference_zoom: terminal.ReferenceZoom = 1.0,
    seed: Annotated[int, Option(min=0)] = 0,
    timeout_s: Annotated[float, Option("--timeout", min=0.01)] = 60.0,
    report: Annotated[Path | None, terminal.Result(".html", ".htm", is_resumed=True)] = None,
    sweep: terminal.Sweep,
    reading: terminal.Reading,
    force: terminal.Force = False,
) -> None:
    """Measure how well a change detector does, against distance ratio and tilt.

    Options
    -------
    detector: module:function, a command line with {reference}, {followup}, {homography} and {out},
        an ONNX file, a learned detector (.pt), or a built-in one: absolute-difference,
        colour-difference, ncc, ssim, ir-mad or changes.
    photographs: Photographs of the scene, or folders of them; may be repeated.
    out: Where to write evaluation.json; the figures are written beside it.
    psf: psf.json, or a PSF of your own.
    zooms: Distance ratios, each at least 1.
    tilts: Tilts of the follow-up in degrees; with --focal-length-px.
    noise: Standard deviations of the noise of both photographs in DN, S[,S...].
    contrast: Peaks of the change in DN, C[,C...], negative for darker ones, 12 by default; with
        --patch or --after, the fraction of the full change, 1 by default.
    signal_sigma: Sigma of the Gaussian change, in px of the photographs.
    patch: Picture to paste as the change instead, weighted by its alpha channel.
    after: Folder of later photographs of the same scenes, with the same names; needs --masks.
    masks: Folder of masks of what changed, with the same names as the photographs.
    pairs: Number of pairs with a change, and of pairs without, per photograph and condition.
    crop: Side of the reference of a pair in px.
    model: Capture model.
    seed: Seed for everything random.
    timeout_s: Longest time, in s, allowed for one pair.
    report: Also write a report page (HTML).
    """
    is_part = sweep.part[1] > 1  # which writes no curves
    replaces = is_part or terminal.is_same_command(library.evaluation_made_by(out))
    results = [path for path in (out, report) if path is not None]
    terminal.refuse_replacing(*results, may_replace=replaces)
    terminal.refuse_replacing(*library.evaluation_figure_paths(out), may_replace=replaces)
    library.require_writable(results)
    is_spot = patch is None and after is None
    found = library.evaluate(
        detector,
        photographs,
        psf,
        _task(
            zooms=tuple(sorted(terminal.number_list(zooms, _ZOOMS))),
            tilts_deg=tuple(terminal.number_list(tilts, _TILTS)),
            noises_dn=tuple(terminal.number_list(noise, _NOISES)),
            contrasts_dn=tuple(
                terminal.number_list(contrast or ("12" if is_spot else "1"), _CONTRASTS)
            ),
            change=library.Spot(sigma_px=signal_sigma)
            if patch is None
            else library.patch_of(patch, reading),
            model=model,
            reference_zoom=reference_zoom,
            crop_px=crop,
            crops=pairs,
            focal_length_px=focal_length_px,
            focus_scatter_px2=focus_scatter,
            light_scatter=light_scatter,
            seed=seed,
        ),
        **terminal.keywords_of(library.evaluate, state=out.with_suffix(".sweep")),
    )
    terminal.note_once(found.notes)
    done = found.photographs
    if found.evaluation is None:
        terminal.say_part(sweep, done, "photographs scored", writes="writes the curves")
    else:
        _show(out, found.write(out, report=report), found.evaluation)
    terminal.end_refused(done, "used", "the curves are from the {others}")


def _task(**values: object) -> EvaluationTask:
    from analysis.evaluation import EvaluationTask

    try:
        return EvaluationTask(**values)  # type: ignore[arg-type]
    except ValueError as error:
        raise BadParameter(str(error)) from error


def _show(out: Path, figures: list[Path], found: Evaluation) -> None:
    files = [str(path) for path in figures]
    if terminal.wants_json():
        from calibration.documents import json_object

        terminal.print_json({"out": str(out), "figures": files, **json_object(found)})
        return
    first = found.curves[0]
    terminal.print_table(
        f"AUC of {found.detector} against zoom, with its 95 % interval",
        ["zoom", *(f"{zoom:g}" for zoom in first.zoom)],
        [
            [
                curve.name,
                *(
                    f"{auc:.3f} ({low:.3f}-{high:.3f})"
                    for auc, low, high in zip(curve.auc, curve.auc_low, curve.auc_high, strict=True)
                ),
            ]
            for curve in found.curves
        ],
    )
    terminal.say(
        *filter(None, (found.failed_sentence, found.too_few_sentence)),
        "registration, gloss, parallax and motion are not in the pairs",
        f"wrote {out} and {', '.join(files)}",
    )
