"""``standoff focus``: the live focus aid, and the focus sweep."""

from __future__ import annotations

from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from typer import BadParameter, Context, Option

from acquisition.choices import FEWEST_POSITIONS, FocusMeasure
from standoff import library, terminal
from standoff.errors import ApplicationError

if TYPE_CHECKING:
    from acquisition.bench import BenchConfig
    from acquisition.focus import FocusOptions, FocusPoint, FocusReading, FocusSweep, SweepRequest

_LIVE_FRAMES = 3
_SIGMAS_95 = 1.96
_CLIPPED = 0.01
_EDGE_ORIENTATION_DEG = 5.0

_REGION = "X,Y,W,H in px, 0 or more and at least 2 x 2"

_RULES = (
    *(terminal.needs(option, "sweep") for option in ("from_mm", "to_mm", "go", "out")),
    terminal.excludes("sweep", "readings", because="--readings is for the live aid"),
    terminal.needs("from_mm", "to_mm"),
    terminal.needs("to_mm", "from_mm"),
    terminal.excludes(
        "sweep", terminal.Given("frames", (1,)), because="a sweep averages 2 frames or more"
    ),
)


def focus(
    context: Context,
    *,
    bench: terminal.BenchFile,
    metric: Annotated[FocusMeasure, Option(help="Focus measure.")] = "squared-gradient",
    region: Annotated[
        str | None,
        Option(metavar="X,Y,W,H", help="Part of the frame to use, in px; all of it by default."),
    ] = None,
    frames: Annotated[
        int | None,
        Option(
            min=1, help="Live: frames in the median that is shown. Sweep: frames at each height."
        ),
    ] = None,
    readings: Annotated[int | None, Option(min=1, help="Live: end after this many frames.")] = None,
    sweep: Annotated[
        bool, Option("--sweep", help="Move the stage through the focus and fit the peak.")
    ] = False,
    from_mm: Annotated[
        float | None,
        Option("--from", help="Sweep: lowest height in mm; the whole travel by default."),
    ] = None,
    to_mm: Annotated[float | None, Option("--to", help="Sweep: highest height in mm.")] = None,
    steps: Annotated[
        int, Option(min=FEWEST_POSITIONS, max=1000, help="Sweep: number of heights.")
    ] = 15,
    go: Annotated[bool, Option("--go", help="Sweep: move to the peak at the end.")] = False,
    out: Annotated[Path | None, Option(help="Sweep: also write a plot of the curve (PNG).")] = None,
    noise: Annotated[
        Path | None, Option(help="noise.json of the camera; the noise is measured by default.")
    ] = None,
    target: Annotated[
        str | None, Option(help="Target under a simulated camera; edge by default.")
    ] = None,
    settings: terminal.BenchKeys = None,
    force: terminal.Force = False,
    json: terminal.Json = False,
) -> None:
    """Show how sharp the picture is, live, or find the height of best focus by a sweep.

    Ctrl-C ends the live aid, with status 0 once a value has been shown; it aborts a sweep.
    """
    terminal.check_options(context, _RULES)
    terminal.refuse_suffix(out, "--out", {".png"})
    terminal.refuse_overwriting([out], [bench, noise], force=force)
    if from_mm is not None and to_mm is not None and not from_mm < to_mm:
        raise BadParameter("--from must be below --to")
    from acquisition.focus import SweepRequest

    library.require_writable([out])
    config = terminal.read_bench(bench, settings)
    options = _options(metric, region, noise)
    if not sweep:
        smoothed = (frames or _LIVE_FRAMES) // 2 * 2 + 1
        with library.opened_camera(config) as watched:
            _prepare(watched, target, options)
            with terminal.focus_display(watched.clock) as show:
                last = library.watch_focus(
                    watched, options, show, smoothed=smoothed, readings=readings
                )
        _show_last(last, metric, json=json)
        return
    request = SweepRequest(
        heights_mm=None if from_mm is None or to_mm is None else (from_mm, to_mm),
        steps=steps,
        frames=frames or config.capture.frames_per_capture,
        ends_at_peak=go,
    )
    with library.open_bench(config) as opened:
        _prepare(opened, target, options)
        found = _swept(opened, config, options, request)
    _finish(found, config, metric, out, json=json)


