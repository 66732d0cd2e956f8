"""Opens the devices that a bench file names."""

import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from typing import Literal

from acquisition.aravis import AravisCamera
from acquisition.bench import BenchConfig, BenchDevices, CameraConfig, StageConfig
from acquisition.capture import Placement
from acquisition.devices import Camera, Stage
from acquisition.errors import BenchConfigError, PlanError
from acquisition.plan import CapturePlan, PlanEntry, plan_entries
from acquisition.stages import ManualStage, MotorStage, open_grbl_stage, open_zaber_stage
from hil_mocks import SimulatedBench
from standoff.errors import ArgumentError


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenBench:
    """Camera and stage, opened; ``simulated`` is the bench behind them if it is simulated.

    ``clock`` returns the time in seconds that both run on, and ``sleep`` waits: those of the
    bench if it is simulated. ``warnings`` are for the operator, one line each.
    """

    camera: Camera
    stage: Stage
    clock: Callable[[], float]
    sleep: Callable[[float], None]
    simulated: SimulatedBench | None
    warnings: tuple[str, ...] = ()


@contextmanager
def open_bench(
    config: BenchConfig, *, ask: Callable[[str], str] | None = None
) -> Iterator[OpenBench]:
    """Open camera and stage, and close both at the end.

    Parameters
    ----------
    config
        The bench.
    ask
        Asks whoever moves a manual stage a question; at the terminal if None.

    Raises
    ------
    BenchConfigError
        If this version lacks a driver, or the simulated camera and stage are not used
        together.
    DeviceError
        If a device cannot be opened.
    """
    refuse_half_simulated(config)
    is_simulated = config.camera.driver == "simulated"
    with _simulated_bench(config) if is_simulated else _real_bench(config, ask) as opened:
        yield opened


def refuse_half_simulated(config: BenchConfig) -> None:
    """Refuse a bench of which only one device is simulated in process.

    Raises
    ------
    BenchConfigError
        If camera or stage is simulated and the other is not.
    """
    if [config.camera.driver, config.stage.driver].count("simulated") == 1:
        raise BenchConfigError(
            f"camera.driver {config.camera.driver!r} with stage.driver {config.stage.driver!r}: "
            "a simulated camera needs a simulated stage; use 'simulated' for both or neither"
        )


@contextmanager
def _simulated_bench(config: BenchConfig) -> Iterator[OpenBench]:
    bench = SimulatedBench(config)
    try:
        yield OpenBench(
            camera=bench.camera,
            stage=bench.stage,
            clock=lambda: bench.clock.now_s,
            sleep=bench.clock.advance,
            simulated=bench,
        )
    finally:
        bench.camera.close()
        bench.stage.close()


@contextmanager
def _real_bench(config: BenchConfig, ask: Callable[[str], str] | None) -> Iterator[OpenBench]:
    with (
        closing(open_stage(config.stage, ask=ask)) as stage,
        closing(open_camera(config.camera)) as camera,
    ):
        yield OpenBench(
            camera=camera,
            stage=stage,
            clock=time.monotonic,
            sleep=time.sleep,
            simulated=None,
            warnings=camera.warnings,
        )


def open_camera(config: CameraConfig) -> AravisCamera:
    """Open the real camera that a bench file names.

    Raises
    ------
    BenchConfigError
        If its driver is not for a real camera.
    DeviceError
        If it cannot be opened or configured.
    """
    if config.driver != "aravis":
        raise BenchConfigError(
            f"camera.driver {config.driver!r} opens no camera; use 'aravis', or 'simulated' for "
            "camera and stage"
        )
    return AravisCamera.open(config)


