"""What the controller of one axis must provide for `MotorStage` to make a `Stage` of it."""

from dataclasses import dataclass
from threading import Event
from typing import Protocol

from acquisition.devices import DeviceInfo, StageState
from acquisition.errors import DeviceError

POLL_S = 0.05
"""The Grbl manual asks for at most 10 to 20 reports a second."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisReading:
    """Height, and whether the motor is running, queried one after the other.

    ``state`` is the word of the controller for what it is doing.
    """

    height_mm: float
    is_moving: bool
    state: str


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisTraits:
    """How a controller differs from others in reading and stopping.

    Parameters
    ----------
    repeat_mm
        Largest difference between two readings of an axis at rest.
    is_homing_cancellable
        Whether `MotorAxis.cancel` ends homing; otherwise only `MotorAxis.abort` does.
    may_move_after
        Errors of a move after which the motor may still be running and has to be stopped.
    """

    repeat_mm: float
    is_homing_cancellable: bool
    may_move_after: tuple[type[DeviceError], ...]


class MovableAxis(Protocol):
    """What `travel` and `halt` need of an axis."""

    @property
    def name(self) -> str:
        """Its name in error messages."""
        ...

    def start_move(self, height_mm: float) -> None:
        """Start a move to a height; returns at once.

        Raises
        ------
        StageLimitError, DeviceRefusalError
            If the controller refuses; nothing moves.
        DeviceTimeoutError, DeviceProtocolError
            If the answer was lost or garbled: it may or may not move.
        """
        ...

    def wait_until_still(self, height_mm: float, deadline: float) -> float:
        """Wait until the motor stops and return its height; ``height_mm`` is the target.

        Raises
        ------
        StageStalledError
            If it is moving but comes no nearer.
        DeviceTimeoutError
            If it is still moving at the deadline.
        StageAlarmError
            If the controller has ended the move: a door, a hold, an alarm.
        """
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


class MotorAxis(MovableAxis, Protocol):
    """One axis of a controller, in heights; it obeys and reports, and decides nothing.

    Every call may raise the errors of a line: timeout, protocol, disconnected. A call that learns
    of an alarm or a reset sets ``is_position_known`` to False and raises it.
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
        """Height of an axis that is ready to move.

        Raises
        ------
        StageNotHomedError, StageAlarmError, DeviceError
            If it is not ready.
        """
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

        Raises
        ------
        DeviceTimeoutError
            If it takes too long; it may still be moving.
        """
        ...

    def find_reference(self, deadline: float) -> None:
        """Home, and return once the axis is at rest at its reference.

        Raises
        ------
        DeviceTimeoutError, DeviceProtocolError
            If it did not report in time that it is homed; it may still be moving.
        DeviceError
            If it found no reference; it has stopped.
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
