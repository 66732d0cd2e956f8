"""The simulated stage: an in-process `Stage` with faults on demand."""

from dataclasses import dataclass
from math import ceil, floor, isfinite
from typing import Literal

from acquisition.bench import StageConfig
from acquisition.devices import DeviceInfo, StageState
from acquisition.errors import (
    DeviceDisconnectedError,
    DeviceTimeoutError,
    StageAlarmError,
    StageLimitError,
    StageNotHomedError,
    StageStalledError,
    StageStoppedError,
)
from hil_mocks.clock import SimulatedClock

STEPS_PER_MM = 250.0
"""Steps of 4 um: 20.25 mm is between two of them and reads back as 20.248 mm."""

GIVES_UP_S = 2.0
"""Time without progress after which a move ends."""

OVERSHOOT_MM = 0.5
"""How far a move from the wrong side overshoots its target before it approaches."""


@dataclass(frozen=True, slots=True, kw_only=True)
class StageFaults:
    """Faults from now on.

    Parameters
    ----------
    never_settles
        The stage arrives but keeps vibrating: it gives up after `GIVES_UP_S`.
    stops_short_mm
        The stage stops this far before its target, and its read-back says so.
    interrupted_by
        The next move stops half-way: a door was opened, or somebody pressed hold. The position is
        then void; the alarm can be cleared once this is None.
    alarm
        Text of an alarm that the next move raises before anything moves.
    home_switch_missing
        Homing never finds its switch.
    lost_steps_mm
        The true height is this far below the read-back, which does not show it.
    backlash_mm
        Play of the spindle: the true height lags by this when the last move was not from the
        configured side. The read-back does not show it either.
    unplugged
        Nothing answers.
    """

    never_settles: bool = False
    stops_short_mm: float = 0.0
    interrupted_by: Literal["door", "hold"] | None = None
    alarm: str | None = None
    home_switch_missing: bool = False
    lost_steps_mm: float = 0.0
    backlash_mm: float = 0.0
    unplugged: bool = False


