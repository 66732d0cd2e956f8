"""``standoff stage``: manual control of the height stage."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import asdict
from typing import TYPE_CHECKING, Annotated, Literal

from typer import Argument, BadParameter, Option

from acquisition.errors import (
    DeviceError,
    DeviceInUseError,
    StageNotHomedError,
    StageNotStoppedError,
)
from standoff import library, terminal

if TYPE_CHECKING:
    from acquisition.bench import BenchConfig, StageConfig
    from acquisition.devices import Stage

Action = Literal["status", "home", "move", "stop", "unlock"]

STOPPED = "the stage has stopped"


def stage(
    action: Annotated[Action, Argument(help="What to do.", show_default=False)],
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
    config = terminal.read_bench(bench, settings)
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
                terminal.note(f"stopping the stage failed: {error}")
            else:
                terminal.note(STOPPED)
            raise
        _show(opened, action, json=json)


def _stop(config: BenchConfig, *, json: bool) -> None:
    """Stop whatever runs; what fails once the stage stands is a remark, no error."""
    tell = terminal.note if json else terminal.say
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
        terminal.note(str(error))
        if json:
            terminal.print_json(_without_answer(config.stage, str(error)))


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
    first: Literal["nothing", "stop", "reset"] = "nothing"
    if action in ("stop", "unlock"):
        first = "stop" if action == "stop" else "reset"
    try:
        real = library.open_stage(config.stage, first=first, stopped=stopped)
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
    low_mm, high_mm = opened.limits_mm
    warnings = list(opened.warnings) if isinstance(opened, MotorStage) else []
    if json:
        terminal.print_json(
            {
                "action": action,
                "stopped": True if action == "stop" else None,
                "state": state,
                "position_mm": position_mm,
                "is_homed": opened.is_homed,
                "limits_mm": [low_mm, high_mm],
                "info": asdict(opened.info),
                "warnings": warnings,
            }
        )
        return
    terminal.note(*warnings)
    where = "height unknown, not homed" if position_mm is None else f"at {position_mm:.3f} mm"
    terminal.say(f"{opened.info.model}: {state}, {where}; limits {low_mm:g} to {high_mm:g} mm")


def _without_answer(config: StageConfig, error: str) -> dict[str, object]:
    """The document of a stage that has stopped and then told nothing more."""
    unknown = dict.fromkeys(("vendor", "model", "serial_number", "firmware"), "")
    return {
        "action": "stop",
        "stopped": True,
        "state": "unknown",
        "position_mm": None,
        "is_homed": False,
        "limits_mm": list(config.limits_mm),
        "info": {**unknown, "driver": config.driver},
        "warnings": [error],
    }
