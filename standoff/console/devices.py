"""The devices of a bench as the console has them: how they are opened, and whether they respond."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from threading import Event, Thread
from typing import Literal

from acquisition.bench import BenchConfig
from acquisition.capture import Placement
from acquisition.devices import Camera, Stage
from acquisition.plan import PlanEntry
from hil_mocks import SimulatedBench
from hil_mocks.devices import RealTimeClock
from standoff.library import open_camera, open_stage, place_in_simulation, refuse_half_simulated


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceStatus:
    """``text`` says what is wrong, ``remedy`` what to do; both are empty when ready."""

    state: Literal["opening", "ready", "lost"]
    text: str = ""
    remedy: str = ""

    @property
    def is_ready(self) -> bool:
        """Whether the device responds."""
        return self.state == "ready"


class Service:
    """Work in a thread of its own, from `start` to `close`."""

    def __init__(self, name: str, *, close_timeout_s: float | None = None) -> None:
        self._close_timeout_s = close_timeout_s
        self._is_closing = Event()
        self._thread = Thread(target=self._run, name=name, daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def close(self) -> None:
        """End the thread, and wait until it has, within its time."""
        self._is_closing.set()
        if self._thread.is_alive():
            self._thread.join(self._close_timeout_s)

    def _run(self) -> None:
        raise NotImplementedError


@dataclass(frozen=True, slots=True, kw_only=True)
class BenchDrivers:
    """How the devices of a bench are opened, and the clock that they run on.

    The first argument of ``open_stage`` says that it was open before and may still move; the second
    asks whoever moves a manual stage a question. ``laid`` places a target on a bench simulated in
    this process.
    """

    open_camera: Callable[[], Camera]
    open_stage: Callable[[bool, Callable[[str], str]], Stage]
    laid: Callable[[PlanEntry], Placement] | None = None
    clock: Callable[[], float] = time.monotonic
    sleep: Callable[[float], None] = time.sleep


def bench_drivers(config: BenchConfig) -> BenchDrivers:
    """Return the drivers of the bench's devices, without opening any.

    A simulated bench runs in real time here, so that its moves take time and can be stopped.
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
