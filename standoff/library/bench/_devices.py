"""Finds cameras, and opens the devices that a bench file names."""

import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from types import TracebackType
from typing import TYPE_CHECKING, Any, Literal, Self

from acquisition.aravis import AravisCamera
from acquisition.bench import BenchConfig, BenchDevices, CameraConfig, StageConfig
from acquisition.capture import Placement
from acquisition.devices import Camera, Stage
from acquisition.errors import BenchConfigError, DeviceError, PlanError, StageNotHomedError
from acquisition.exposure_control import ExposureControl
from acquisition.plan import CapturePlan, PlanEntry, plan_entries
from acquisition.stages import (
    ManualStage,
    MotorStage,
    home_timeout_s,
    move_timeout_s,
    open_grbl_stage,
    open_zaber_stage,
)
from hil_mocks import SimulatedBench
from simulation.arguments import checked
from standoff.errors import ArgumentError
from standoff.library.bench._plan_preview import bench_config
from standoff.library.call import FilePath
from standoff.library.caller import login_name

if TYPE_CHECKING:
    from acquisition.aravis import FoundCamera


@dataclass(frozen=True, slots=True, kw_only=True)
class OpenBench:
    """Camera and stage, opened; ``simulated`` is the simulated bench behind them, if there is one.

    ``clock`` returns the time in seconds by which both devices run, and ``sleep`` waits; a
    simulated bench has its own. ``warnings`` are for the operator, one line each.
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

    ``ask`` puts a question to the person who moves a manual stage and returns the answer; if None,
    the question is asked at the terminal.
    """
    refuse_half_simulated(config)
    is_simulated = config.camera.driver == "simulated"
    with _simulated_bench(config) if is_simulated else _real_bench(config, ask) as opened:
        yield opened


def refuse_half_simulated(config: BenchConfig) -> None:
    """Refuse a bench of which only one device is simulated in process."""
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
    """Open the real camera that a bench file names."""
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

    ``first`` is sent before the dialogue begins: ``stop`` ends a move that another program left
    running, after which ``stopped`` is called; ``reset`` ends a state in which a Grbl controller
    does not answer. ``ask`` is as in `open_bench`.
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
    """Return the callback that gets a target placed: it calls ``place`` and a simulated bench."""
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
            "give place=, a function that has each of them placed"
        )
    return lambda _: "ready"


def place_target(
    simulated: SimulatedBench | None, target: str | None, orientation_deg: float = 0.0
) -> None:
    """Place a target, if one is named, under the simulated camera."""
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
    """Open the camera of a bench and close it at the end."""
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


