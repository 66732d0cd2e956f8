"""Opens the devices that a bench file names."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from acquisition.bench import BenchConfig
from acquisition.devices import Camera, Stage
from acquisition.errors import BenchConfigError, PlanError
from acquisition.plan import PlanEntry
from acquisition.runner import Placement
from hil_mocks import SimulatedBench

__all__ = ["OpenBench", "open_bench", "place_in_simulation"]


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenBench:
    """Camera and stage, opened; ``simulated`` is the bench behind them where it is simulated.

    ``clock`` gives the seconds in which both live: the bench's own where it is simulated.
    """

    camera: Camera
    stage: Stage
    clock: Callable[[], float]
    simulated: SimulatedBench | None


@contextmanager
def open_bench(config: BenchConfig) -> Iterator[OpenBench]:
    """Open camera and stage, and close both at the end.

    Raises
    ------
    BenchConfigError
        If a driver is named that this version does not have, or the simulated camera and
        stage are not used together.
    """
    drivers = (config.camera.driver, config.stage.driver)
    if drivers != ("simulated", "simulated"):
        raise BenchConfigError(
            f"camera.driver {drivers[0]!r} with stage.driver {drivers[1]!r} is not supported "
            "yet; use 'simulated' for both"
        )
    bench = SimulatedBench(config)
    try:
        yield OpenBench(
            camera=bench.camera,
            stage=bench.stage,
            clock=lambda: bench.clock.now_s,
            simulated=bench,
        )
    finally:
        bench.camera.close()
        bench.stage.close()


def place_in_simulation(bench: SimulatedBench) -> Callable[[PlanEntry], Placement]:
    """Return what lays the planned target under the simulated camera.

    It raises ``PlanError`` where the bench has no such target.
    """

    def place(entry: PlanEntry) -> Placement:
        try:
            bench.place(entry.target, entry.orientation_deg)
        except ValueError as error:
            raise PlanError(f"capture {entry.index}: {error}") from error
        return "ready"

    return place
