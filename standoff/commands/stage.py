"""``standoff stage``: manual control of the height stage."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from acquisition.errors import (
    DeviceError,
    DeviceInUseError,
    StageNotHomedError,
    StageNotStoppedError,
)
from standoff.terminal import BenchFile, BenchKeys, Json, note, print_json, read_bench, say

if TYPE_CHECKING:
    from acquisition.bench import BenchConfig, StageConfig
    from acquisition.devices import Stage


Action = Literal["status", "home", "move", "stop", "unlock"]

STOPPED = "the stage has stopped"


def stage(
    action: Annotated[Action, typer.Argument(help="What to do.", show_default=False)],
    height_mm: Annotated[
        float | None,
        typer.Argument(help="Height to move to, in mm.", metavar="[MM]", show_default=False),
    ] = None,
    *,
    bench: BenchFile,
    home: Annotated[
        bool, typer.Option("--home", help="Home first if the stage does not know its height.")
    ] = False,
    settings: BenchKeys = None,
    json: Json = False,
) -> None:
    """Show, home, move, stop or unlock the height stage.

    Ctrl-C brings it to a controlled stop. Stop says first whether the stage stopped, and exits
    with 0 only if it did.
    """
    if (height_mm is None) == (action == "move"):
        raise typer.BadParameter("move takes one height in mm, the other actions take none")
    if home and action != "move":
        raise typer.BadParameter("--home is for move only")
    config = read_bench(bench, settings)
    if action == "stop":
        _stop(config, json=json)
        return
    with _opened(config, action) as opened:
        try:
            _act(opened, config.stage, action, height_mm, home=home)
        except KeyboardInterrupt as interrupt:
            try:
                opened.stop()
            except DeviceError as error:
                interrupt.add_note(str(error))
                note(f"stopping the stage failed: {error}")
            else:
                note(STOPPED)
            raise
        _show(opened, action, json=json)


def _stop(config: BenchConfig, *, json: bool) -> None:
    """Stop whatever runs; what fails once the stage stands is a remark, no error."""
    tell = note if json else say
    has_stopped = False

    def stopped() -> None:
        nonlocal has_stopped
        has_stopped = True
        tell("a person moves this stage" if config.stage.driver == "manual" else STOPPED)

    try:
        with _opened(config, "stop", stopped) as opened:
            _show(opened, "stop", json=json)
    except StageNotStoppedError:
        raise
    except DeviceError as error:
        if not has_stopped:
            raise StageNotStoppedError(f"the stage was not told to stop: {error}") from error
        note(str(error))
        if json:
            print_json(_without_answer(config.stage, str(error)))


def _act(
    opened: Stage, config: StageConfig, action: Action, height_mm: float | None, *, home: bool
) -> None:
    from acquisition.stages import home_timeout_s, move_timeout_s

    if action == "home":
        opened.home(home_timeout_s(config))
    elif action == "move" and height_mm is not None:
        if home and not opened.is_homed:
            opened.home(home_timeout_s(config))
        try:
            opened.move_to(height_mm, move_timeout_s(config))
        except StageNotHomedError as error:
            raise StageNotHomedError(f"{error}; run `standoff stage home` or add --home") from error
    elif action == "unlock":
        opened.clear_alarm()


@contextmanager
def _opened(
    config: BenchConfig, action: Action, stopped: Callable[[], None] = lambda: None
) -> Iterator[Stage]:
    if config.stage.driver == "simulated":
        from hil_mocks import SimulatedBench

        simulated = SimulatedBench(config).stage
        if action == "stop":
            simulated.stop()
            stopped()
        yield simulated
        return
    from standoff.library import open_stage

    first: Literal["nothing", "stop", "reset"] = "nothing"
    if action in ("stop", "unlock"):
        first = "stop" if action == "stop" else "reset"
    try:
        real = open_stage(config.stage, first=first, stopped=stopped)
    except DeviceInUseError as error:
        raise DeviceInUseError(
            f"{error}. The stage obeys only the program that holds its port: press Ctrl-C "
            "there, or the emergency stop"
        ) from error
    with closing(real):
        yield real


def _show(opened: Stage, action: Action, *, json: bool) -> None:
    from acquisition.stages import MotorStage

    state = opened.state
    try:
        position_mm = opened.position_mm()
    except StageNotHomedError:
        position_mm = None
    warnings = list(opened.warnings) if isinstance(opened, MotorStage) else []
    if json:
        print_json(
            {
                "action": action,
                "stopped": True if action == "stop" else None,
                "state": state,
                "position_mm": position_mm,
                "is_homed": opened.is_homed,
                "limits_mm": list(opened.limits_mm),
                "info": asdict(opened.info),
                "warnings": warnings,
            }
        )
        return
    for warning in warnings:
        note(warning)
    low_mm, high_mm = opened.limits_mm
    where = "height unknown, not homed" if position_mm is None else f"at {position_mm:.3f} mm"
    say(f"{opened.info.model}: {state}, {where}; limits {low_mm:g} to {high_mm:g} mm")


def _without_answer(config: StageConfig, error: str) -> dict[str, object]:
    """The document of a stage that has stopped and then told nothing more."""
    return {
        "action": "stop",
        "stopped": True,
        "state": "unknown",
        "position_mm": None,
        "is_homed": False,
        "limits_mm": list(config.limits_mm),
        "info": {
            "vendor": "",
            "model": "",
            "serial_number": "",
            "firmware": "",
            "driver": config.driver,
        },
        "warnings": [error],
    }
