"""``standoff pose``: whether a follow-up's pose allows the comparison, once or live."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from analysis.choices import Criterion
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
    ShownProgress,
    Strict,
    Workers,
    check_options,
    curve_choice,
    exactly_one,
    needs,
    note,
    note_once,
    place_target,
    print_few,
    print_json,
    print_json_file,
    read_bench,
    reading_options,
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
    from analysis.sweep import SweepOptions
    from standoff.library import NamedFrame, PoseWatch, SeriesResult


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
    import standoff.library as library

    library.require_writable([picture])
    choice = curve_choice(model, observer, noise, contrast)
    read_as = reading_options(encoding, page, mean)
    how: dict[str, Any] = {
        "choice": choice,
        "criterion": criterion,
        "psf": psf,
        "hints": library.alignment_hints(
            expect_zoom, homography=homography, points=points, mask=mask
        ),
        "reading": read_as,
        "progress": ShownProgress(),
    }
    if library.is_series(followups):
        folder = _folder_of_series(out, picture)
        if not library.holds_series(folder, library.POSES_TABLE):
            results = [folder / name for name in library.FILES_OF_POSE_SERIES]
            refuse_overwriting(results, inputs_given, force=force)
        series = library.judge_poses(
            reference,
            followups,
            folder,
            curves,
            min_dprime,
            sweep=sweep,
            **how,
        )
        _show_series(folder, series, sweep, json=json)
        return
    if followups:
        refuse_sweep_of_one(sweep)
        found = library.judge_pose(
            reference,
            followups[0],
            curves,
            min_dprime,
            **how,
        )
        if picture is not None:
            found.write_picture(picture)
        note_once(found.notes)
        if json:
            print_json(found.to_json(picture))
            return
        _show_one(found.quality, found.summary)
        return
    watched = library.PoseWatch(
        reference, curves, min_dprime, choice=choice, criterion=criterion, reading=read_as
    )
    with _frames(watched, stream, bench, settings, target, is_watched=watch) as source:
        _watch(watched, source, frames, is_bench=bench is not None, json=json)


def _watch(
    watched: PoseWatch,
    frames: Iterator[NamedFrame],
    count: int | None,
    *,
    is_bench: bool,
    json: bool,
) -> None:
    from standoff.terminal import verdict_display

    try:
        with verdict_display(is_live=is_bench, is_silent=json) as show:
            watched.run(frames, show, count=count, is_kept=not is_bench)
    finally:
        # Ctrl-C is the normal way to end this: the summary is shown then, too.
        if watched.summary.frames:
            _show_stream(watched, json=json)
    note_once(watched.notes)


def _folder_of_series(out: Path | None, picture: Path | None) -> Path:
    if out is None:
        raise typer.BadParameter("several follow-ups need --out DIR", param_hint="--out")
    if picture is not None:
        raise typer.BadParameter("only one follow-up has a picture", param_hint="--picture")
    return out


@contextmanager
def _frames(
    watched: PoseWatch,
    stream: Path | None,
    bench: Path | None,
    settings: list[str] | None,
    target: str | None,
    *,
    is_watched: bool,
) -> Iterator[Iterator[NamedFrame]]:
    from standoff.library import camera_frames, opened_camera

    if stream is not None:
        if not stream.is_dir():
            raise typer.BadParameter(f"{stream} is not a folder", param_hint="--stream")
        yield watched.folder(stream, is_watched=is_watched)
    if bench is not None:
        with opened_camera(read_bench(bench, settings)) as opened:
            for warning in opened.warnings:
                note(warning)
            if target is not None:
                place_target(opened.simulated, target)
            with camera_frames(opened) as source:
                yield source


def _show_one(quality: PoseQuality, summary: PoseSummary) -> None:
    say(
        f"{'accepted' if quality.is_accepted else 'rejected'}: {quality.criterion} d' "
        f"{quality.decisive_d_prime:.2f}, threshold {quality.min_d_prime:g} ({quality.curve.name})"
    )
    say(
        f"local zoom {summary.zoom_min:.3f} to {summary.zoom_max:.3f}, anisotropy up to "
        f"{summary.anisotropy_max:.3f}, overlap {100 * summary.overlap:.0f} % of the follow-up"
    )
    say(_UPPER_BOUND)


def _show_series(
    out: Path,
    found: SeriesResult[PoseSeries, JudgedFollowup],
    options: SweepOptions,
    *,
    json: bool,
) -> None:
    document = found.document
    note_once(found.notes)
    if document is None:
        say_part(out, found.sweep, options, json=json)
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
            f"({found.sweep.found_done} already done); wrote {out}"
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


def _show_stream(watched: PoseWatch, *, json: bool) -> None:
    summary = watched.summary
    assert summary.last is not None
    if json:
        print_json(watched.to_json())
        return
    rate = summary.frames_per_s
    say(
        f"{summary.accepted} of {summary.frames} frames accepted; full-frame searches: "
        f"{summary.anchors}, pose not found: {summary.unknown}"
        + ("" if rate is None else f"; tracking at {rate:.0f} frames per second")
    )
    say(f"last: {summary.last.reason}")
