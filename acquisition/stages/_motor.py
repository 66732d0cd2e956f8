"""What every motorised stage does, whatever its controller: move, settle, stop, home."""

from collections.abc import Callable
from dataclasses import dataclass
from math import isfinite
from threading import Event
from typing import Protocol

from acquisition.bench import StageConfig
from acquisition.devices import DeviceInfo, HomingStage, Stage, StageState
from acquisition.errors import (
    DeviceError,
    DeviceProtocolError,
    DeviceResetError,
    DeviceTimeoutError,
    StageAlarmError,
    StageLimitError,
    StageNotHomedError,
    StageNotStoppedError,
    StageStalledError,
    StageStoppedError,
)
from acquisition.quantities import slip_between

POLL_S = 0.05
"""The Grbl manual asks for at most 10 to 20 reports a second."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisReading:
    """Height, the controller's word for what it is doing, and whether the motor is running."""

    height_mm: float
    is_moving: bool
    state: str


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisTraits:
    """How a controller differs from others in reading and stopping.

    ``repeat_mm`` is the largest difference between two readings at rest. After the errors
    ``may_move_after`` of a move the motor may still be running and has to be stopped.
    """

    repeat_mm: float
    is_homing_cancellable: bool
    may_move_after: tuple[type[DeviceError], ...]


class _MovableAxis(Protocol):
    """What `travel` and `halt` need of an axis."""

    @property
    def name(self) -> str:
        """Its name in error messages."""
        ...

    def start_move(self, height_mm: float) -> None:
        """Start a move to a height; if refused nothing moves, if the answer is lost it may."""
        ...

    def wait_until_still(self, height_mm: float, deadline: float) -> float:
        """Wait until the motor stops and return its height; fails if it stalls or is late."""
        ...

    def cancel(self) -> None:
        """Ask for a controlled stop; returns at once, the position stays known."""
        ...

    def is_moving(self) -> bool:
        """Ask whether the motor is running; faults and resets are not checked."""
        ...

    def abort(self) -> None:
        """End what `cancel` does not end; the position is then unknown."""
        ...