def _swept(
    opened: library.OpenBench, config: BenchConfig, options: FocusOptions, request: SweepRequest
) -> FocusSweep:
    from acquisition.focus import positions_of, sweep_bench

    with terminal.progress_bar("sweeping", positions_of(request)) as bar:
        done = count(1)

        def show(point: FocusPoint) -> None:
            bar.advance_to(next(done), f"{point.height_mm:.2f} mm: {point.value:.4g}")

        return sweep_bench(library.devices_of(opened, config), options, request, show)


def _options(metric: FocusMeasure, region: str | None, noise: Path | None) -> FocusOptions:
    import numpy as np

    from acquisition.focus import FocusOptions, Region
    from calibration.files import read_noise
    from calibration.noise import level_noise

    model = None if noise is None else level_noise(read_noise(noise).capture_noise)
    return FocusOptions(
        measure=metric,
        region=None if region is None else terminal.parsed_region(region, _REGION, Region),
        noise=None
        if model is None
        else lambda level_dn: float(model.variance_dn2(np.array([level_dn]))[0]),
    )


def _prepare(
    opened: library.OpenBench | library.OpenCamera, target: str | None, options: FocusOptions
) -> None:
    terminal.note(*opened.warnings)
    if target is not None:
        terminal.place_target(opened.simulated, target, _EDGE_ORIENTATION_DEG)
    region, frame = options.region, opened.camera.settings
    if region is not None and (
        region.x_px + region.width_px > frame.width_px
        or region.y_px + region.height_px > frame.height_px
    ):
        raise BadParameter(
            f"the region reaches beyond the frame of {frame.width_px} x {frame.height_px} px",
            param_hint="--region",
        )


def _show_last(last: FocusReading, metric: FocusMeasure, *, json: bool) -> None:
    if json:
        shown = ("value", "peak", "percent_of_peak", "trend", "is_past_peak", "noise")
        terminal.print_json({**{name: getattr(last, name) for name in shown}, "metric": metric})
    else:
        terminal.say(
            f"last {last.value:.5g}, peak {last.peak:.5g}, {last.percent_of_peak:.1f} % of peak"
        )


def _finish(
    found: FocusSweep, config: BenchConfig, metric: FocusMeasure, out: Path | None, *, json: bool
) -> None:
    if out is not None:
        from analysis.reports import plot_focus_sweep, png_bytes

        heights, values, errs = found.columns()
        plot = plot_focus_sweep(heights, values, errs, found.peak, metric)
        library.write_file(out, png_bytes(plot))
    if max(point.saturated_fraction for point in found.points) > _CLIPPED:
        terminal.note(
            "parts of the picture are saturated, which blunts the peak; use a shorter exposure"
        )
    peak = found.peak
    if peak is None:
        raise ApplicationError(found.why_not or "no peak")
    if json:
        points = [
            {"height_mm": p.height_mm, "value": p.value, "value_err": p.err} for p in found.points
        ]
        terminal.print_json(
            {
                "height_mm": peak.height_mm,
                "height_err_mm": peak.err_mm,
                "value": peak.value,
                "shape": peak.shape,
                "width_mm": peak.width_mm,
                "metric": metric,
                "positions": points,
            }
        )
        return
    half_mm = _SIGMAS_95 * peak.err_mm
    terminal.say(f"sharpest at {peak.height_mm:.3f} mm, ± {half_mm:.3f} mm (95 %)")
    if found.remark is not None:
        terminal.note(found.remark)
    if half_mm < config.stage.tolerance_mm:
        terminal.say(f"more precise than the stage's tolerance ({config.stage.tolerance_mm:g} mm)")
    if out is not None:
        terminal.say(f"wrote {out}")
