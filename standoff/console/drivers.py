"""Opens the devices of a bench file for the console, again and again where they get lost."""

from collections.abc import Callable

from acquisition.bench import BenchConfig
from acquisition.devices import Stage
from hil_mocks import SimulatedBench
from hil_mocks.clock import RealTimeClock
from standoff.console.bench_hub import BenchDrivers
from standoff.workflows import (
    open_camera,
    open_stage,
    place_in_simulation,
    refuse_half_simulated,
)

__all__ = ["bench_drivers"]


def bench_drivers(config: BenchConfig) -> BenchDrivers:
    """Return how the bench's devices are opened; opens none.

    A simulated bench lives in real time here, so that its moves last and can be stopped.

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
            open_camera=lambda: bench.camera,
            open_stage=lambda _again, _ask: bench.stage,
            laid=place_in_simulation(bench),
            clock=lambda: clock.now_s,
            sleep=clock.advance,
        )

    def opened_stage(is_again: bool, ask: Callable[[str], str]) -> Stage:
        return open_stage(config.stage, first="stop" if is_again else "nothing", ask=ask)

    return BenchDrivers(open_camera=lambda: open_camera(config.camera), open_stage=opened_stage)