class MotorAxis(_MovableAxis, Protocol):
    """One axis of a controller, in heights; it obeys and reports, and decides nothing.

    Every call may raise the errors of a line. One that learns of an alarm or a reset sets
    ``is_position_known`` to False and raises it.
    """

    is_position_known: bool
    """Set by the code that homes."""

    @property
    def info(self) -> DeviceInfo:
        """Identity that the controller reports."""
        ...

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the operator should know."""
        ...

    @property
    def traits(self) -> AxisTraits:
        """How it is read and stopped."""
        ...

    @property
    def homing_s(self) -> float:
        """See `HomingStage`."""
        ...

    def state(self) -> StageState:
        """Ask what it is doing; a fault is a state here, not an error."""
        ...

    def known_height_mm(self) -> float | None:
        """Ask for the height; None where the position is not known."""
        ...

    def travel_height_mm(self) -> float | None:
        """Height for a display while another thread moves the axis; see `TravellingStage`."""
        ...

    def ready_height_mm(self) -> float:
        """Height of an axis that is ready to move; fails if it is not."""
        ...

    def height_mm(self) -> float:
        """Ask for the height only."""
        ...

    def reading(self) -> AxisReading:
        """Ask for height and motion; a fault is an error, as in `wait_until_still`."""
        ...

    def interrupt(self) -> None:
        """Halt the motor at once, even while another thread is in the dialogue."""
        ...

    def prepare_homing(self) -> None:
        """Check the preconditions of homing; moves nothing."""
        ...

    def check_reference(self, deadline: float, stop: Event) -> None:
        """Find out whether steps were lost since the last homing, where that is possible.

        After a `DeviceTimeoutError` it may still be moving.
        """
        ...

    def find_reference(self, deadline: float) -> None:
        """Home, and return once the axis is at rest at its reference.

        After a `DeviceTimeoutError` or `DeviceProtocolError` it may still be moving, after others
        it has stopped.
        """
        ...

    def refresh_warnings(self) -> None:
        """Bring ``warnings`` up to date after a move."""
        ...

    def clear_alarm(self) -> None:
        """Leave an alarm; moves nothing."""
        ...

    def close(self) -> None:
        """Close the link; closing twice is harmless."""
        ...


_NO_PROGRESS_S = 2.0
"""Longer than a ramp, a late report or the start of a move takes; a time limit is minutes."""

_SHARE_OF_FEED = 0.25
"""Part of the feed below which a move counts as blocked: ramps are short beside that time."""


def smallest_progress_mm(config: StageConfig, traits: AxisTraits) -> float:
    """Travel that is progress: more than a reading repeats to, less than a slow feed covers."""
    covered_mm = config.feed_mm_per_min / 60 * _NO_PROGRESS_S
    return min(traits.repeat_mm, _SHARE_OF_FEED * covered_mm)


class ProgressWatch:
    """Watches a distance that has to shrink by ``least_mm`` within a time and some readings."""

    def __init__(self, *, clock: Callable[[], float], least_mm: float, readings: int = 2) -> None:
        self._clock = clock
        self._least_mm = least_mm
        self._readings = readings
        self._best_mm = float("inf")
        self._since_s = clock()
        self._idle_readings = 0

    def see(self, distance_mm: float, *, state: str, height_mm: float) -> None:
        """Take note of a reading."""
        if distance_mm < self._best_mm - self._least_mm:
            self._best_mm, self._since_s, self._idle_readings = distance_mm, self._clock(), 0
            return
        self._idle_readings += 1
        if (
            self._clock() - self._since_s >= _NO_PROGRESS_S
            and self._idle_readings >= self._readings
        ):
            raise StageStalledError(
                f"no progress for {_NO_PROGRESS_S:g} s: the controller reports {state} "
                f"at {height_mm:.3f} mm",
                timeout_s=_NO_PROGRESS_S,
                state=state,
                height_mm=height_mm,
            )


def refuse_beyond_limits(height_mm: float, limits_mm: tuple[float, float]) -> None:
    """Raise if a height is outside the travel of a stage."""
    low_mm, high_mm = limits_mm
    if not (isfinite(height_mm) and low_mm <= height_mm <= high_mm):
        raise StageLimitError(
            f"the stage travels from {low_mm:g} to {high_mm:g} mm, not to {height_mm:g} mm; "
            f"nothing moved{slip_between(height_mm, 'mm', low_mm, high_mm)}",
            height_mm=height_mm,
            limits_mm=limits_mm,
        )


def _approach_heights_mm(
    config: StageConfig, *, start_mm: float, target_mm: float, is_flank_taken: bool
) -> list[float]:
    """One or two heights to visit in turn: the target is approached from the configured side.

    ``is_flank_taken`` is whether the last move already came from that side.
    """
    side = 1.0 if config.approach == "from_below" else -1.0
    needed_mm = 0.0 if is_flank_taken else config.backlash_mm
    if side * (target_mm - start_mm) >= needed_mm:
        return [target_mm]
    low_mm, high_mm = config.limits_mm
    before_mm = min(max(target_mm - side * config.backlash_mm, low_mm), high_mm)
    return [target_mm] if before_mm == target_mm else [before_mm, target_mm]


def move_timeout_s(config: StageConfig) -> float:
    """Twice the whole travel at the feed, for ramps and backlash moves, and the settling."""
    travel_mm = config.limits_mm[1] - config.limits_mm[0]
    return 10.0 + config.settle_s + 2.0 * 60.0 * travel_mm / config.feed_mm_per_min


def home_timeout_s(config: StageConfig, stage: Stage) -> float:
    """Time for homing, by the bench file or, with a quarter more, by the controller's own rates."""
    stated_s = stage.homing_s if isinstance(stage, HomingStage) else 0.0
    return 30.0 + max(move_timeout_s(config), 1.25 * stated_s)


STOP_TIMEOUT_S = 5.0
"""Longer than any deceleration."""

_CREEP_READINGS = 3
"""Settling times in which the movement between two readings has to become smaller."""

_ROUNDING_MM = 1e-6
"""Heights are rounded to this, so it allows for binary rounding noise."""


