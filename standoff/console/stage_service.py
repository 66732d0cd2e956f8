"""Owns the stage: reads it while nobody moves it, lends it to one job, reopens it when lost."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from threading import Lock

from acquisition.devices import DeviceInfo, HomingStage, Stage, StageState, TravellingStage
from acquisition.errors import (
    DeviceDisconnectedError,
    DeviceError,
    OperatorStopError,
    StageNotHomedError,
)
from standoff.console.devices import DeviceStatus, Service

POLL_S = 0.2
TURN_S = 0.05
"""How long to wait for a job that talks to the stage, before its height is read on the way."""

RETRY_S = 1.0
CLOSE_TIMEOUT_S = 3.0

LOST_REMEDY = (
    "Watch the stage: without its cable it continues to its target; use its emergency stop if "
    "that is dangerous. Check cable and power. The console reconnects automatically; then home "
    "the stage."
)
ABSENT_REMEDY = (
    "Switch the stage on, and check its cable, the port in the bench file, and that no other "
    "program has it open. The console keeps trying."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class StageView:
    """The state of the stage: ``height_mm`` is None if it is unknown.

    ``target_mm`` is the height it is moving to, None at rest; ``read_s`` is when the height was
    read (monotonic), None if it never was.
    """

    status: DeviceStatus
    state: StageState = "unknown"
    height_mm: float | None = None
    target_mm: float | None = None
    is_homed: bool = False
    limits_mm: tuple[float, float] = (0.0, 0.0)
    info: DeviceInfo | None = None
    warnings: tuple[str, ...] = ()
    read_s: float | None = None


class StageService(Service):
    """The stage, read five times a second; a job borrows it, and any thread may stop it.

    It is opened without moving; the argument says that it was open before and may still be moving,
    so that it must be stopped first.
    """

    def __init__(
        self, open_stage: Callable[[bool], Stage], *, limits_mm: tuple[float, float]
    ) -> None:
        super().__init__("stage service", close_timeout_s=CLOSE_TIMEOUT_S)
        self.status = DeviceStatus(state="opening", text="The stage is being opened")
        self._open = open_stage
        self._limits_mm = limits_mm
        self._stage: Stage | None = None
        self._was_open = False
        self._state: StageState = "unknown"
        self._height_mm: float | None = None
        self._read_s: float | None = None
        self._target_mm: float | None = None
        self._is_homed = False
        self._info: DeviceInfo | None = None
        self._turn = Lock()

    @property
    def view(self) -> StageView:
        """The current state."""
        stage = self._stage
        return StageView(
            status=self.status,
            state=self._state,
            height_mm=self._height_mm,
            target_mm=self._target_mm,
            is_homed=self._is_homed,
            limits_mm=self._limits_mm,
            info=self._info,
            warnings=tuple(getattr(stage, "warnings", ())),
            read_s=self._read_s,
        )

    def stop(self) -> None:
        """Stop in a controlled way, at once, from any thread, whoever moves it."""
        stage = self._stage
        if stage is None:
            raise DeviceDisconnectedError(
                f"the stage cannot be told to stop: {self.status.text}; use its emergency stop"
            )
        stage.stop()

    def lent(self, check: Callable[[], None] = lambda: None) -> Stage:
        """Lend the stage to one job, if there is one.

        ``check`` is called before and after each move, and may raise to end the borrower's work.
        """
        if self._stage is None or not self.status.is_ready:
            raise DeviceDisconnectedError(f"{self.status.text}. {self.status.remedy}")
        return _LentStage(self, self._stage, check)

    @contextmanager
    def _talking(self) -> Iterator[None]:
        """Talk to the stage while polling waits; a stage that is disconnected is dropped."""
        with self._turn:
            try:
                yield
            except DeviceDisconnectedError as error:
                self._lost(error)
                raise

    @contextmanager
    def _doing(self, state: StageState, target_mm: float | None) -> Iterator[None]:
        """Show that a job is homing or moving it."""
        with self._talking():
            self._state, self._target_mm = state, target_mm
            try:
                yield
            finally:
                self._target_mm = None
                with suppress(DeviceError):
                    self._read()

    def _run(self) -> None:
        while not self._is_closing.is_set():
            if self._turn.acquire(timeout=TURN_S):
                try:
                    self._poll()
                finally:
                    self._turn.release()
            else:
                self._read_on_the_way()
            self._is_closing.wait(POLL_S if self.status.is_ready else RETRY_S)
        self._drop()

    def _poll(self) -> None:
        try:
            if self._stage is None:
                self._stage = self._open(self._was_open)
                self._was_open = True
                self._info = self._stage.info
            self._read()
        except DeviceDisconnectedError as error:
            self._lost(error)
        except DeviceError as error:
            self._lost(error, is_gone=self._stage is None)
        else:
            self.status = DeviceStatus(state="ready")

    def _read(self) -> None:
        stage = self._stage
        if stage is None:
            return
        asked_s = time.monotonic()
        self._state = stage.state
        self._is_homed = stage.is_homed
        try:
            self._height_mm = stage.position_mm() if self._is_homed else None
        except StageNotHomedError:
            self._height_mm = None
        self._read_s = asked_s

    def _read_on_the_way(self) -> None:
        stage = self._stage
        if isinstance(stage, TravellingStage) and self._state in ("moving", "idle"):
            asked_s = time.monotonic()
            with suppress(DeviceError):
                self._height_mm = stage.travel_height_mm()
                self._read_s = asked_s

    def _lost(self, error: DeviceError, *, is_gone: bool = True) -> None:
        remedy = LOST_REMEDY if self._was_open else ABSENT_REMEDY
        self.status = DeviceStatus(state="lost", text=str(error), remedy=remedy)
        self._state, self._height_mm, self._is_homed = "unknown", None, False
        if is_gone:
            self._drop()

    def _drop(self) -> None:
        if self._stage is not None:
            stage, self._stage = self._stage, None
            stage.close()


class _LentStage:
    """The `Stage` lent to a job: its state reaches all viewers, and it can be stopped."""

    def __init__(self, service: StageService, stage: Stage, check: Callable[[], None]) -> None:
        self._service = service
        self._stage = stage
        self._check = check

    @property
    def info(self) -> DeviceInfo:
        return self._stage.info

    @property
    def limits_mm(self) -> tuple[float, float]:
        return self._stage.limits_mm

    @property
    def homing_s(self) -> float:
        return self._stage.homing_s if isinstance(self._stage, HomingStage) else 0.0

    @property
    def is_homed(self) -> bool:
        return self._stage.is_homed

    @property
    def state(self) -> StageState:
        with self._service._talking():
            return self._stage.state

    def home(self, timeout_s: float) -> None:
        with self._service._doing("homing", None), self._stoppable():
            self._stage.home(timeout_s)

    def move_to(self, height_mm: float, timeout_s: float) -> float:
        with self._service._doing("moving", height_mm), self._stoppable():
            return self._stage.move_to(height_mm, timeout_s)

    def position_mm(self) -> float:
        with self._service._talking():
            return self._stage.position_mm()

    def stop(self) -> None:
        self._stage.stop()

    def emergency_stop(self) -> None:
        self._stage.emergency_stop()

    def clear_alarm(self) -> None:
        with self._service._talking():
            self._stage.clear_alarm()

    def close(self) -> None:
        """Leave it open: the service keeps it."""

    @contextmanager
    def _stoppable(self) -> Iterator[None]:
        """Turn the error of a move that was stopped into the stop itself."""
        self._check()
        try:
            yield
        except (OperatorStopError, DeviceDisconnectedError):
            raise
        except DeviceError as error:
            try:
                self._check()
            except OperatorStopError as stop:
                stop.add_note(str(error))
                raise stop from error
            raise
        self._check()
