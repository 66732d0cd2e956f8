"""``standoff pose`` and ``standoff limits``: which poses of the camera allow a comparison.

Those of follow-ups, once or live; and how far the camera may be moved.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from math import isfinite
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import BadParameter, Option

from analysis.choices import Criterion, acceptance
from standoff import library, terminal

if TYPE_CHECKING:
    from analysis.pose import JudgedFollowup, PoseLimits, PoseQuality, PoseSeries, PoseSummary
    from analysis.sweep import SweepOptions


@terminal.command(
    *terminal.HINT_RULES,
    terminal.exactly_one("followup", "stream", "bench"),
    terminal.needs("target", "bench"),
    terminal.needs("settings", "bench"),
    terminal.needs("watch", "stream"),
    terminal.needs("psf", "followup"),
    terminal.needs("flat", "followup"),
    *(
        terminal.needs(option, "followup")
        for option in (*terminal.HINTS, "picture", "out", "workers", "scheduler", "shard", "strict")
    ),
    terminal.needs("frames", "stream", "bench"),
)
def pose(
    reference: Path,
    followup: list[Path] | None = None,
    *,
    curves: terminal.CurvesPath,
    min_dprime: terminal.MinDprime,
    criterion: Criterion = "min",
    psf: Path | None = None,
    hints: terminal.Hints,
    flat: Annotated[bool, Option("--flat")] = False,
    picture: Annotated[Path | None, terminal.Result(".png", ".svg")] = None,
    out: Path | None = None,
    parquet: terminal.AsParquet = False,
    sweep: terminal.Sweep,
    stream: Annotated[Path | None, Option(metavar="FOLDER")] = None,
    watch: Annotated[bool, Option("--watch")] = False,
    bench: Path | None = None,
    frames: Annotated[int | None, Option(min=1)] = None,
    target: str | None = None,
    settings: terminal.BenchKeys = None,
    focus_scatter_px2: terminal.FocusScatter = None,
    choice: terminal.Choice,
    reading: terminal.Reading,
) -> None:
    """Align a follow-up with its reference, and accept or reject its pose by the d' it allows.

    Live (--stream or --bench), it tracks the pose from frame to frame and accepts or rejects
    each one, with the margin; Ctrl-C ends it with status 130.

    Options
    -------
    reference: The earlier, nearer photograph.
    followup: The photograph whose pose is judged, or several, or a folder; not used live.
    criterion: d' must reach the threshold in all of the overlap (min) or in 95 % of it (quantile).
    psf: psf.json, or a PSF of your own, for a finer registration.
    flat: Treat the scene as a plane; by default, the parallax of a scene with depth is looked for.
    picture: Also write a map of d' (PNG or SVG).
    out: Folder for the results of several follow-ups; an existing one is resumed.
    stream: Live: judge the images in a folder.
    watch: With --stream: wait for more images, until Ctrl-C.
    bench: Live: judge the camera frames of this bench file (TOML).
    frames: Live: end after this many frames.
    target: Live: target under a simulated camera.
    """
    followups = tuple(followup or ())
    if library.is_series(followups):
        if out is None:
            raise BadParameter("several follow-ups need --out DIR", param_hint="--out")
        if picture is not None:
            raise BadParameter(
                "a picture is written for a single follow-up only", param_hint="--picture"
            )
        if flat:
            raise BadParameter(
                "with several follow-ups, the scene is always treated as a plane",
                param_hint="--flat",
            )
        if not library.holds_series(out, library.POSES_TABLE):
            terminal.refuse_replacing(*(out / name for name in library.FILES_OF_POSE_SERIES))
        how = terminal.keywords_of(library.judge_poses)
        series = library.judge_poses(reference, followups, out, curves, min_dprime, **how)
        _show_series(out, series, sweep)
        return
    if followups:
        if out is not None:
            raise BadParameter("--out needs several follow-ups, or a folder of them")
        terminal.refuse_sweep_of_one(sweep, parquet=parquet)
        how = terminal.keywords_of(library.judge_pose)
        found = library.judge_pose(reference, followups[0], curves, min_dprime, **how)
        if picture is not None:
            found.write_picture(picture)
        terminal.answer(
            lambda: found.to_json(picture),
            lambda: _show_one(found.quality, found.summary),
            found.notes,
        )
        return
    watched = library.PoseWatch(
        reference, curves, min_dprime, **terminal.keywords_of(library.PoseWatch)
    )
    if stream is not None:
        if not stream.is_dir():
            raise BadParameter(f"{stream} is not a folder", param_hint="--stream")
        source = watched.folder(stream, is_watched=watch)
        _watch(watched, source, frames, is_live=False)
    if bench is not None:
        config = terminal.read_bench(bench, settings)
        with watched.camera(config, target=target, progress=terminal.ShownProgress()) as source:
            _watch(watched, source, frames, is_live=True)


def _watch(
    watched: library.PoseWatch,
    source: Iterator[library.NamedFrame],
    count: int | None,
    *,
    is_live: bool,
) -> None:
    try:
        with terminal.verdict_display(is_live=is_live, is_silent=terminal.wants_json()) as show:
            watched.run(source, show, count=count, is_kept=not is_live)
    finally:
        # Ctrl-C is the normal way to end this: the summary is shown then, too.
        if watched.summary.frames:
            terminal.answer(watched.to_json, lambda: _show_stream(watched))
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
        *(() if summary.parallax is None else (summary.parallax.sentence,)),
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
) -> None:
    def show(document: PoseSeries) -> None:
        terminal.print_few(found, _CELLS, "Follow-ups with the lowest d'")
        unsure = f", {document.unsure} of all poses unsure" if document.unsure else ""
        terminal.say(
            f"{document.accepted} of {document.accepted + document.rejected} poses accepted"
            f"{unsure}: {document.criterion} d' of at least "
            f"{document.min_dprime:g} ({found.sweep.found_done} already done); wrote {out}",
            terminal.UPPER_BOUND,
        )

    terminal.show_series(found, options, out, show, "the verdicts on the others are complete")


_CELLS: dict[str, Callable[[JudgedFollowup], str]] = {
    "follow-up": lambda one: Path(one.followup).name,
    "verdict": lambda one: "none" if one.overlap is None else one.verdict or "",
    "d'": lambda one: "" if one.overlap is None else f"{one.dprime_decisive:.2f}",
    "zoom": lambda one: "" if one.overlap is None else f"{one.zoom_min:.3f} to {one.zoom_max:.3f}",
    "overlap": lambda one: "" if one.overlap is None else f"{100 * one.overlap:.0f} %",
}


def _show_stream(watched: library.PoseWatch) -> None:
    summary = watched.summary
    assert summary.last is not None
    rate = summary.frames_per_s
    terminal.say(
        f"{summary.accepted} of {summary.frames} frames accepted; full-frame searches: "
        f"{summary.anchors}, pose not found: {summary.unknown}"
        + ("" if rate is None else f"; tracking at {rate:.0f} frames per second"),
        f"last: {summary.last.reason}",
    )


_OF_A_CAMERA = ("reference_tilt_deg", "direction_deg", "aim", "at_zoom", "at_tilt_deg", "plot")


@terminal.command(
    terminal.exactly_one("geometry", "focal_length_px", "homography", unless="depth"),
    *(terminal.needs(option, "geometry", "focal_length_px") for option in _OF_A_CAMERA),
    terminal.needs("depth", "homography"),
    terminal.excludes("depth", "geometry", "image_size", *_OF_A_CAMERA),
    terminal.needs("plane_depth", "depth"),
    terminal.needs("reference_size", "homography"),
    terminal.needs("criterion", "homography"),
    terminal.needs("focal_length_px", "image_size", "depth"),
    terminal.needs("image_size", "focal_length_px"),
    terminal.needs("at_tilt_deg", "at_zoom"),
)
def limits(
    *,
    curves: terminal.CurvesPath,
    min_dprime: terminal.MinDprime,
    geometry: Path | None = None,
    focal_length_px: Annotated[
        float | None, Option(parser=terminal.quantity("focal_length_px"))
    ] = None,
    image_size: str | None = None,
    reference_tilt_deg: Annotated[float, Option("--reference-tilt", min=-75, max=75)] = 0.0,
    direction_deg: Annotated[float | None, Option("--tilt-direction", min=-360, max=360)] = None,
    aim: Annotated[str | None, Option(metavar="X,Y")] = None,
    at_zoom: Annotated[float | None, Option(callback=terminal.checked_zoom)] = None,
    at_tilt_deg: Annotated[float, Option("--at-tilt", min=-75, max=75)] = 0.0,
    homography: Path | None = None,
    reference_size: str | None = None,
    depth: Path | None = None,
    plane_depth: float | None = None,
    criterion: Criterion | None = None,
    plot: Annotated[Path | None, terminal.Result(".png", ".svg")] = None,
    focus_scatter_px2: terminal.FocusScatter = None,
    choice: terminal.Choice,
) -> None:
    """Find the largest distance ratio, tilt and shift that can keep d' above a threshold.

    Measure the curves first: with standoff detectability or, for a detector, standoff evaluate.

    Options
    -------
    geometry: geometry.json of the camera.
    focal_length_px: Focal length in px, instead of --geometry, or with --depth.
    image_size: Frame size WxH in px, with --focal-length-px.
    reference_tilt_deg: Tilt of the reference in degrees.
    direction_deg: Direction of the follow-up's tilt, in degrees from +x (the direction of the
        reference's tilt) towards +y; the worst direction by default.
    aim: Pixel of the reference that the middle of the follow-up shows; 0,0 is the centre of the
        first pixel. By default the middle of the reference.
    at_zoom: Distance ratio at which to print the lowest detectable contrast.
    at_tilt_deg: Tilt at --at-zoom in degrees.
    homography: H.json of a known pose, to print its d' instead of the limits.
    reference_size: Frame size WxH in px of the reference of --homography; by default, that of
        the follow-up.
    depth: With --homography and --focal-length-px: depth of what the reference shows, a map or a
        list of planes as for standoff simulate.
    plane_depth: Depth of the plane of --homography, as for standoff simulate.
    criterion: With --homography: d' must reach the threshold in all of the overlap (min, the
        default) or in 95 % of it (quantile).
    plot: Also write a figure (PNG or SVG).
    """
    if homography is not None:
        how = terminal.keywords_of(
            library.judge_homography,
            reference_size=terminal.parsed_size(reference_size, "--reference-size"),
            criterion=criterion or "min",
            depth=None
            if depth is None
            else library.read_depth(
                depth, focal_length_px=focal_length_px, plane_depth=plane_depth
            ),
        )
        judged = library.judge_homography(homography, curves, min_dprime, **how)
        terminal.answer(judged.to_json, lambda: _print_judged(judged), judged.notes)
        return
    how = terminal.keywords_of(
        library.pose_limits,
        image_size=terminal.parsed_size(image_size),
        aim_px=None if aim is None else _parsed_aim(aim),
    )
    found = library.pose_limits(curves, min_dprime, **how)
    if plot is not None:
        found.write_plot(plot)
    where = "in any direction" if direction_deg is None else f"towards {direction_deg:g} degrees"

    def show() -> None:
        _print_limits(found, min_dprime, where)
        if found.contrast_found_dn is not None:
            terminal.say(
                f"at zoom {at_zoom:g}, tilt {at_tilt_deg:g} degrees: contrasts from "
                f"{found.contrast_found_dn:.3g} DN are detectable"
            )

    terminal.answer(found.to_json, show)


def _interval(ends: tuple[float | None, float | None], digits: int) -> str:
    """The interval of a limit; its ends may lie beyond what can be said."""
    low, high = ends
    if low is None and high is None:
        return ""
    least = "none" if low is None else f"{low:.{digits}f}"
    most = "the end of the curve" if high is None else f"{high:.{digits}f}"
    return f" (95 %: {least} to {most})"


def _parsed_aim(text: str) -> tuple[float, float]:
    numbers = text.split(",")
    try:
        x, y = (float(number) for number in numbers)
    except ValueError as error:
        raise BadParameter(
            f"expected X,Y in pixels of the reference, such as 120,340, got {text}",
            param_hint="--aim",
        ) from error
    if not (isfinite(x) and isfinite(y)):
        raise BadParameter(f"expected numbers, got {text}", param_hint="--aim")
    return x, y


def _print_judged(judged: library.JudgedHomography) -> None:
    decision = judged.quality.decision
    terminal.say(
        judged.quality.curve.name,
        judged.sentence,
        f"{decision.verdict}: {decision.sentence}",
        *filter(None, (decision.unknown_sentence,)),
        terminal.UPPER_BOUND,
    )


def _print_limits(found: PoseLimits, min_dprime: float, where: str) -> None:
    more = " or more (the curve ends there)" if found.is_zoom_beyond_curve else ""
    tilt = "none" if found.tilt_deg is None else f"up to {found.tilt_deg:.1f} degrees"
    terminal.say(
        f"{found.curve.name}; d' of at least {min_dprime:g}, at best:",
        f"straight back: up to {found.zoom:.3f} times the reference's distance{more}"
        f"{_interval(found.zoom_interval_95, 3)}",
        f"tilt {where} at the same distance: {tilt}{_interval(found.tilt_interval_95_deg, 1)}",
    )
    if found.aim_px is not None and found.aimed_overlap is not None:
        x, y = found.aim_px
        terminal.say(
            f"aimed at {x:g},{y:g} px of the reference, which covers "
            f"{100 * found.aimed_overlap:.0f} % of a follow-up from the same distance"
        )
    terminal.print_table(
        f"Distance and tilt {where}",
        ["tilt / degrees", "distance ratio up to"],
        [
            [f"{tilt_deg:g}", "-" if zoom is None else f"{zoom:.3f}"]
            for tilt_deg, zoom in found.zoom_by_tilt
        ],
    )
    terminal.print_table(
        "Sideways shift: the sampling stays the same, the overlap shrinks",
        ["shift / field width", "overlap"],
        [[f"{share:g}", f"{100 * overlap:.0f} %"] for share, overlap in found.overlap_by_shift],
    )
    terminal.say(terminal.UPPER_BOUND)
