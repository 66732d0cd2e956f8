"""Opens the devices of a bench file for the console, and reopens them when they are lost."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from acquisition.bench import BenchConfig
from acquisition.capture import Placement
from acquisition.devices import Camera, Stage
from acquisition.plan import PlanEntry
from hil_mocks import SimulatedBench
from hil_mocks.devices import RealTimeClock
from standoff.library import (
    open_camera,
    open_stage,
    place_in_simulation,
    refuse_half_simulated,
)


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchDrivers:
    """How the devices of a bench are opened.

    Parameters
    ----------
    open_camera
        Opens and configures the camera.
    open_stage
        Opens the stage; its first argument says that it was open before and may still move.
        The second asks whoever moves a manual stage a question.
    laid
        Places a target on a bench simulated in this process; else None.
    clock, sleep
        Time in seconds that the devices run on, and a function that waits.
    """

    open_camera: Callable[[], Camera]
    open_stage: Callable[[bool, Callable[[str], str]], Stage]
    laid: Callable[[PlanEntry], Placement] | None = None
    clock: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep


def bench_drivers(config: BenchConfig) -> BenchDrivers:
    """Return the drivers of the bench's devices, without opening any.

    A simulated bench runs in real time here, so that its moves take time and can be stopped.

    Raises
    ------
    BenchConfigError
        If simulated and real devices are mixed.
    """
    refuse_half_simulated(config)
    if config.camera.driver == "simulated":
        clock = RealTimeClock()
        bench = SimulatedBench(config, clock=clock)
        return BenchDrivers(
            open_camera=bench.open_camera,
            open_stage=lambda _again, _ask: bench.stage,
            laid=place_in_simulation(bench),
            clock=lambda: clock.now_s,
            sleep=clock.advance,
        )

    def opened_stage(is_again: bool, ask: Callable[[str], str]) -> Stage:
        return open_stage(config.stage, first="stop" if is_again else "nothing", ask=ask)

    return BenchDrivers(open_camera=lambda: open_camera(config.camera), open_stage=opened_stage)
