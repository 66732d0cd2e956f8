"""``standoff pose``: whether a follow-up's pose allows the comparison, once or live."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, BadParameter, Context, Option

from analysis.choices import Criterion, acceptance
from standoff import library, terminal

if TYPE_CHECKING:
    from analysis.pose import JudgedFollowup, PoseQuality, PoseSeries, PoseSummary
    from analysis.sweep import SweepOptions

_HINTS = ("expect_zoom", "homography", "points", "mask", "mirrored")
_RULES = (
    *terminal.HINT_RULES,
    terminal.exactly_one("followup", "stream", "bench"),
    terminal.needs("target", "bench"),
    terminal.needs("settings", "bench"),
    terminal.needs("watch", "stream"),
    terminal.needs("psf", "followup"),
    *(
        terminal.needs(option, "followup")
        for option in (*_HINTS, "picture", "out", "workers", "scheduler", "shard", "strict")
    ),
    terminal.needs("frames", "stream", "bench"),
)


def pose(
    context: Context,
    reference: Annotated[Path, Argument(help="The earlier, nearer photograph.")],
    followup: Annotated[
        list[Path] | None,
        Argument(
            help="The photograph whose pose is judged, several, or a folder of them; unless live."
        ),
    ] = None,
    *,
    curves: terminal.CurvesPath,
    min_dprime: terminal.MinDprime,
    criterion: Annotated[
        Criterion,
        Option(help="d' reaches the threshold in all of the overlap (min) or 95 % (quantile)."),
    ] = "min",
    psf: Annotated[
        Path | None,
        Option(help="psf.json, or a PSF of your own, for a finer registration."),
    ] = None,
    expect_zoom: terminal.ExpectZoom = None,
    homography: terminal.PoseHint = None,
    points: terminal.Points = None,
    mask: terminal.Mask = None,
    mirrored: terminal.Mirrored = False,
    picture: Annotated[Path | None, Option(help="Also write a map of d' (PNG or SVG).")] = None,
    out: Annotated[
        Path | None, Option(help="Folder for the results of several follow-ups; it is resumed.")
    ] = None,
    parquet: terminal.AsParquet = False,
    workers: terminal.Workers = 1,
    scheduler: terminal.Scheduler = None,
    shard: terminal.PartOfShards = "1/1",
    strict: terminal.Strict = False,
    stream: Annotated[
        Path | None, Option(metavar="FOLDER", help="Live: judge the images in a folder.")
    ] = None,
    watch: Annotated[
        bool, Option("--watch", help="With --stream: wait for more images, until Ctrl-C.")
    ] = False,
    bench: Annotated[
        Path | None, Option(help="Live: judge the camera frames of this bench file (TOML).")
    ] = None,
    frames: Annotated[int | None, Option(min=1, help="Live: end after this many frames.")] = None,
    target: Annotated[str | None, Option(help="Live: target under a simulated camera.")] = None,
    settings: terminal.BenchKeys = None,
    focus_scatter: terminal.FocusScatter = None,
    model: terminal.CurveModel = None,
    observer: terminal.CurveObserver = None,
    noise: terminal.CurveNoise = None,
    contrast: terminal.CurveContrast = None,
    encoding: terminal.EncodingName = "auto",
    page: terminal.Page = None,
    mean: terminal.Mean = False,
    force: terminal.Force = False,
    json: terminal.Json = False,
) -> None:
    """Align a follow-up with its reference, and accept or reject its pose by the d' it allows.

    Live (--stream or --bench), it tracks the pose from frame to frame and accepts or rejects
    each one, with the margin; Ctrl-C ends it with status 130.
    """
    terminal.check_options(context, _RULES)
    terminal.refuse_suffix(picture, "--picture", {".png", ".svg"})
    followups = tuple(followup or ())
    inputs_given = [reference, *followups, curves, psf, homography, points, mask]
    terminal.refuse_overwriting([picture], inputs_given, force=force)
    sweep = terminal.sweep_options(workers, scheduler, shard, is_strict=strict)
    library.require_writable([picture])
    always: dict[str, Any] = {
        "choice": terminal.curve_choice(model, observer, noise, contrast),
        "criterion": criterion,
        "focus_scatter_px2": focus_scatter,
        "reading": terminal.reading_options(encoding, page, mean),
    }
    how: dict[str, Any] = {
        **always,
        "psf": psf,
        "hints": library.alignment_hints(
            expect_zoom, homography=homography, points=points, mask=mask, mirrored=mirrored
        ),
        "progress": terminal.ShownProgress(),
    }
    if library.is_series(followups):
        if out is None:
            raise BadParameter("several follow-ups need --out DIR", param_hint="--out")
        if picture is not None:
            raise BadParameter("only one follow-up has a picture", param_hint="--picture")
        if not library.holds_series(out, library.POSES_TABLE):
            results = [out / name for name in library.FILES_OF_POSE_SERIES]
            terminal.refuse_overwriting(results, inputs_given, force=force)
        series = library.judge_poses(
            reference, followups, out, curves, min_dprime, parquet=parquet, sweep=sweep, **how
        )
        _show_series(out, series, sweep, json=json)
        return
    if followups:
        if out is not None:
            raise BadParameter("--out needs several follow-ups, or a folder of them")
        terminal.refuse_sweep_of_one(sweep, parquet=parquet)
        found = library.judge_pose(reference, followups[0], curves, min_dprime, **how)
        if picture is not None:
            found.write_picture(picture)
        terminal.note_once(found.notes)
        if json:
            terminal.print_json(found.to_json(picture))
        else:
            _show_one(found.quality, found.summary)
        return
    watched = library.PoseWatch(reference, curves, min_dprime, **always)
    if stream is not None:
        if not stream.is_dir():
            raise BadParameter(f"{stream} is not a folder", param_hint="--stream")
        source = watched.folder(stream, is_watched=watch)
        _watch(watched, source, frames, is_live=False, json=json)
    if bench is not None:
        config = terminal.read_bench(bench, settings)
        with watched.camera(config, target=target, progress=terminal.ShownProgress()) as source:
            _watch(watched, source, frames, is_live=True, json=json)


def _watch(
    watched: library.PoseWatch,
    source: Iterator[library.NamedFrame],
    count: int | None,
    *,
    is_live: bool,
    json: bool,
) -> None:
    try:
        with terminal.verdict_display(is_live=is_live, is_silent=json) as show:
            watched.run(source, show, count=count, is_kept=not is_live)
    finally:
        # Ctrl-C is the normal way to end this: the summary is shown then, too.
        if watched.summary.frames:
            _show_stream(watched, json=json)
    terminal.note_once(watched.notes)


def _show_one(quality: PoseQuality, summary: PoseSummary) -> None:
    from analysis.detection_limits import spot_sentence

    decision = quality.decision
    word = acceptance(quality.is_accepted)
    terminal.say(
        f"{word}: {quality.criterion} d' {quality.decisive_d_prime:.2f}, threshold "
        f"{quality.min_d_prime:g} ({quality.curve.name})",
        f"{decision.verdict}: {decision.sentence}",
        *filter(None, (decision.unknown_sentence,)),
        f"local zoom {summary.zoom_min:.3f} to {summary.zoom_max:.3f}, anisotropy up to "
        f"{summary.anisotropy_max:.3f}, overlap {100 * summary.overlap:.0f} % of the follow-up",
        terminal.UPPER_BOUND,
    )
    if summary.detection_limit is not None:
        terminal.say(spot_sentence(summary.detection_limit))


def _show_series(
    out: Path,
    found: library.SeriesResult[PoseSeries, JudgedFollowup],
    options: SweepOptions,
    *,
    json: bool,
) -> None:
    document = found.document
    terminal.note_once(found.notes)
    if document is None:
        terminal.say_part(out, found.sweep, options, json=json)
    elif json:
        terminal.print_json_file(found.summary)
    else:
        terminal.print_few(
            ["follow-up", "verdict", "d'", "zoom", "overlap"],
            _cells,
            found,
            "Follow-ups with the least d'",
        )
        terminal.say(
            f"{document.accepted} of {document.accepted + document.rejected} poses accepted"
            f"{_of_unsure(document.unsure)}: {document.criterion} d' of at least "
            f"{document.min_dprime:g} ({found.sweep.found_done} already done); wrote {out}",
            terminal.UPPER_BOUND,
        )
    terminal.report_refused(found.sweep, "the verdicts on the others are complete")


def _cells(one: JudgedFollowup) -> list[str]:
    if one.overlap is None:
        return [Path(one.followup).name, "none", "", "", ""]
    return [
        Path(one.followup).name,
        one.verdict or "",
        f"{one.dprime_decisive:.2f}",
        f"{one.zoom_min:.3f} to {one.zoom_max:.3f}",
        f"{100 * one.overlap:.0f} %",
    ]


def _of_unsure(count: int | None) -> str:
    return f", {count} of all unsure" if count else ""


def _show_stream(watched: library.PoseWatch, *, json: bool) -> None:
    summary = watched.summary
    assert summary.last is not None
    if json:
        terminal.print_json(watched.to_json())
        return
    rate = summary.frames_per_s
    terminal.say(
        f"{summary.accepted} of {summary.frames} frames accepted; full-frame searches: "
        f"{summary.anchors}, pose not found: {summary.unknown}"
        + ("" if rate is None else f"; tracking at {rate:.0f} frames per second"),
        f"last: {summary.last.reason}",
    )
