"""``standoff focus``: the live focus aid, and the focus sweep."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import BadParameter, Context, Option

from acquisition.choices import FEWEST_POSITIONS, FocusMeasure
from standoff import library, terminal
from standoff.errors import ApplicationError

if TYPE_CHECKING:
    from calibration.edges import Region

_LIVE_FRAMES = 3

_REGION = "X,Y,W,H in px, 0 or more and at least 2 x 2"

_RULES = (
    *(terminal.needs(option, "sweep") for option in ("from_mm", "to_mm", "go", "out", "geometry")),
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
    geometry: Annotated[
        Path | None,
        Option(
            help="Sweep: geometry.json of this lens, for the place of its entrance pupil; without "
            "it that is part of the error."
        ),
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
    terminal.refuse_overwriting([out], [bench, noise, geometry], force=force)
    if from_mm is not None and to_mm is not None and not from_mm < to_mm:
        raise BadParameter("--from must be below --to")
    library.require_writable([out])
    config = terminal.read_bench(bench, settings)
    progress = terminal.ShownProgress()
    how: dict[str, Any] = {
        "measure": metric,
        "region": None if region is None else _region(region),
        "noise": noise,
        "target": target,
        "progress": progress,
    }
    if not sweep:
        with terminal.focus_display() as show:
            last = library.watch_focus(
                config, show, frames=frames or _LIVE_FRAMES, readings=readings, **how
            )
        _show_last(last, json=json)
        return
    found = library.find_focus(
        config,
        None if from_mm is None or to_mm is None else (from_mm, to_mm),
        steps=steps,
        frames=frames,
        ends_at_peak=go,
        geometry=geometry,
        measured=lambda at: progress.describe(f"{at.height_mm:.2f} mm: {at.value:.4g}"),
        **how,
    )
    if out is not None:
        found.write_plot(out)
    if found.sweep.peak is None:
        raise ApplicationError(found.sweep.why_not or "no peak")
    if json:
        terminal.print_json(found.to_json())
        return
    terminal.say(
        f"sharpest at {found.peak.height_mm:.3f} mm, ± {found.half_interval_mm:.3f} mm (95 %)"
    )
    if found.sweep.remark is not None:
        terminal.note(found.sweep.remark)
    if found.is_finer_than_stage:
        terminal.say(f"more precise than the stage's tolerance ({found.tolerance_mm:g} mm)")
    if out is not None:
        terminal.say(f"wrote {out}")


def _region(text: str) -> Region:
    from calibration.edges import Region

    return terminal.parsed_region(text, _REGION, Region)


def _show_last(last: library.WatchedFocus, *, json: bool) -> None:
    if json:
        terminal.print_json(last.to_json())
        return
    reading = last.reading
    if not reading.has_detail:
        terminal.say("nothing to focus on: take off the lens cap, and place a target with detail")
        return
    terminal.say(
        f"last {reading.value:.5g}, peak {reading.peak:.5g}, "
        f"{reading.percent_of_peak:.1f} % of peak"
    )
