"""A stepper motor as driven by firmware: ramps, a step counter, and a plant."""

from math import copysign, sqrt

from hil_mocks.stages.plant import StagePlant


class StepperAxis:
    """Counts steps and turns the plant's motor; it never learns the carriage's true height.

    Parameters
    ----------
    plant
        The mechanics that the motor drives.
    steps_per_mm
        Resolution of the counter.
    acceleration_mm_per_s2
        Acceleration of every ramp.
    """

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

    def shift(self, delta_mm: float) -> None:
        """Count a movement without motor steps, as an encoder does."""
        self._position_mm += delta_mm
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
