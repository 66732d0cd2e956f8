"""Opens and closes the two devices of a bench for a script, and moves its stage."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from types import TracebackType
from typing import Any, Self

from acquisition.bench import BenchConfig, BenchDevices
from acquisition.devices import Camera, Stage
from acquisition.errors import DeviceError, StageNotHomedError
from acquisition.exposure_control import ExposureControl
from acquisition.stages import home_timeout_s, move_timeout_s
from hil_mocks import SimulatedBench
from simulation.arguments import checked
from standoff.library.bench.devices import OpenBench, open_bench
from standoff.library.bench.plan_preview import bench_config
from standoff.library.caller import login_name
from standoff.library.inputs import FilePath


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
        """Open the camera and the stage; moves nothing.

        Raises
        ------
        DeviceError
            If a device cannot be opened, or the bench is open already.
        """
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
        """The camera itself, for what is not offered here."""
        return self._open().camera

    @property
    def stage(self) -> Stage:
        """The stage itself, for what is not offered here."""
        return self._open().stage

    @property
    def devices(self) -> BenchDevices:
        """Both devices with their config and clock, as the functions of ``acquisition`` take."""
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
        """Lowest and highest height that a move may ask for."""
        return self.stage.limits_mm

    @property
    def height_mm(self) -> float:
        """Height read back now.

        Raises
        ------
        StageNotHomedError
            If it is not known.
        """
        return self.stage.position_mm()

    @property
    def asked_mm(self) -> float:
        """Height that the last move asked for; the one read back, if it was moved otherwise."""
        return self.height_mm if self._asked_mm is None else self._asked_mm

    @property
    def simulated(self) -> SimulatedBench | None:
        """The simulated bench of this process behind both devices; None of a real one."""
        return self._open().simulated

    @property
    def is_simulated(self) -> bool:
        """Whether camera, stage and scene are the simulated ones of this process."""
        return self.simulated is not None

    def home(self) -> float:
        """Find the reference switch, and return the height there.

        Raises
        ------
        DeviceError
            If it is not found; the stage is stopped first.
        """
        self._asked_mm = None
        stage = self.stage
        with _stopping_if_interrupted(stage):
            stage.home(home_timeout_s(self.config.stage, stage))
        return stage.position_mm()

    @checked
    def move(self, height_mm: float) -> float:
        """Move to a height and settle; return the height read back.

        Raises
        ------
        StageNotHomedError, StageLimitError
            Before anything moves: if the height is not known, or is outside the travel.
        DeviceError
            If the stage does not arrive; it is stopped first.
        """
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
        """Stop the stage under control; any thread may call it."""
        self.stage.stop()

    @checked
    def place(self, target: str, orientation_deg: float = 0.0) -> None:
        """Place a target under the camera of a simulated bench.

        Raises
        ------
        DeviceError
            If the bench is a real one.
        ValueError
            If there is no such target; the message lists them.
        """
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
