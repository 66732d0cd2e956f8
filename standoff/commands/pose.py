"""``standoff pose``: whether a follow-up's pose allows the comparison, once or live."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray

from analysis.detectability import DetectabilityCurve
from analysis.pose import Criterion, PoseQuality, PoseTracker, judge_pose
from analysis.reports import plot_pose, png_bytes, svg_bytes
from calibration.errors import CalibrationError
from calibration.registration import Registration, register
from hil_mocks import SimulatedBench
from simulation import GaussianPsf
from standoff.commands.simulate import read_total_psf
from standoff.terminal import (
    BenchKeys,
    CurveContrast,
    CurveModel,
    CurveNoise,
    CurveObserver,
    CurvesPath,
    Json,
    MinDprime,
    chosen_curve,
    note,
    print_json,
    read_bench,
    refuse_overwriting,
    refuse_suffix,
    say,
)
from standoff.workflows import (
    NamedFrame,
    StreamSummary,
    camera_frames,
    folder_frames,
    judge_stream,
    opened_camera,
    read_grey,
    require_writable,
    verdict_display,
    verdict_facts,
    write_file,
)

__all__ = ["pose"]


def pose(
    reference: Annotated[Path, typer.Argument(help="The earlier, nearer image.")],
    followup: Annotated[
        Path | None, typer.Argument(help="The image whose pose is judged, unless live.")
    ] = None,
    *,
    curves: CurvesPath,
    min_dprime: MinDprime,
    criterion: Annotated[
        Criterion,
        typer.Option(help="d' reaches the threshold everywhere (min) or in 95 % (quantile)."),
    ] = "min",
    psf: Annotated[Path | None, typer.Option(help="psf.json: a finer registration.")] = None,
    picture: Annotated[Path | None, typer.Option(help="Map to write: PNG or SVG.")] = None,
    stream: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Live: judge the images of a folder.")
    ] = None,
    watch: Annotated[
        bool, typer.Option("--watch", help="With --stream: wait for more, until Ctrl-C.")
    ] = False,
    bench: Annotated[
        Path | None, typer.Option(help="Live: judge the frames of a bench's camera (TOML).")
    ] = None,
    frames: Annotated[
        int | None, typer.Option(min=1, help="Live: end after so many frames.")
    ] = None,
    target: Annotated[
        str | None, typer.Option(help="Live: what lies under a simulated camera.")
    ] = None,
    settings: BenchKeys = None,
    model: CurveModel = None,
    observer: CurveObserver = None,
    noise: CurveNoise = None,
    contrast: CurveContrast = None,
    json: Json = False,
) -> None:
    """Accept or reject a follow-up's pose by the d' that it allows at every place.

    Live (--stream or --bench) it follows the pose from frame to frame, and says for each one
    whether it would do and by which margin; Ctrl-C ends it with status 130.
    """
    if [followup, stream, bench].count(None) != 2:
        raise typer.BadParameter("give one of FOLLOWUP, --stream and --bench")
    is_bench = bench is not None
    if not is_bench and (target is not None or settings):
        raise typer.BadParameter("--target and --set go with --bench")
    if stream is None and watch:
        raise typer.BadParameter("--watch goes with --stream")
    if followup is None and (psf is not None or picture is not None):
        raise typer.BadParameter("--psf and --picture go with FOLLOWUP")
    if followup is not None and frames is not None:
        raise typer.BadParameter("--frames goes with --stream and --bench")
    refuse_suffix(picture, "--picture", {".png", ".svg"})
    refuse_overwriting([picture], [reference, followup, curves, psf])
    require_writable([picture])
    curve = chosen_curve(curves, min_dprime, model, observer, noise, contrast)
    near = read_grey(reference)
    about: dict[str, object] = {
        "criterion": criterion,
        "min_dprime": min_dprime,
        "curve": curve.model_dump(include={"model", "observer", "noise_dn", "contrast_dn"}),
        "is_upper_bound": True,
    }
    if followup is not None:
        total = None if psf is None else read_total_psf(psf)
        found, quality = _judged(near, followup, total, curve, min_dprime, criterion)
        if picture is not None:
            figure = plot_pose(read_grey(followup), quality)
            write_file(
                picture, svg_bytes(figure) if picture.suffix == ".svg" else png_bytes(figure)
            )
        _show_one(found, quality, picture, json=json)
        return
    try:
        tracker = PoseTracker(near, curve, min_dprime, criterion)
    except (CalibrationError, ValueError) as error:
        raise CalibrationError(f"{reference}: {error}") from error
    summary = StreamSummary()
    try:
        with (
            _frames(stream, bench, settings, target, is_watched=watch) as source,
            verdict_display(is_live=is_bench, is_silent=json) as show,
        ):
            judge_stream(source, tracker, summary, show, count=frames, is_kept=not is_bench)
    finally:
        # Ctrl-C is how a person ends this: what was seen so far is told then, too.
        if summary.frames:
            _show_stream(summary, about, json=json)


@contextmanager
def _frames(
    stream: Path | None,
    bench: Path | None,
    settings: list[str] | None,
    target: str | None,
    *,
    is_watched: bool,
) -> Iterator[Iterator[NamedFrame]]:
    if stream is not None:
        if not stream.is_dir():
            raise typer.BadParameter(f"{stream} is no folder", param_hint="--stream")
        yield folder_frames(stream, is_watched=is_watched)
    if bench is not None:
        with opened_camera(read_bench(bench, settings)) as opened:
            for warning in opened.warnings:
                note(warning)
            if target is not None:
                _place(opened.simulated, target)
            with camera_frames(opened) as source:
                yield source


def _place(simulated: SimulatedBench | None, target: str) -> None:
    if simulated is None:
        raise typer.BadParameter("only a simulated bench is told its target", param_hint="--target")
    try:
        simulated.place(target)
    except ValueError as error:
        raise typer.BadParameter(str(error), param_hint="--target") from error


def _judged(
    near: NDArray[np.float64],
    followup: Path,
    psf: GaussianPsf | None,
    curve: DetectabilityCurve,
    min_dprime: float,
    criterion: Criterion,
) -> tuple[Registration, PoseQuality]:
    far = read_grey(followup)
    try:
        found = register(near, far, psf)
    except CalibrationError as error:
        raise CalibrationError(f"{followup}: {error}") from error
    sizes = (far.shape[1], far.shape[0]), (near.shape[1], near.shape[0])
    return found, judge_pose(found.matrix, *sizes, curve, min_dprime, criterion)


def _show_one(
    found: Registration, quality: PoseQuality, picture: Path | None, *, json: bool
) -> None:
    curve = quality.curve
    if quality.beyond_curve:
        note(
            f"{100 * quality.beyond_curve:.0f} % of the overlap lies beyond the curve's zoom of "
            f"{curve.zoom[-1]:g}; its d' is taken as 0"
        )
    summary = quality.summary.model_copy(
        update={
            "registration_correlation": found.correlation,
            "picture": None if picture is None else str(picture),
        }
    )
    if json:
        print_json(summary.model_dump(mode="json"))
        return
    say(
        f"{'accepted' if quality.is_accepted else 'rejected'}: {quality.criterion} d' "
        f"{quality.decisive_d_prime:.2f}, threshold {quality.min_d_prime:g} ({curve.name})"
    )
    say(
        f"local zoom {summary.zoom_min:.3f} to {summary.zoom_max:.3f}, anisotropy up to "
        f"{summary.anisotropy_max:.3f}, overlap {100 * summary.overlap:.0f} % of the follow-up"
    )
    say("d' is an upper bound: registration, light, gloss, parallax and defocus only lower it")


def _show_stream(summary: StreamSummary, about: dict[str, object], *, json: bool) -> None:
    assert summary.last is not None
    if json:
        print_json(
            {
                **about,
                "frames": summary.frames,
                "accepted": summary.accepted,
                "lost": summary.unknown,
                "anchors": summary.anchors,
                "frames_per_s": summary.frames_per_s,
                "last": verdict_facts(summary.last),
                "verdicts": summary.verdicts,
            }
        )
        return
    rate = summary.frames_per_s
    say(
        f"{summary.accepted} of {summary.frames} frames would do; whole frames searched: "
        f"{summary.anchors}, without success: {summary.unknown}"
        + ("" if rate is None else f"; between them {rate:.0f} frames a second")
    )
    say(f"last: {summary.last.reason}")