class MotorStage:
    """Approaches heights from one side with a connected axis; trusts only what it reads back."""

    def __init__(
        self,
        config: StageConfig,
        axis: MotorAxis,
        *,
        clock: Callable[[], float],
        sleep: Callable[[float], None],
    ) -> None:
        self._config = config
        self._axis = axis
        self._clock = clock
        self._sleep = sleep
        self._stop = Event()
        self._is_flank_taken = False
        self._is_homing = False
        self._is_moving = False
        self._is_emergency = False

    @property
    def info(self) -> DeviceInfo:
        """See `Stage.info`."""
        return self._axis.info

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the operator should know."""
        return self._axis.warnings

    @property
    def limits_mm(self) -> tuple[float, float]:
        """See `Stage.limits_mm`."""
        return self._config.limits_mm

    @property
    def homing_s(self) -> float:
        """See `HomingStage`."""
        return self._axis.homing_s

    @property
    def is_homed(self) -> bool:
        """See `Stage.is_homed`."""
        return self._axis.is_position_known and not self._is_emergency

    @property
    def state(self) -> StageState:
        """See `Stage.state`."""
        if self._is_emergency:
            return "alarm"
        state = self._axis.state()
        return "homing" if state == "moving" and self._is_homing else state

    def position_mm(self) -> float:
        """See `Stage.position_mm`."""
        height_mm = None if self._is_emergency else self._axis.known_height_mm()
        if height_mm is None:
            raise StageNotHomedError(f"{self._axis.name} does not know its height: home it")
        return height_mm

    def travel_height_mm(self) -> float | None:
        """See `TravellingStage`."""
        return self._axis.travel_height_mm() if self.is_homed else None

    def home(self, timeout_s: float) -> None:
        """See `Stage.home`."""
        self._refuse_emergency()
        deadline = self._clock() + timeout_s
        self._stop.clear()
        self._axis.prepare_homing()
        self._check_reference(deadline)
        self._axis.is_position_known = False
        self._is_flank_taken = False
        # Stays set through a keyboard interrupt: `stop` must know what to end.
        self._is_homing = True
        try:
            self._axis.find_reference(deadline)
        except (DeviceTimeoutError, DeviceProtocolError) as error:
            text = f"{self._axis.name} was not homed within {timeout_s:g} s: {error}"
            raise self._halted(error, text, timeout_s) from error
        except DeviceError:
            self._is_homing = False
            raise
        self._is_homing = False
        if self._stop.is_set():
            raise _told_to_stop(self._axis)
        self._axis.is_position_known = True

    def move_to(self, height_mm: float, timeout_s: float) -> float:
        """See `Stage.move_to`."""
        refuse_beyond_limits(height_mm, self.limits_mm)
        if self._is_moving:
            raise DeviceError(f"{self._axis.name} is already moving; nothing was sent")
        self._stop.clear()
        self._refuse_emergency()
        deadline = self._clock() + timeout_s
        stops_mm = _approach_heights_mm(
            self._config,
            start_mm=self._axis.ready_height_mm(),
            target_mm=height_mm,
            is_flank_taken=self._is_flank_taken,
        )
        self._is_moving, self._is_flank_taken = True, False
        try:
            for stop_mm in stops_mm:
                travel(
                    self._axis,
                    stop_mm,
                    tolerance_mm=self._config.tolerance_mm,
                    deadline=deadline,
                    stop=self._stop,
                )
            read_back_mm = self._settle(height_mm, deadline)
        except self._axis.traits.may_move_after as error:
            text = str(error)
            if isinstance(error, DeviceTimeoutError):
                is_stalled = isinstance(error, StageStalledError)
                limit = "" if is_stalled else f" within {timeout_s:g} s"
                text = f"{self._axis.name} did not settle at {height_mm:g} mm{limit}: {error}"
            raise self._halted(error, text, timeout_s) from error
        finally:
            self._is_moving = False
        self._is_flank_taken = True
        self._axis.refresh_warnings()
        return read_back_mm

    def stop(self) -> None:
        """See `Stage.stop`; a stage that was homing has to be homed again."""
        self._stop.set()
        self._is_flank_taken = False
        was_homing, self._is_homing = self._is_homing, False
        if was_homing and not self._axis.traits.is_homing_cancellable:
            # At once: another thread may be in the dialogue until homing ends.
            self._axis.interrupt()
            self._axis.abort()
            return
        halt(self._axis, clock=self._clock, sleep=self._sleep)

    def stop_first(self) -> None:
        """Stop what another program left running, before any dialogue; return once it stands."""
        deadline = self._clock() + STOP_TIMEOUT_S
        while True:
            try:
                self.stop()
            except (StageAlarmError, DeviceResetError):
                return
            except DeviceError as error:
                # A controller that starts up answers nothing for two seconds.
                is_mute = isinstance(error, DeviceTimeoutError | DeviceProtocolError)
                if is_mute and self._clock() < deadline:
                    continue
                raise StageNotStoppedError(
                    f"it is not certain that {self._axis.name} has stopped; use its emergency "
                    f"stop: {error}"
                ) from error
            else:
                return

    def emergency_stop(self) -> None:
        """See `Stage.emergency_stop`; leaves an alarm."""
        self._is_emergency = True
        self._is_homing = False
        self._stop.set()
        self._axis.is_position_known = False
        self._axis.interrupt()

    def clear_alarm(self) -> None:
        """See `Stage.clear_alarm`."""
        self._is_homing = False
        self._axis.clear_alarm()
        self._is_emergency = False

    def close(self) -> None:
        """See `Stage.close`."""
        self._axis.close()

    def _refuse_emergency(self) -> None:
        if self._is_emergency:
            raise StageAlarmError(
                f"{self._axis.name} was stopped in an emergency; clear the alarm, then home",
                code="emergency",
            )

    def _check_reference(self, deadline: float) -> None:
        self._is_moving, self._is_flank_taken = True, False
        try:
            self._axis.check_reference(deadline, self._stop)
        except DeviceTimeoutError as error:
            raise self._halted(error, str(error), None) from error
        finally:
            self._is_moving = False
        if self._stop.is_set():
            raise _told_to_stop(self._axis)

    def _settle(self, height_mm: float, deadline: float) -> float:
        """Read back after the settling time, until two readings agree."""
        # What relaxes moves less and less; what creeps does not, and would never agree.
        progress = ProgressWatch(clock=self._clock, least_mm=0.0, readings=_CREEP_READINGS)
        before_mm = self._axis.height_mm()
        while True:
            self._sleep(self._config.settle_s)
            reading = self._axis.reading()
            moved_mm = abs(reading.height_mm - before_mm)
            if not reading.is_moving and moved_mm <= self._axis.traits.repeat_mm:
                break
            before_mm = reading.height_mm
            if self._clock() >= deadline:
                raise DeviceTimeoutError(f"it is creeping, now at {before_mm:.3f} mm")
            doing = f"{reading.state} while it creeps"
            progress.see(moved_mm, state=doing, height_mm=before_mm)
            self._sleep(POLL_S)
        if not abs(reading.height_mm - height_mm) <= self._config.tolerance_mm + _ROUNDING_MM:
            raise DeviceTimeoutError(f"it crept to {reading.height_mm:.3f} mm")
        return reading.height_mm

    def _halted(self, error: DeviceError, text: str, timeout_s: float | None) -> DeviceError:
        """Stop after a failure, and return the error that reports the outcome."""
        text = f"{text}; {self._halt()}"
        if isinstance(error, StageStalledError):
            return StageStalledError(
                text,
                timeout_s=error.timeout_s or 0.0,
                state=error.state,
                height_mm=error.height_mm,
            )
        if isinstance(error, DeviceTimeoutError):
            return DeviceTimeoutError(text, timeout_s=timeout_s)
        return type(error)(text)

    def _halt(self) -> str:
        try:
            if self._is_homing and not self._axis.traits.is_homing_cancellable:
                self._is_homing = False
                self._axis.abort()
                return "it was reset: home it again"
            self.stop()
            if self.is_homed:
                return f"it was stopped at {self._axis.height_mm():.3f} mm"
        except DeviceError as error:
            return f"stopping it failed: {error}"
        return "it was stopped"


def travel(
    axis: _MovableAxis, height_mm: float, *, tolerance_mm: float, deadline: float, stop: Event
) -> None:
    """Move to a height and wait for arrival; the move is repeated once after a lost answer.

    A `DeviceTimeoutError` says that it may be moving, a `StageStoppedError` that it stopped
    elsewhere.
    """
    for is_last_try in (False, True):
        if stop.is_set():
            raise _told_to_stop(axis)
        lost: DeviceError | None = None
        try:
            axis.start_move(height_mm)
            if stop.is_set():  # another thread said so just before the move
                axis.cancel()
        except (DeviceTimeoutError, DeviceProtocolError) as error:
            # The axis may or may not move: ask where it is before anything is sent again.
            lost = error
        at_mm = axis.wait_until_still(height_mm, deadline)
        if abs(at_mm - height_mm) <= tolerance_mm + _ROUNDING_MM:
            return
        if lost is not None and is_last_try and not stop.is_set():
            raise lost
        if lost is None or stop.is_set():
            why = " (it was told to stop)" if stop.is_set() else "; home it and try again"
            raise StageStoppedError(
                f"{axis.name} stopped at {at_mm:.3f} mm, not at {height_mm:.3f} mm{why}",
                is_asked=stop.is_set(),
                height_mm=at_mm,
            )


def halt(axis: _MovableAxis, *, clock: Callable[[], float], sleep: Callable[[float], None]) -> None:
    """Stop under control and wait for rest; if it does not stop, abort and lose the position."""
    axis.cancel()
    deadline = clock() + STOP_TIMEOUT_S
    while axis.is_moving():
        if clock() >= deadline:
            axis.abort()
            raise DeviceTimeoutError(
                f"{axis.name} did not stop within {STOP_TIMEOUT_S:g} s and was halted by an "
                "emergency stop: home it again",
                timeout_s=STOP_TIMEOUT_S,
            )
        sleep(POLL_S)


def _told_to_stop(axis: _MovableAxis) -> StageStoppedError:
    return StageStoppedError(
        f"{axis.name} was told to stop; nothing more was sent", is_asked=True, height_mm=None
    )
