"""``standoff focus``: the live focus aid, and the focus sweep."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from acquisition.choices import FEWEST_POSITIONS, FocusMeasure
from standoff.errors import ApplicationError
from standoff.terminal import (
    BenchFile,
    BenchKeys,
    Force,
    Json,
    Option,
    check_options,
    excludes,
    needs,
    note,
    place_target,
    print_json,
    progress_bar,
    read_bench,
    refuse_overwriting,
    refuse_suffix,
    region_corner_and_size,
    say,
)

if TYPE_CHECKING:
    from acquisition.bench import BenchConfig
    from acquisition.devices import Camera
    from acquisition.focus import (
        FocusOptions,
        FocusPoint,
        FocusReading,
        FocusSweep,
        Region,
        SweepRequest,
    )
    from standoff.library import OpenBench, OpenCamera


_LIVE_FRAMES = 3
_SIGMAS_95 = 1.96
_CLIPPED = 0.01
_EDGE_ORIENTATION_DEG = 5.0

_RULES = (
    *(needs(option, "sweep") for option in ("from_mm", "to_mm", "go", "out")),
    excludes("sweep", "readings", because="--readings is for the live aid"),
    needs("from_mm", "to_mm"),
    needs("to_mm", "from_mm"),
    excludes("sweep", Option("frames", (1,)), because="a sweep averages 2 frames or more"),
)


def focus(
    context: typer.Context,
    *,
    bench: BenchFile,
    metric: Annotated[FocusMeasure, typer.Option(help="Focus measure.")] = "squared-gradient",
    region: Annotated[
        str | None,
        typer.Option(
            metavar="X,Y,W,H", help="Part of the frame to use, in px; all of it by default."
        ),
    ] = None,
    frames: Annotated[
        int | None,
        typer.Option(
            min=1, help="Live: frames in the median that is shown. Sweep: frames at each height."
        ),
    ] = None,
    readings: Annotated[
        int | None, typer.Option(min=1, help="Live: end after this many frames.")
    ] = None,
    sweep: Annotated[
        bool, typer.Option("--sweep", help="Move the stage through the focus and fit the peak.")
    ] = False,
    from_mm: Annotated[
        float | None,
        typer.Option("--from", help="Sweep: lowest height in mm; the whole travel by default."),
    ] = None,
    to_mm: Annotated[
        float | None, typer.Option("--to", help="Sweep: highest height in mm.")
    ] = None,
    steps: Annotated[
        int, typer.Option(min=FEWEST_POSITIONS, max=1000, help="Sweep: number of heights.")
    ] = 15,
    go: Annotated[bool, typer.Option("--go", help="Sweep: move to the peak at the end.")] = False,
    out: Annotated[
        Path | None, typer.Option(help="Sweep: also write a plot of the curve (PNG).")
    ] = None,
    noise: Annotated[
        Path | None,
        typer.Option(help="noise.json of the camera; the noise is measured by default."),
    ] = None,
    target: Annotated[
        str | None, typer.Option(help="Target under a simulated camera; edge by default.")
    ] = None,
    settings: BenchKeys = None,
    force: Force = False,
    json: Json = False,
) -> None:
    """Show how sharp the picture is, live, or find the height of best focus by a sweep.

    Ctrl-C ends the live aid, with status 0 once a value has been shown; it aborts a sweep.
    """
    check_options(context, _RULES)
    refuse_suffix(out, "--out", {".png"})
    refuse_overwriting([out], [bench, noise], force=force)
    if from_mm is not None and to_mm is not None and not from_mm < to_mm:
        raise typer.BadParameter("--from must be below --to")
    from acquisition.focus import SweepRequest
    from standoff.library import open_bench, opened_camera, require_writable, watch_focus
    from standoff.terminal import focus_display

    require_writable([out])
    config = read_bench(bench, settings)
    options = _options(metric, region, noise)
    if not sweep:
        with opened_camera(config) as watched:
            _prepare(watched, target, options)
            count = frames or _LIVE_FRAMES
            with focus_display(watched.clock) as show:
                last = watch_focus(
                    watched, options, show, smoothed=count + 1 - count % 2, readings=readings
                )
        _show_last(last, metric, json=json)
        return
    request = SweepRequest(
        heights_mm=None if from_mm is None or to_mm is None else (from_mm, to_mm),
        steps=steps,
        frames=frames or config.capture.frames_per_capture,
        ends_at_peak=go,
    )
    with open_bench(config) as opened:
        _prepare(opened, target, options)
        found = _swept(opened, config, options, request)
    _finish(found, config, metric, out, json=json)


def _swept(
    opened: OpenBench, config: BenchConfig, options: FocusOptions, request: SweepRequest
) -> FocusSweep:
    from acquisition.focus import positions_of, sweep_bench
    from standoff.library import devices_of

    with progress_bar("sweeping", positions_of(request)) as bar:
        done = 0

        def show(point: FocusPoint) -> None:
            nonlocal done
            done += 1
            bar.advance_to(done, f"{point.height_mm:.2f} mm: {point.value:.4g}")

        return sweep_bench(devices_of(opened, config), options, request, show)


def _options(metric: FocusMeasure, region: str | None, noise: Path | None) -> FocusOptions:
    import numpy as np

    from acquisition.focus import FocusOptions
    from calibration.files import read_noise
    from calibration.noise import level_noise

    model = None if noise is None else level_noise(read_noise(noise).capture_noise)
    return FocusOptions(
        measure=metric,
        region=None if region is None else _region(region),
        noise=None
        if model is None
        else lambda level_dn: float(model.variance_dn2(np.array([level_dn]))[0]),
    )


def _region(text: str) -> Region:
    from acquisition.focus import Region

    expected = "X,Y,W,H in px, 0 or more and at least 2 x 2"
    x, y, width, height = region_corner_and_size(text, expected)
    try:
        return Region(x_px=x, y_px=y, width_px=width, height_px=height)
    except ValueError as error:
        raise typer.BadParameter(
            f"expected {expected}, got {text}", param_hint="--region"
        ) from error


def _prepare(opened: OpenBench | OpenCamera, target: str | None, options: FocusOptions) -> None:
    for warning in opened.warnings:
        note(warning)
    if target is not None:
        place_target(opened.simulated, target, _EDGE_ORIENTATION_DEG)
    _require_region(options.region, opened.camera)


def _require_region(region: Region | None, camera: Camera) -> None:
    settings = camera.settings
    if region is not None and (
        region.x_px + region.width_px > settings.width_px
        or region.y_px + region.height_px > settings.height_px
    ):
        raise typer.BadParameter(
            f"the region reaches beyond the frame of {settings.width_px} x {settings.height_px} px",
            param_hint="--region",
        )


def _show_last(last: FocusReading, metric: FocusMeasure, *, json: bool) -> None:
    if json:
        print_json(
            {
                "value": last.value,
                "peak": last.peak,
                "percent_of_peak": last.percent_of_peak,
                "trend": last.trend,
                "is_past_peak": last.is_past_peak,
                "noise": last.noise,
                "metric": metric,
            }
        )
        return
    say(f"last {last.value:.5g}, peak {last.peak:.5g}, {last.percent_of_peak:.1f} % of peak")


def _finish(
    found: FocusSweep, config: BenchConfig, metric: FocusMeasure, out: Path | None, *, json: bool
) -> None:
    if out is not None:
        from analysis.reports import plot_focus_sweep, png_bytes
        from standoff.library import write_file

        heights, values, errs = found.columns()
        write_file(out, png_bytes(plot_focus_sweep(heights, values, errs, found.peak, metric)))
    if max(point.saturated_fraction for point in found.points) > _CLIPPED:
        note("parts of the picture are saturated, which blunts the peak; use a shorter exposure")
    peak = found.peak
    if peak is None:
        raise ApplicationError(found.why_not or "no peak")
    if json:
        print_json(
            {
                "height_mm": peak.height_mm,
                "height_err_mm": peak.err_mm,
                "value": peak.value,
                "shape": peak.shape,
                "width_mm": peak.width_mm,
                "metric": metric,
                "positions": [
                    {"height_mm": p.height_mm, "value": p.value, "value_err": p.err}
                    for p in found.points
                ],
            }
        )
        return
    half_mm = _SIGMAS_95 * peak.err_mm
    say(f"sharpest at {peak.height_mm:.3f} mm, ± {half_mm:.3f} mm (95 %)")
    if found.remark is not None:
        note(found.remark)
    if half_mm < config.stage.tolerance_mm:
        say(f"more precise than the stage's tolerance ({config.stage.tolerance_mm:g} mm)")
    if out is not None:
        say(f"wrote {out}")
