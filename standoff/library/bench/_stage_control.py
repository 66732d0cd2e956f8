"""One action of the height stage by hand: status, home, move, stop or unlock."""

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from typing import Literal

from acquisition.bench import BenchConfig
from acquisition.choices import StageAction
from acquisition.devices import Stage
from acquisition.errors import DeviceError, DeviceInUseError, StageNotStoppedError
from acquisition.stages import StageReport, act_on_stage

_STOPPED = "the stage has stopped"


def operate_stage(
    config: BenchConfig,
    action: StageAction,
    height_mm: float | None = None,
    *,
    homes_first: bool = False,
    stopped: Callable[[str], None],
    note: Callable[[str], None],
) -> StageReport:
    """Open the stage, do one action with it, and close it again.

    ``stopped`` is called with a sentence once the stage has been stopped, before anything else is
    asked of it; ``note`` is called with what went wrong after that. An interrupt brings the stage
    to a controlled stop.
    """
    if action == "stop":
        return _stop(config, stopped, note)
    with _opened(config, action) as stage:
        try:
            act_on_stage(stage, config.stage, action, height_mm, homes_first=homes_first)
        except KeyboardInterrupt as interrupt:
            try:
                stage.stop()
            except DeviceError as error:
                interrupt.add_note(str(error))
                note(f"stopping the stage failed: {error}")
            else:
                note(_STOPPED)
            raise
        return StageReport.of(stage, action)


def _stop(
    config: BenchConfig, stopped: Callable[[str], None], note: Callable[[str], None]
) -> StageReport:
    """Stop whatever runs; what fails once the stage stands is a remark, no error."""
    has_stopped = False

    def tell() -> None:
        nonlocal has_stopped
        has_stopped = True
        stopped("a person moves this stage" if config.stage.driver == "manual" else _STOPPED)

    try:
        with _opened(config, "stop", tell) as stage:
            return StageReport.of(stage, "stop")
    except StageNotStoppedError:
        raise
    except DeviceError as error:
        if not has_stopped:
            raise StageNotStoppedError(f"the stage was not told to stop: {error}") from error
        note(str(error))
        return StageReport.without_answer(config.stage, str(error))


@contextmanager
def _opened(
    config: BenchConfig, action: StageAction, stopped: Callable[[], None] = lambda: None
) -> Iterator[Stage]:
    if config.stage.driver == "simulated":
        from hil_mocks import SimulatedBench

        simulated = SimulatedBench(config).stage
        if action == "stop":
            simulated.stop()
            stopped()
        yield simulated
        return
    from standoff.library.bench._devices import open_stage

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
