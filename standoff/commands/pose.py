"""``standoff pose``: whether a follow-up's pose allows the comparison, once or live."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from analysis.choices import Criterion
from calibration.errors import CalibrationError
from standoff.terminal import (
    BenchKeys,
    CurveContrast,
    CurveModel,
    CurveNoise,
    CurveObserver,
    CurvesPath,
    EncodingName,
    Json,
    Mean,
    MinDprime,
    Page,
    check_options,
    chosen_curve,
    command_line,
    exactly_one,
    needs,
    note,
    photograph_inputs,
    place_target,
    print_json,
    read_bench,
    refuse_overwriting,
    refuse_suffix,
    say,
)

if TYPE_CHECKING:
    from analysis.pose import PoseQuality, PoseSummary
    from standoff.photographs import Inputs
    from standoff.workflows import NamedFrame, StreamSummary


_RULES = (
    exactly_one("followup", "stream", "bench"),
    needs("target", "bench"),
    needs("settings", "bench"),
    needs("watch", "stream"),
    needs("psf", "followup"),
    needs("picture", "followup"),
    needs("frames", "stream", "bench"),
)


def pose(
    context: typer.Context,
    reference: Annotated[Path, typer.Argument(help="The earlier, nearer photograph.")],
    followup: Annotated[
        Path | None, typer.Argument(help="The photograph whose pose is judged, unless live.")
    ] = None,
    *,
    curves: CurvesPath,
    min_dprime: MinDprime,
    criterion: Annotated[
        Criterion,
        typer.Option(
            help="d' reaches the threshold in all of the overlap (min) or 95 % (quantile)."
        ),
    ] = "min",
    psf: Annotated[
        Path | None, typer.Option(help="psf.json of the camera, for a finer registration.")
    ] = None,
    picture: Annotated[
        Path | None, typer.Option(help="Also write a map of d' (PNG or SVG).")
    ] = None,
    stream: Annotated[
        Path | None, typer.Option(metavar="FOLDER", help="Live: judge the images in a folder.")
    ] = None,
    watch: Annotated[
        bool, typer.Option("--watch", help="With --stream: wait for more images, until Ctrl-C.")
    ] = False,
    bench: Annotated[
        Path | None, typer.Option(help="Live: judge the camera frames of this bench file (TOML).")
    ] = None,
    frames: Annotated[
        int | None, typer.Option(min=1, help="Live: end after this many frames.")
    ] = None,
    target: Annotated[
        str | None, typer.Option(help="Live: target under a simulated camera.")
    ] = None,
    settings: BenchKeys = None,
    model: CurveModel = None,
    observer: CurveObserver = None,
    noise: CurveNoise = None,
    contrast: CurveContrast = None,
    encoding: EncodingName = "auto",
    page: Page = None,
    mean: Mean = False,
    json: Json = False,
) -> None:
    """Accept or reject a follow-up's pose by the d' that it allows over the frame.

    Live (--stream or --bench), it tracks the pose from frame to frame and accepts or rejects
    each one, with the margin; Ctrl-C ends it with status 130.
    """
    check_options(context, _RULES)
    refuse_suffix(picture, "--picture", {".png", ".svg"})
    refuse_overwriting([picture], [reference, followup, curves, psf])
    from standoff.workflows import require_writable

    inputs = photograph_inputs(encoding, page, mean, files=(curves, psf))
    require_writable([picture])
    curve = chosen_curve(curves, min_dprime, model, observer, noise, contrast)
    near = inputs.grey(reference)
    about: dict[str, object] = {
        "criterion": criterion,
        "min_dprime": min_dprime,
        "curve": curve.model_dump(include={"model", "observer", "noise_dn", "contrast_dn"}),
        "is_upper_bound": True,
    }
    if followup is not None:
        from analysis.pose import judge_pose
        from analysis.reports import plot_pose
        from calibration.registration import register
        from standoff.workflows import read_camera_psf, write_figure

        far = inputs.grey(followup)
        total = None if psf is None else read_camera_psf(psf).gaussian
        try:
            found = register(near, far, total)
        except CalibrationError as error:
            raise CalibrationError(f"{followup}: {error}") from error
        sizes = (far.shape[1], far.shape[0]), (near.shape[1], near.shape[0])
        quality = judge_pose(found.matrix, *sizes, curve, min_dprime, criterion)
        if picture is not None:
            write_figure(picture, plot_pose(far, quality))
        judged = quality.summary.model_copy(
            update={
                "registration_correlation": found.correlation,
                "picture": None if picture is None else str(picture),
                "provenance": inputs.provenance(command_line()),
            }
        )
        _show_one(quality, judged, json=json)
        return
    from analysis.pose import PoseTracker
    from standoff.workflows import StreamSummary, judge_stream, verdict_display

    try:
        tracker = PoseTracker(near, curve, min_dprime, criterion)
    except (CalibrationError, ValueError) as error:
        raise CalibrationError(f"{reference}: {error}") from error
    summary = StreamSummary()
    is_bench = bench is not None
    try:
        with (
            _frames(stream, inputs, bench, settings, target, is_watched=watch) as source,
            verdict_display(is_live=is_bench, is_silent=json) as show,
        ):
            judge_stream(source, tracker, summary, show, count=frames, is_kept=not is_bench)
    finally:
        # Ctrl-C is the normal way to end this: the summary is shown then, too.
        if summary.frames:
            about["provenance"] = inputs.provenance(command_line()).model_dump(mode="json")
            _show_stream(summary, about, json=json)


@contextmanager
def _frames(
    stream: Path | None,
    inputs: Inputs,
    bench: Path | None,
    settings: list[str] | None,
    target: str | None,
    *,
    is_watched: bool,
) -> Iterator[Iterator[NamedFrame]]:
    from standoff.workflows import camera_frames, folder_frames, opened_camera

    if stream is not None:
        if not stream.is_dir():
            raise typer.BadParameter(f"{stream} is not a folder", param_hint="--stream")
        yield folder_frames(stream, inputs, is_watched=is_watched)
    if bench is not None:
        with opened_camera(read_bench(bench, settings)) as opened:
            for warning in opened.warnings:
                note(warning)
            if target is not None:
                place_target(opened.simulated, target)
            with camera_frames(opened) as source:
                yield source


def _show_one(quality: PoseQuality, summary: PoseSummary, *, json: bool) -> None:
    curve = quality.curve
    if quality.beyond_curve:
        note(
            f"{100 * quality.beyond_curve:.0f} % of the overlap lies beyond the curve's zoom of "
            f"{curve.zoom[-1]:g}; its d' is taken as 0"
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
    from standoff.workflows import verdict_facts

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
        f"{summary.accepted} of {summary.frames} frames accepted; full-frame searches: "
        f"{summary.anchors}, pose not found: {summary.unknown}"
        + ("" if rate is None else f"; tracking at {rate:.0f} frames per second")
    )
    say(f"last: {summary.last.reason}")