class MovableBench:
    """The devices of a bench and the moves of its stage; see `Bench`, which adds captures."""

    @checked
    def __init__(
        self,
        bench: FilePath | BenchConfig,
        *,
        settings: Mapping[str, Any] | None = None,
        operator: str | None = None,
        ask: Callable[[str], str] | None = None,
    ) -> None:
        self.config = bench_config(bench, settings)
        self.operator = operator or login_name()
        self._ask = ask
        self._resources = ExitStack()
        self._opened: OpenBench | None = None
        self._exposures: ExposureControl | None = None
        self._asked_mm: float | None = None

    def __repr__(self) -> str:
        drivers = f"{self.config.camera.driver} camera, {self.config.stage.driver} stage"
        return f"<Bench: {drivers}, {'open' if self._opened else 'closed'}>"

    def open(self) -> Self:
        """Open the camera and the stage; moves nothing."""
        if self._opened is not None:
            raise DeviceError("the bench is open already; close it first")
        self._opened = self._resources.enter_context(open_bench(self.config, ask=self._ask))
        return self

    def close(self) -> None:
        """Release both devices; closing twice is harmless."""
        self._opened = self._asked_mm = self._exposures = None
        self._resources.close()

    def __enter__(self) -> Self:
        return self if self._opened is not None else self.open()

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    @property
    def camera(self) -> Camera:
        """The camera itself, for operations that this class does not offer."""
        return self._open().camera

    @property
    def stage(self) -> Stage:
        """The stage itself, for operations that this class does not offer."""
        return self._open().stage

    @property
    def devices(self) -> BenchDevices:
        """Both devices with their config and clock, as functions of ``acquisition`` take them."""
        opened = self._open()
        return BenchDevices(
            config=self.config,
            camera=opened.camera,
            stage=opened.stage,
            clock=opened.clock,
            sleep=opened.sleep,
        )

    @property
    def warnings(self) -> tuple[str, ...]:
        """What an operator should know about the devices, one line each."""
        return self._open().warnings

    @property
    def limits_mm(self) -> tuple[float, float]:
        """Lowest and highest height that a move may ask for, in mm."""
        return self.stage.limits_mm

    @property
    def height_mm(self) -> float:
        """Height read back from the stage now, in mm."""
        return self.stage.position_mm()

    @property
    def asked_mm(self) -> float:
        """Height in mm that `move` last asked for; the one read back if it was moved otherwise."""
        return self.height_mm if self._asked_mm is None else self._asked_mm

    @property
    def simulated(self) -> SimulatedBench | None:
        """The simulated bench behind both devices; None if the bench is real."""
        return self._open().simulated

    @property
    def is_simulated(self) -> bool:
        """Whether camera, stage and scene are simulated in this process."""
        return self.simulated is not None

    def home(self) -> float:
        """Home the stage to its reference switch and return the height there, in mm."""
        self._asked_mm = None
        stage = self.stage
        with _stopping_if_interrupted(stage):
            stage.home(home_timeout_s(self.config.stage, stage))
        return stage.position_mm()

    @checked
    def move(self, height_mm: float) -> float:
        """Move to a height in mm, wait until settled, and return the height read back, in mm."""
        self._asked_mm = None
        stage = self.stage
        try:
            with _stopping_if_interrupted(stage):
                found_mm = stage.move_to(height_mm, move_timeout_s(self.config.stage))
        except StageNotHomedError as error:
            raise StageNotHomedError(f"{error}; call home() first, which moves it") from error
        self._asked_mm = height_mm
        return found_mm

    def stop(self) -> None:
        """Stop the stage with a controlled deceleration; any thread may call this."""
        self.stage.stop()

    @checked
    def place(self, target: str, orientation_deg: float = 0.0) -> None:
        """Place a target under the camera of a simulated bench."""
        simulated = self.simulated
        if simulated is None:
            raise DeviceError("only a simulated bench places its own targets; place it by hand")
        simulated.place(target, orientation_deg)

    def _exposure_control(self) -> ExposureControl:
        opened = self._open()
        if self._exposures is None:
            configured_us = self.config.camera.exposure_us
            self._exposures = ExposureControl(opened.camera, configured_us, opened.clock)
        return self._exposures

    def _open(self) -> OpenBench:
        if self._opened is None:
            raise DeviceError("the bench is closed; use it inside `with bench:`, or call open()")
        return self._opened


@contextmanager
def _stopping_if_interrupted(stage: Stage) -> Iterator[None]:
    """Stop the stage if the move in the block is interrupted; a failed one stops by itself."""
    try:
        yield
    except KeyboardInterrupt as interrupt:
        try:
            stage.stop()
        except DeviceError as error:
            interrupt.add_note(f"stopping the stage failed: {error}")
        raise


@checked
def find_cameras() -> tuple["FoundCamera", ...]:
    """Search for cameras; this broadcasts on every network interface of this computer.

    Returns
    -------
    tuple of FoundCamera
        Address, vendor, model, serial number and id of each camera that answers.

    Raises
    ------
    DriverMissingError
        If Aravis or PyGObject is not installed.

    Examples
    --------
    >>> [camera.address for camera in standoff.find_cameras()]  # doctest: +SKIP
    """
    from acquisition.aravis import list_cameras  # at the call: a stand-in may take its place

    return list_cameras()
