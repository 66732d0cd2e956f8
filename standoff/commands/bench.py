"""``standoff focus``, ``stage``, ``cameras`` and ``doctor``: the bench, by hand."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from typer import Argument, BadParameter, Exit, Option

from acquisition.choices import FEWEST_POSITIONS, FocusMeasure, StageAction
from standoff import library, terminal
from standoff.errors import ApplicationError

if TYPE_CHECKING:
    from acquisition.focus import FocusPoint
    from acquisition.stages import StageReport
    from calibration.edges import Region
    from standoff import FoundFocus

_LIVE_FRAMES = 3

_REGION = "X,Y,W,H in px, 0 or more and at least 2 x 2"


@terminal.command(
    *(
        terminal.needs(option, "sweep")
        for option in ("from_mm", "to_mm", "ends_at_peak", "out", "geometry")
    ),
    terminal.excludes("sweep", "readings", because="--readings is for the live aid"),
    terminal.needs("from_mm", "to_mm"),
    terminal.needs("to_mm", "from_mm"),
    terminal.excludes(
        "sweep", terminal.Given("frames", (1,)), because="a sweep averages 2 frames or more"
    ),
)
def focus(
    *,
    bench: terminal.BenchFile,
    measure: Annotated[FocusMeasure, Option("--metric")] = "squared-gradient",
    region: Annotated[str | None, Option(metavar="X,Y,W,H")] = None,
    frames: Annotated[int | None, Option(min=1)] = None,
    readings: Annotated[int | None, Option(min=1)] = None,
    sweep: Annotated[bool, Option("--sweep")] = False,
    from_mm: Annotated[float | None, Option("--from")] = None,
    to_mm: Annotated[float | None, Option("--to")] = None,
    steps: Annotated[int, Option(min=FEWEST_POSITIONS, max=1000)] = 15,
    ends_at_peak: Annotated[bool, Option("--go")] = False,
    out: Annotated[Path | None, terminal.Result(".png")] = None,
    noise: Path | None = None,
    geometry: Path | None = None,
    target: str | None = None,
    settings: terminal.BenchKeys = None,
) -> None:
    """Show how sharp the picture is, live, or find the height of best focus by a sweep.

    Ctrl-C ends the live aid, with status 0 once a value has been shown; it aborts a sweep.

    Options
    -------
    measure: Focus measure.
    region: Part of the frame to use, in px; all of it by default.
    frames: Live: number of frames in the median shown. Sweep: frames at each height.
    readings: Live: end after this many frames.
    sweep: Move the stage through the focus and fit the peak.
    from_mm: Sweep: lowest height in mm; the whole travel by default.
    to_mm: Sweep: highest height in mm.
    steps: Sweep: number of heights.
    ends_at_peak: Sweep: move to the peak at the end.
    out: Sweep: also write a plot of the curve (PNG).
    noise: noise.json of the camera; the noise is measured by default.
    geometry: Sweep: geometry.json of this lens, for the position of its entrance pupil; without
        it, the unknown position adds to the error.
    target: Target under a simulated camera; edge by default.
    """
    if from_mm is not None and to_mm is not None and not from_mm < to_mm:
        raise BadParameter("--from must be below --to")
    config = terminal.read_bench(bench, settings)
    progress = terminal.ShownProgress()
    how: dict[str, Any] = {
        "settings": None,  # of the bench as it is read
        "region": None if region is None else _region(region),
        "progress": progress,
    }
    if not sweep:
        how["frames"] = frames or _LIVE_FRAMES
        with terminal.focus_display() as show:
            last = library.watch_focus(
                config, show, **terminal.keywords_of(library.watch_focus, **how)
            )
        terminal.answer(last.to_json, lambda: _show_last(last))
        return

    def describe(at: FocusPoint) -> None:
        progress.describe(f"{at.height_mm:.2f} mm: {at.value:.4g}")

    heights_mm = None if from_mm is None or to_mm is None else (from_mm, to_mm)
    how["measured"] = describe
    found = library.find_focus(
        config, heights_mm, **terminal.keywords_of(library.find_focus, **how)
    )
    if out is not None:
        found.write_plot(out)
    if found.sweep.peak is None:
        raise ApplicationError(found.sweep.why_not or "no peak")
    terminal.answer(found.to_json, lambda: _show_found(found, out))


def _show_found(found: FoundFocus, out: Path | None) -> None:
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


def _show_last(last: library.WatchedFocus) -> None:
    reading = last.reading
    if not reading.has_detail:
        terminal.say("nothing to focus on: take off the lens cap, and place a target with detail")
        return
    terminal.say(
        f"last {reading.value:.5g}, peak {reading.peak:.5g}, "
        f"{reading.percent_of_peak:.1f} % of peak"
    )


@terminal.command()
def stage(
    action: StageAction,
    height_mm: Annotated[float | None, Argument(metavar="[MM]")] = None,
    *,
    bench: terminal.BenchFile,
    home: Annotated[bool, Option("--home")] = False,
    settings: terminal.BenchKeys = None,
) -> None:
    """Show, home, move, stop or unlock the height stage.

    Ctrl-C brings the stage to a controlled stop. The stop action first reports whether the stage
    has stopped, and exits with status 0 only if it has.

    Options
    -------
    action: What to do.
    height_mm: Height to move to, in mm.
    home: Home first if the stage does not know its height.
    """
    if (height_mm is None) == (action == "move"):
        raise BadParameter("move takes one height in mm; the other actions take none")
    if home and action != "move":
        raise BadParameter("--home is for move only")
    told = library.operate_stage(
        terminal.read_bench(bench, settings),
        action,
        height_mm,
        homes_first=home,
        stopped=terminal.note if terminal.wants_json() else terminal.say,
        note=terminal.note,
    )
    terminal.answer(told.to_json, lambda: _show_state(told))


def _show_state(told: StageReport) -> None:
    if told.state == "unknown":
        return
    terminal.note(*told.warnings)
    where = "height unknown, not homed"
    if told.position_mm is not None:
        where = f"at {told.position_mm:.3f} mm"
    low_mm, high_mm = told.limits_mm
    terminal.say(
        f"{told.info['model']}: {told.state}, {where}; limits {low_mm:g} to {high_mm:g} mm"
    )


@terminal.command(terminal.needs("settings", "bench"))
def doctor(
    *,
    bench: Annotated[Path | None, Option("--bench")] = None,
    settings: terminal.BenchKeys = None,
) -> None:
    """Check that this computer, the camera and the stage are ready, and say what to do if not.

    Options
    -------
    bench: Bench file (TOML); without it, only this computer is checked.
    """
    from standoff.doctor import examine

    config = None if bench is None else terminal.read_bench(bench, settings)
    checks = examine(config, Path.cwd())
    failed = [check for check in checks if check.status == "fail"]

    def show() -> None:
        for check in checks:
            terminal.say(f"{check.status:4}  {check.name}: {check.found}")
            if check.remedy:
                terminal.say(f"      -> {check.remedy}")

    terminal.answer({"ok": not failed, "checks": [asdict(check) for check in checks]}, show)
    if failed:
        raise Exit(1)


@terminal.command()
def cameras() -> None:
    """Search for cameras; this BROADCASTS on every network interface of this computer."""
    found = library.find_cameras()
    rows = [asdict(camera) for camera in found]

    def show() -> None:
        if not found:
            terminal.say(
                "no camera answered; check power, cable and firewall, and that the network card "
                "has an address in the camera's subnet"
            )
            return
        names = ("address", "vendor", "model", "serial_number", "hardware_address", "id")
        terminal.print_table(
            f"{len(found)} camera{'s' * (len(found) != 1)}",
            [name.replace("_", " ") for name in names],
            [[row[name] for name in names] for row in rows],
        )

    terminal.answer({"cameras": rows}, show)
