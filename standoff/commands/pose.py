"""``standoff pose``: whether a follow-up's pose allows the comparison, once or live."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from analysis.choices import Criterion
from calibration.errors import CalibrationError
from standoff.terminal import (
    HINT_RULES,
    BenchKeys,
    CurveContrast,
    CurveModel,
    CurveNoise,
    CurveObserver,
    CurvesPath,
    EncodingName,
    ExpectZoom,
    Force,
    Json,
    Mask,
    Mean,
    MinDprime,
    Page,
    PartOfShards,
    Points,
    PoseHint,
    Scheduler,
    Strict,
    Workers,
    check_options,
    chosen_curve,
    command_line,
    exactly_one,
    needs,
    note,
    note_at_end,
    photograph_inputs,
    place_target,
    print_few,
    print_json,
    print_json_file,
    read_bench,
    refuse_overwriting,
    refuse_suffix,
    refuse_sweep_of_one,
    report_refused,
    say,
    say_part,
    sweep_options,
)

if TYPE_CHECKING:
    from analysis.pose import JudgedFollowup, PoseQuality, PoseSeries, PoseSummary
    from standoff.photographs import Inputs
    from standoff.workflows import (
        NamedFrame,
        PoseDemand,
        SeriesRequest,
        SeriesResult,
        StreamSummary,
    )


_HINTS = ("expect_zoom", "homography", "points", "mask")
_RULES = (
    *HINT_RULES,
    exactly_one("followup", "stream", "bench"),
    needs("target", "bench"),
    needs("settings", "bench"),
    needs("watch", "stream"),
    needs("psf", "followup"),
    *(
        needs(option, "followup")
        for option in (*_HINTS, "picture", "out", "workers", "scheduler", "shard", "strict")
    ),
    needs("frames", "stream", "bench"),
)


_UPPER_BOUND = (
    "d' is an upper bound: registration, light, gloss, parallax and defocus only lower it"
)


def pose(
    context: typer.Context,
    reference: Annotated[Path, typer.Argument(help="The earlier, nearer photograph.")],
    followup: Annotated[
        list[Path] | None,
        typer.Argument(
            help="The photograph whose pose is judged, several, or a folder of them; unless live."
        ),
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
    expect_zoom: ExpectZoom = None,
    homography: PoseHint = None,
    points: Points = None,
    mask: Mask = None,
    picture: Annotated[
        Path | None, typer.Option(help="Also write a map of d' (PNG or SVG).")
    ] = None,
    out: Annotated[
        Path | None,
        typer.Option(help="Folder for the results of several follow-ups; it is resumed."),
    ] = None,
    workers: Workers = 1,
    scheduler: Scheduler = None,
    shard: PartOfShards = "1/1",
    strict: Strict = False,
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
    force: Force = False,
    json: Json = False,
) -> None:
    """Accept or reject a follow-up's pose by the d' that it allows over the frame.

    Live (--stream or --bench), it tracks the pose from frame to frame and accepts or rejects
    each one, with the margin; Ctrl-C ends it with status 130.
    """
    check_options(context, _RULES)
    refuse_suffix(picture, "--picture", {".png", ".svg"})
    followups = tuple(followup or ())
    inputs_given = [reference, *followups, curves, psf, homography, points, mask]
    refuse_overwriting([picture], inputs_given, force=force)
    sweep = sweep_options(workers, scheduler, shard, is_strict=strict)
    from standoff.workflows import (
        FILES_OF_POSE_SERIES,
        POSES_TABLE,
        HintFiles,
        PoseDemand,
        SeriesRequest,
        holds_series,
        is_series,
        judge_series,
        read_camera_psf,
        read_hints,
        require_writable,
    )

    hints = HintFiles(zoom=expect_zoom, homography=homography, points=points, mask=mask)
    inputs = photograph_inputs(encoding, page, mean, files=(curves, psf, *hints.paths))
    require_writable([picture])
    demand = PoseDemand(
        curve=chosen_curve(curves, min_dprime, model, observer, noise, contrast),
        min_d_prime=min_dprime,
        criterion=criterion,
        psf=None if psf is None else read_camera_psf(psf).gaussian,
        hints=read_hints(hints),
    )
    if is_series(followups):
        request = SeriesRequest(
            reference=reference,
            followups=followups,
            out=_folder_of_series(out, picture),
            inputs=inputs,
            sweep=sweep,
        )
        if not holds_series(request.out, POSES_TABLE):
            refuse_overwriting(
                [request.out / name for name in FILES_OF_POSE_SERIES], inputs_given, force=force
            )
        _show_series(request, judge_series(request, demand), json=json)
        return
    if followups:
        refuse_sweep_of_one(sweep)
        _judge_one(reference, followups[0], demand, inputs, picture, json=json)
        return
    source = _frames(stream, inputs, bench, settings, target, is_watched=watch)
    _judge_live(reference, source, demand, inputs, frames, is_bench=bench is not None, json=json)


def _judge_live(
    reference: Path,
    source: AbstractContextManager[Iterator[NamedFrame]],
    demand: PoseDemand,
    inputs: Inputs,
    count: int | None,
    *,
    is_bench: bool,
    json: bool,
) -> None:
    from analysis.pose import PoseTracker
    from standoff.workflows import StreamSummary, judge_stream, verdict_display

    near = inputs.grey(reference)
    try:
        tracker = PoseTracker(near, demand.curve, demand.min_d_prime, demand.criterion)
    except (CalibrationError, ValueError) as error:
        raise CalibrationError(f"{reference}: {error}") from error
    summary = StreamSummary()
    try:
        with source as frames, verdict_display(is_live=is_bench, is_silent=json) as show:
            judge_stream(frames, tracker, summary, show, count=count, is_kept=not is_bench)
    finally:
        # Ctrl-C is the normal way to end this: the summary is shown then, too.
        if summary.frames:
            _show_stream(summary, demand, inputs, json=json)


def _folder_of_series(out: Path | None, picture: Path | None) -> Path:
    if out is None:
        raise typer.BadParameter("several follow-ups need --out DIR", param_hint="--out")
    if picture is not None:
        raise typer.BadParameter("only one follow-up has a picture", param_hint="--picture")
    return out


def _judge_one(
    reference: Path,
    followup: Path,
    demand: PoseDemand,
    inputs: Inputs,
    picture: Path | None,
    *,
    json: bool,
) -> None:
    from analysis.reports import plot_pose
    from standoff.workflows import judged_pose, write_figure

    near, far = inputs.photograph(reference), inputs.photograph(followup)
    found = judged_pose(near, far, demand)
    if picture is not None:
        write_figure(picture, plot_pose(far.grey_dn, found.quality))
    for warning in found.warnings:
        note_at_end(warning)
    judged = found.summary.model_copy(
        update={
            "picture": None if picture is None else str(picture),
            "provenance": inputs.provenance(command_line()),
        }
    )
    _show_one(found.quality, judged, json=json)


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
    from standoff.workflows import beyond_curve_sentence

    curve = quality.curve
    if quality.beyond_curve:
        note(beyond_curve_sentence(quality))
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
    say(_UPPER_BOUND)


def _show_series(
    request: SeriesRequest, found: SeriesResult[PoseSeries, JudgedFollowup], *, json: bool
) -> None:
    document = found.document
    if document is None:
        say_part(request.out, found.sweep, request.sweep, json=json)
    elif json:
        print_json_file(found.summary)
    else:
        print_few(
            ("Follow-ups", "First follow-ups", "Follow-ups with the least d'"),
            ["follow-up", "verdict", "d'", "zoom", "overlap"],
            _cells,
            found.first,
            found.worst,
        )
        say(
            f"{document.accepted} of {document.accepted + document.rejected} poses accepted: "
            f"{document.criterion} d' of at least {document.min_dprime:g} "
            f"({found.sweep.found_done} already done); wrote {request.out}"
        )
        say(_UPPER_BOUND)
    report_refused(found.sweep, "the verdicts on the others are complete")


def _cells(one: JudgedFollowup) -> list[str]:
    name = Path(one.followup).name
    if one.overlap is None:
        return [name, "none", "", "", ""]
    return [
        name,
        "accepted" if one.is_accepted else "rejected",
        f"{one.dprime_decisive:.2f}",
        f"{one.zoom_min:.3f} to {one.zoom_max:.3f}",
        f"{100 * one.overlap:.0f} %",
    ]


def _show_stream(summary: StreamSummary, demand: PoseDemand, inputs: Inputs, *, json: bool) -> None:
    from standoff.workflows import verdict_facts

    assert summary.last is not None
    if json:
        print_json(
            {
                "criterion": demand.criterion,
                "min_dprime": demand.min_d_prime,
                "curve": demand.curve.choice.model_dump(),
                "is_upper_bound": True,
                "provenance": inputs.provenance(command_line()).model_dump(mode="json"),
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
