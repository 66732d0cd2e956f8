"""``standoff stage``: manual control of the height stage."""

from typing import Annotated

from typer import Argument, BadParameter, Option

from acquisition.choices import StageAction
from standoff import library, terminal


def stage(
    action: Annotated[StageAction, Argument(help="What to do.", show_default=False)],
    height_mm: Annotated[
        float | None, Argument(help="Height to move to, in mm.", metavar="[MM]", show_default=False)
    ] = None,
    *,
    bench: terminal.BenchFile,
    home: Annotated[
        bool, Option("--home", help="Home first if the stage does not know its height.")
    ] = False,
    settings: terminal.BenchKeys = None,
    json: terminal.Json = False,
) -> None:
    """Show, home, move, stop or unlock the height stage.

    Ctrl-C brings it to a controlled stop. Stop says first whether the stage stopped, and exits
    with 0 only if it did.
    """
    if (height_mm is None) == (action == "move"):
        raise BadParameter("move takes one height in mm, the other actions take none")
    if home and action != "move":
        raise BadParameter("--home is for move only")
    told = library.operate_stage(
        terminal.read_bench(bench, settings),
        action,
        height_mm,
        homes_first=home,
        stopped=terminal.note if json else terminal.say,
        note=terminal.note,
    )
    if json:
        terminal.print_json(told.to_json())
        return
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