class SimulatedStage:
    """A spindle stage with a stepper motor and a reference switch.

    The switch is at the lower limit if heights are approached from below, else at the upper one.

    Parameters
    ----------
    config
        Limits, feed, settling time and side of approach.
    clock
        Shared with the camera; a move takes its time there.
    """

    def __init__(self, config: StageConfig, *, clock: SimulatedClock) -> None:
        self.faults = StageFaults()
        self._config = config
        self._clock = clock
        self._is_homed = False
        self._is_open = True
        self._is_moving = False
        self._is_stop_wanted = False
        self._alarm: str | None = None
        self._interruption: Literal["door", "hold"] | None = None
        low, high = config.limits_mm
        self._steps = round((low + high) / 2 * STEPS_PER_MM)
        self._came_up = self._approaches_upwards

    @property
    def info(self) -> DeviceInfo:
        """See `Stage.info`."""
        return DeviceInfo(
            vendor="standoff",
            model="Simulated stage",
            serial_number="SIM-1",
            firmware="1",
            driver="simulated",
        )

    @property
    def limits_mm(self) -> tuple[float, float]:
        """See `Stage.limits_mm`."""
        return self._config.limits_mm

    @property
    def is_homed(self) -> bool:
        """See `Stage.is_homed`."""
        return self._is_homed

    @property
    def state(self) -> StageState:
        """See `Stage.state`; only a thread other than the one that moves it sees it moving."""
        self._check_answers()
        if self._alarm is not None:
            return "alarm"
        if self._interruption is not None:
            return self._interruption
        return "moving" if self._is_moving else "idle"

    @property
    def true_height_mm(self) -> float:
        """True height of the camera, which no read-back can show."""
        lag_mm = 0.0
        if self._came_up != self._approaches_upwards:
            lag_mm = self.faults.backlash_mm if self._came_up else -self.faults.backlash_mm
        return self._steps / STEPS_PER_MM - lag_mm - self.faults.lost_steps_mm

    def home(self, timeout_s: float) -> None:
        """See `Stage.home`."""
        self._check_ready()
        low, high = self.limits_mm
        switch = (
            ceil(low * STEPS_PER_MM) if self._approaches_upwards else floor(high * STEPS_PER_MM)
        )
        self._is_homed = self._is_stop_wanted = False
        if self.faults.home_switch_missing:
            self._clock.advance(timeout_s)
        if self.faults.home_switch_missing or not self._travel(switch, timeout_s):
            raise DeviceTimeoutError(
                f"the simulated stage found no reference switch within {timeout_s} s",
                timeout_s=timeout_s,
            )
        self._came_up = self._approaches_upwards
        self._is_homed = True

    def move_to(self, height_mm: float, timeout_s: float) -> float:
        """See `Stage.move_to`."""
        self._check_ready()
        if not self._is_homed:
            raise StageNotHomedError("the simulated stage must be homed before it moves")
        low, high = self.limits_mm
        if not (isfinite(height_mm) and low <= height_mm <= high):
            raise StageLimitError(
                f"the simulated stage travels from {low:g} to {high:g} mm, "
                f"not to {height_mm:g} mm; nothing moved",
                height_mm=height_mm,
                limits_mm=self.limits_mm,
            )
        if self.faults.alarm is not None:
            self._alarm = self.faults.alarm
            raise StageAlarmError(
                f"the simulated stage is in alarm: {self._alarm}", code=self._alarm
            )
        target = self._steps_at(height_mm)
        left_s = timeout_s
        self._is_stop_wanted = False
        for stop in self._stops(target):
            started_s = self._clock.now_s
            if self.faults.interrupted_by is not None:
                self._interrupt((self._steps + stop) // 2, left_s)
            if not self._travel(stop, left_s):
                raise DeviceTimeoutError(
                    f"the simulated stage did not reach {height_mm} mm within {timeout_s} s; "
                    f"it was stopped at {self.position_mm():.3f} mm",
                    timeout_s=timeout_s,
                )
            left_s -= self._clock.now_s - started_s
        self._settle(target, height_mm, left_s, timeout_s)
        return self.position_mm()

    def position_mm(self) -> float:
        """See `Stage.position_mm`.

        Raises
        ------
        StageNotHomedError
            If the position is not known.
        """
        self._check_answers()
        if not self._is_homed:
            raise StageNotHomedError("the simulated stage does not know its position: home it")
        return self._steps / STEPS_PER_MM

    def travel_height_mm(self) -> float | None:
        """See `TravellingStage`."""
        return self._steps / STEPS_PER_MM if self._is_homed else None

    def stop(self) -> None:
        """See `Stage.stop`; only on a real-time clock is there a move to stop."""
        self._check_answers()
        self._is_stop_wanted = True

    def emergency_stop(self) -> None:
        """See `Stage.emergency_stop`; leaves an alarm."""
        self._is_homed = False
        self._alarm = "emergency stop"

    def clear_alarm(self) -> None:
        """See `Stage.clear_alarm`."""
        self._check_answers()
        self._interruption = self.faults.interrupted_by
        self._alarm = None
        self._check_ready()

    def close(self) -> None:
        """See `Stage.close`."""
        self._is_open = False

    @property
    def _approaches_upwards(self) -> bool:
        return self._config.approach == "from_below"

    def _steps_at(self, height_mm: float) -> int:
        """Nearest step within the travel."""
        low, high = self.limits_mm
        nearest = round(height_mm * STEPS_PER_MM)
        return min(max(nearest, ceil(low * STEPS_PER_MM)), floor(high * STEPS_PER_MM))

    def _stops(self, target: int) -> list[int]:
        """Step counts to visit in turn, so that the last one is approached from the right side."""
        side = 1 if self._approaches_upwards else -1
        is_there = target == self._steps and self._came_up == self._approaches_upwards
        if is_there or side * (target - self._steps) > 0:
            return [target]
        low, high = self.limits_mm
        beyond_mm = target / STEPS_PER_MM - side * OVERSHOOT_MM
        return [self._steps_at(min(max(beyond_mm, low), high)), target]

    def _travel(self, target: int, time_s: float) -> bool:
        """Go to the target, or as far as the time allows; return whether it was reached."""
        if target == self._steps:
            return True
        steps_per_s = self._config.feed_mm_per_min / 60 * STEPS_PER_MM
        left_s = max(time_s, 0.0)
        self._came_up = target > self._steps
        self._is_moving = True
        try:
            while True:
                needed_s = abs(target - self._steps) / steps_per_s
                part_s = min(needed_s, left_s, self._clock.slice_s)
                self._clock.advance(part_s)
                if part_s == needed_s:
                    self._steps = target
                    return True
                way = floor(part_s * steps_per_s)
                self._steps += way if target > self._steps else -way
                left_s -= part_s
                if self._is_stop_wanted:
                    at_mm = self._steps / STEPS_PER_MM
                    raise StageStoppedError(
                        f"the simulated stage stopped at {at_mm:.3f} mm, as it was told to",
                        is_asked=True,
                        height_mm=at_mm,
                    )
                if left_s <= 0:
                    return False
        finally:
            self._is_moving = False

    def _settle(self, target: int, height_mm: float, left_s: float, timeout_s: float) -> None:
        if self.faults.stops_short_mm:
            side = 1 if self._approaches_upwards else -1
            self._steps = self._steps_at(target / STEPS_PER_MM - side * self.faults.stops_short_mm)
        is_near = abs(self._steps - target) <= self._config.tolerance_mm * STEPS_PER_MM
        if self.faults.never_settles and left_s > GIVES_UP_S:
            self._clock.advance(GIVES_UP_S)
            raise StageStalledError(
                f"the simulated stage did not settle at {height_mm} mm: no progress for "
                f"{GIVES_UP_S:g} s; it is at {self.position_mm():.3f} mm",
                timeout_s=GIVES_UP_S,
                state="idle",
                height_mm=self.position_mm(),
            )
        if self.faults.never_settles or not is_near or self._config.settle_s > left_s:
            self._clock.advance(max(left_s, 0.0))
            raise DeviceTimeoutError(
                f"the simulated stage did not settle at {height_mm} mm within {timeout_s} s; "
                f"it is at {self.position_mm():.3f} mm",
                timeout_s=timeout_s,
            )
        self._clock.advance(self._config.settle_s)

    def _interrupt(self, steps: int, left_s: float) -> None:
        self._travel(steps, left_s)
        self._interruption, self._is_homed = self.faults.interrupted_by, False
        self._check_ready()

    def _check_ready(self) -> None:
        self._check_answers()
        if self._interruption is not None:
            raise StageAlarmError(
                f"the simulated stage is in state {self._interruption}, in which it cannot move; "
                "close its door or release its hold, then clear the alarm and home",
                code=self._interruption,
            )
        if self._alarm is not None:
            raise StageAlarmError(
                f"the simulated stage is in alarm: {self._alarm}; clear the alarm, then home",
                code=self._alarm,
            )

    def _check_answers(self) -> None:
        if not self._is_open:
            raise DeviceDisconnectedError("the simulated stage is closed")
        if self.faults.unplugged:
            raise DeviceDisconnectedError("the simulated stage does not answer")
