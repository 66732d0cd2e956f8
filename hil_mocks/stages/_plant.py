"""The mechanics of a simulated stage: spindle, carriage, switches, motor, and their faults."""

from dataclasses import dataclass
from math import copysign, cos, exp, pi, sqrt

END_STOP_MM = 3.0
"""The carriage hits its end stop this far beyond a switch."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantFaults:
    """Faults of the mechanics from now on.

    A creeping carriage sinks while at rest; an encoder sees it, a step counter does not. ``slip``
    is the part of every upward travel that is lost between motor and carriage, as in a slack belt;
    no encoder on the motor sees it. By ``windup_mm`` at most the carriage lags behind a turning
    motor, like a spring that friction winds up; it follows within ``relaxation_s`` once the motor
    stands.
    """

    backlash_mm: float = 0.0  # play between spindle and nut
    stalls_above_mm: float | None = None  # the carriage is blocked there; the motor loses steps
    vibration_mm: float = 0.0  # for a while after each move
    vibration_hz: float = 12.0
    vibration_decay_s: float = 0.2
    home_switch_dead: bool = False  # neither switch ever triggers
    home_switch_stuck: bool = False  # both always do
    creep_mm_per_s: float = 0.0
    creep_is_seen: bool = True
    slip: float = 0.0
    windup_mm: float = 0.0
    relaxation_s: float = 0.1


class StagePlant:
    """A carriage on a spindle, between two switches; heights are true ones, in mm."""

    def __init__(
        self, *, low_switch_mm: float = 5.0, high_switch_mm: float = 405.0, start_mm: float = 150.0
    ) -> None:
        self.faults = PlantFaults()
        self.low_switch_mm = low_switch_mm
        self.high_switch_mm = high_switch_mm
        self.slipped_mm = 0.0
        self.now_s = 0.0
        self._motor_mm = start_mm
        self._carriage_mm = start_mm
        self._moved_at_s = -1e9
        self._lag_mm = 0.0

    @property
    def true_height_mm(self) -> float:
        """Height of the camera, including vibration and the spring that the move wound up."""
        faults = self.faults
        since_s = self.now_s - self._moved_at_s
        swing = exp(-since_s / faults.vibration_decay_s) * cos(
            2 * pi * faults.vibration_hz * since_s
        )
        lag_mm = self._lag_mm * exp(-since_s / faults.relaxation_s)
        swing_mm = faults.vibration_mm * swing if faults.vibration_mm else 0.0
        return self._carriage_mm - lag_mm + swing_mm

    @property
    def is_low_pressed(self) -> bool:
        """Whether the lower switch is triggered."""
        return self._switch(self._carriage_mm <= self.low_switch_mm)

    @property
    def is_high_pressed(self) -> bool:
        """Whether the upper switch is triggered."""
        return self._switch(self._carriage_mm >= self.high_switch_mm)

    def turn(self, delta_mm: float) -> None:
        """Turn the motor by this much travel."""
        if not delta_mm:
            return
        self._wind_up(delta_mm)
        self._moved_at_s = self.now_s
        delta_mm *= 1.0 - (self.faults.slip if delta_mm > 0 else 0.0)
        self._motor_mm += delta_mm
        pushed_mm = min(
            max(self._carriage_mm, self._motor_mm), self._motor_mm + self.faults.backlash_mm
        )
        self._push_to(pushed_mm)

    def place(self, height_mm: float) -> None:
        """Turn the spindle by hand."""
        self._motor_mm = self._carriage_mm = height_mm

    def sink(self, distance_mm: float) -> None:
        """Let the carriage sink by itself, the motor with it, without counted steps."""
        self._motor_mm -= distance_mm
        self._carriage_mm -= distance_mm

    def _wind_up(self, delta_mm: float) -> None:
        since_s = self.now_s - self._moved_at_s
        lag_mm = self._lag_mm * exp(-since_s / self.faults.relaxation_s) + delta_mm
        self._lag_mm = min(max(lag_mm, -self.faults.windup_mm), self.faults.windup_mm)

    def _push_to(self, height_mm: float) -> None:
        top_mm = self.high_switch_mm + END_STOP_MM
        if self.faults.stalls_above_mm is not None:
            top_mm = min(top_mm, max(self.faults.stalls_above_mm, self._carriage_mm))
        free_mm = min(max(height_mm, self.low_switch_mm - END_STOP_MM), top_mm)
        self._motor_mm -= height_mm - free_mm
        self.slipped_mm += abs(height_mm - free_mm)
        self._carriage_mm = free_mm

    def _switch(self, is_pressed: bool) -> bool:
        if self.faults.home_switch_stuck:
            return True
        return is_pressed and not self.faults.home_switch_dead


class StepperAxis:
    """Counts steps and turns the plant's motor; it never learns the carriage's true height."""

    def __init__(
        self, plant: StagePlant, *, steps_per_mm: float, acceleration_mm_per_s2: float
    ) -> None:
        self.stops_short_mm = 0.0
        self.ignores_brake = False
        self._plant = plant
        self._steps_per_mm = steps_per_mm
        self._acceleration = acceleration_mm_per_s2
        self._position_mm = 0.0
        self._steps = 0
        self._target_mm: float | None = None
        self._feed = 0.0
        self._velocity = 0.0
        self._is_braking = False

    @property
    def counted_mm(self) -> float:
        """Position by the step counter."""
        return self._steps / self._steps_per_mm

    @property
    def steps(self) -> int:
        """The step counter."""
        return self._steps

    @property
    def is_moving(self) -> bool:
        """Whether the motor is stepping."""
        return self._target_mm is not None or self._velocity != 0.0

    @property
    def speed_mm_per_s(self) -> float:
        """Present speed."""
        return abs(self._velocity)

    def count_from(self, position_mm: float) -> None:
        """Define the present position as ``position_mm``."""
        self._position_mm = position_mm
        self._steps = round(position_mm * self._steps_per_mm)

    def rest(self, duration_s: float) -> None:
        """Stand for a while; an encoder counts what a creeping carriage sinks."""
        faults = self._plant.faults
        sunk_mm = faults.creep_mm_per_s * duration_s
        self._plant.sink(sunk_mm)
        if faults.creep_is_seen:
            self._position_mm -= sunk_mm
            self._steps = round(self._position_mm * self._steps_per_mm)

    def go(self, target_mm: float, feed_mm_per_s: float) -> None:
        """Start a move to a counted position."""
        way_mm = target_mm - self._position_mm
        short_mm = min(self.stops_short_mm, abs(way_mm))
        self._target_mm = target_mm - copysign(short_mm, way_mm)
        self._feed = feed_mm_per_s
        self._is_braking = False

    def brake(self) -> None:
        """Ramp down; the counter stays correct."""
        if self.is_moving and not self.ignores_brake:
            self._is_braking = True

    def halt(self) -> None:
        """Stop stepping at once."""
        self._target_mm = None
        self._velocity = 0.0
        self._is_braking = False

    def advance(self, duration_s: float) -> None:
        """Make the steps of a short interval."""
        if not self.is_moving:
            return
        if self._is_braking:
            self._slow_down(duration_s)
        else:
            self._follow_ramp(duration_s)
        steps = round(self._position_mm * self._steps_per_mm)
        self._plant.turn((steps - self._steps) / self._steps_per_mm)
        self._steps = steps

    def _slow_down(self, duration_s: float) -> None:
        speed = max(abs(self._velocity) - self._acceleration * duration_s, 0.0)
        self._velocity = copysign(speed, self._velocity)
        self._position_mm += self._velocity * duration_s
        if speed == 0.0:
            self.halt()

    def _follow_ramp(self, duration_s: float) -> None:
        target_mm = self._position_mm if self._target_mm is None else self._target_mm
        way_mm = target_mm - self._position_mm
        speed = min(
            abs(self._velocity) + self._acceleration * duration_s,
            self._feed,
            sqrt(2 * self._acceleration * abs(way_mm)),
        )
        step_mm = max(speed * duration_s, 1e-6)
        if step_mm >= abs(way_mm):
            self._position_mm = target_mm
            self.halt()
        else:
            self._velocity = copysign(speed, way_mm)
            self._position_mm += copysign(step_mm, way_mm)
