"""What a controller of one axis has to offer, for `MotorStage` to make a `Stage` of it."""

from dataclasses import dataclass
from threading import Event
from typing import Protocol

from acquisition.devices import DeviceInfo, StageState
from acquisition.errors import DeviceError

POLL_S = 0.05
"""The Grbl manual asks for at most 10 to 20 reports a second."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisReading:
    """Height, and whether the motor runs, asked for one after the other."""

    height_mm: float
    is_moving: bool


@dataclass(frozen=True, slots=True, kw_only=True)
class AxisTraits:
    """How a controller differs from others in being read and stopped.

    Parameters
    ----------
    repeat_mm
        Two readings of an axis that stands differ by no more.
    is_homing_cancellable
        Whether `MotorAxis.cancel` ends homing; otherwise only `MotorAxis.abort` does.
    may_move_after
        Errors of a move after which the motor may still run, so that it has to be stopped.
    """

    repeat_mm: float
    is_homing_cancellable: bool
    may_move_after: tuple[type[DeviceError], ...]


class MovableAxis(Protocol):
    """What `travel` and `halt` need of an axis."""

    @property
    def name(self) -> str:
        """What errors call it."""
        ...

    def start_move(self, height_mm: float) -> None:
        """Start towards a height; returns at once.

        Raises
        ------
        StageLimitError, DeviceRefusalError
            If the controller refuses; nothing moves.
        DeviceTimeoutError, DeviceProtocolError
            If the answer was lost or spoilt: it may move or not.
        """
        ...

    def wait_until_still(self, height_mm: float, deadline: float) -> float:
        """Wait until the motor stands, and return where; ``height_mm`` is where it should.

        Raises
        ------
        DeviceTimeoutError
            If it still moves at the deadline.
        """
        ...

    def cancel(self) -> None:
        """Ask for a controlled stop; returns at once, the position stays known."""
        ...

    def is_moving(self) -> bool:
        """Ask whether the motor runs; faults and resets are not looked for."""
        ...

    def abort(self) -> None:
        """End what `cancel` does not end; the position is void."""
        ...


class MotorAxis(MovableAxis, Protocol):
    """One axis of a controller, in heights; it obeys and reports, and decides nothing.

    Every call may raise the errors of a line: timeout, protocol, disconnected. A call that hears
    of an alarm or a reset sets ``is_position_known`` False and raises it.
    """

    is_position_known: bool
    """Set by whoever homes."""

    @property
    def info(self) -> DeviceInfo:
        """Who the controller says it is."""
        ...

    @property
    def warnings(self) -> tuple[str, ...]:
        """What the operator should know."""
        ...

    @property
    def traits(self) -> AxisTraits:
        """How it differs from others."""
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
        """Height of an axis that takes a move now.

        Raises
        ------
        StageNotHomedError, StageAlarmError, DeviceError
            If it takes none.
        """
        ...

    def height_mm(self) -> float:
        """Ask for the height alone."""
        ...

    def reading(self) -> AxisReading:
        """Ask for height and motion."""
        ...

    def interrupt(self) -> None:
        """Halt the motor at once, also while another thread is in the dialogue."""
        ...

    def prepare_homing(self) -> None:
        """Check what has to be right before homing; moves nothing."""
        ...

    def check_reference(self, deadline: float, stop: Event) -> None:
        """Find out whether steps were lost since the homing before, where that can be done.

        Raises
        ------
        DeviceTimeoutError
            If it takes too long; it may move.
        """
        ...

    def find_reference(self, deadline: float) -> None:
        """Home, and return once the axis stands at its reference.

        Raises
        ------
        DeviceTimeoutError, DeviceProtocolError
            If it did not say in time that it is homed; it may move.
        DeviceError
            If it found no reference; it stands.
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