def open_stage(
    config: StageConfig,
    *,
    first: Literal["nothing", "stop", "reset"] = "nothing",
    ask: Callable[[str], str] | None = None,
    stopped: Callable[[], None] = lambda: None,
) -> MotorStage | ManualStage:
    """Open the real stage that a bench file names, without moving it.

    Parameters
    ----------
    config
        The stage's section.
    first
        What to send before the dialogue begins: ``stop`` ends a move that another program left
        running, ``reset`` ends a state in which a Grbl controller does not answer.
    ask
        Asks whoever moves a manual stage a question; at the terminal if None.
    stopped
        Called once the stage stands, after ``stop``; what comes then may still fail.

    Raises
    ------
    BenchConfigError
        If its driver is not for a real stage.
    StageNotStoppedError
        If it was told to stop first, and nothing says that it did.
    DeviceError
        If it cannot be opened.
    """
    match config.driver:
        case "grbl":
            return open_grbl_stage(config, first=first, stopped=stopped)
        case "zaber":
            is_stop = first == "stop"
            return open_zaber_stage(config, first="stop" if is_stop else "nothing", stopped=stopped)
        case "manual":
            if first == "stop":
                stopped()
            return ManualStage(config, ask=ask or _asked_at_terminal)
        case "simulated":
            raise BenchConfigError(
                "stage.driver 'simulated' opens no stage; use 'grbl', 'zaber' or 'manual'"
            )


def _asked_at_terminal(question: str) -> str:
    """Ask on stderr: stdout may be for a document."""
    sys.stderr.write(f"{question}: ")
    sys.stderr.flush()
    try:
        return input()
    except EOFError as error:
        raise KeyboardInterrupt from error


def place_in_simulation(bench: SimulatedBench) -> Callable[[PlanEntry], Placement]:
    """Return a callback that places the planned target under the simulated camera.

    It raises ``PlanError`` if the bench has no such target.
    """

    def place(entry: PlanEntry) -> Placement:
        try:
            bench.place(entry.target, entry.orientation_deg)
        except ValueError as error:
            raise PlanError(f"capture {entry.index}: {error}") from error
        return "ready"

    return place


def placement_of(
    plan: CapturePlan,
    simulated: SimulatedBench | None,
    place: Callable[[PlanEntry], Placement] | None,
) -> Callable[[PlanEntry], Placement]:
    """Return the callback that has a target placed: by ``place``, and by a simulated bench.

    Raises
    ------
    PlanError
        If a real bench has several targets to place, and nobody to place them.
    """
    if simulated is not None:
        in_simulation = place_in_simulation(simulated)
        if place is None:
            return in_simulation
        return lambda entry: "skip" if place(entry) == "skip" else in_simulation(entry)
    if place is not None:
        return place
    targets = len({entry.placement for entry in plan_entries(plan)})
    if targets > 1:
        raise PlanError(
            f"plan {plan.name} has {targets} targets or orientations to place in turn; "
            "give place=, which has each one placed"
        )
    return lambda _: "ready"


def place_target(
    simulated: SimulatedBench | None, target: str | None, orientation_deg: float = 0.0
) -> None:
    """Place a target, if one is named, under the simulated camera.

    Raises
    ------
    ArgumentError
        If the camera is a real one, or there is no such target.
    """
    if target is None:
        return
    if simulated is None:
        raise ArgumentError("only a simulated bench takes a target", argument="target")
    try:
        simulated.place(target, orientation_deg)
    except ValueError as error:
        raise ArgumentError(str(error), argument="target") from error


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenCamera:
    """A camera without a stage, for the live aid; see ``OpenBench``."""

    camera: Camera
    clock: Callable[[], float]
    simulated: SimulatedBench | None
    warnings: tuple[str, ...] = ()


@contextmanager
def opened_camera(config: BenchConfig) -> Iterator[OpenCamera]:
    """Open the camera of a bench and close it at the end.

    Raises
    ------
    BenchConfigError, DeviceError
        If it cannot be opened.
    """
    if config.camera.driver == "simulated":
        with open_bench(config) as bench:
            yield OpenCamera(camera=bench.camera, clock=bench.clock, simulated=bench.simulated)
        return
    with closing(open_camera(config.camera)) as camera:
        yield OpenCamera(
            camera=camera, clock=time.monotonic, simulated=None, warnings=camera.warnings
        )


def devices_of(opened: OpenBench, config: BenchConfig) -> BenchDevices:
    """The devices of an opened bench, as a sweep takes them."""
    return BenchDevices(config=config, camera=opened.camera, stage=opened.stage, clock=opened.clock)
