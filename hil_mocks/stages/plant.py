"""The mechanics of a simulated stage: spindle, carriage, limit switches, and their faults."""

from dataclasses import dataclass
from math import cos, exp, pi

END_STOP_MM = 3.0
"""The carriage hits its end stop this far beyond a switch."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantFaults:
    """Faults of the mechanics from now on.

    Parameters
    ----------
    backlash_mm
        Play between spindle and nut.
    stalls_above_mm
        The carriage is blocked at this height; the motor loses steps.
    vibration_mm, vibration_hz, vibration_decay_s
        The carriage vibrates for a while after each move.
    home_switch_dead, home_switch_stuck
        Neither switch ever triggers, or both always do.
    creep_mm_per_s, creep_is_seen
        The carriage sinks while at rest, and whether the controller's counter sees it: an encoder
        does, a step counter does not.
    slip
        Fraction of every upward travel that is lost between motor and carriage, as in a slack belt;
        no encoder on the motor sees it, and no driver stalls.
    windup_mm, relaxation_s
        Compliance: the carriage lags behind a turning motor by up to this much, like a spring that
        friction winds up, and follows with this time constant once the motor stands.
    """

    backlash_mm: float = 0.0
    stalls_above_mm: float | None = None
    vibration_mm: float = 0.0
    vibration_hz: float = 12.0
    vibration_decay_s: float = 0.2
    home_switch_dead: bool = False
    home_switch_stuck: bool = False
    creep_mm_per_s: float = 0.0
    creep_is_seen: bool = True
    slip: float = 0.0
    windup_mm: float = 0.0
    relaxation_s: float = 0.1


class StagePlant:
    """A carriage on a spindle, between two switches; heights are true ones, in mm.

    Parameters
    ----------
    low_switch_mm, high_switch_mm
        Heights at which the switches trigger.
    start_mm
        Initial height of the carriage.
    """

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
