"""What can go wrong at the bench and on disk, each error with its facts."""

from collections.abc import Mapping
from pathlib import Path
from typing import Literal


class DeviceError(Exception):
    """A camera or stage did not do what it was asked."""


class DeviceTimeoutError(DeviceError, TimeoutError):
    """A device did not answer or settle within its time limit."""

    def __init__(self, message: str, *, timeout_s: float | None = None) -> None:
        super().__init__(message)
        self.timeout_s = timeout_s


class DeviceDisconnectedError(DeviceError, ConnectionError):
    """A device is gone: cable, power or another program."""


class StreamInterruptedError(DeviceDisconnectedError):
    """A camera's stream broke off; the next start opens the camera anew, so try once more."""


class DeviceInUseError(DeviceError):
    """Another program controls the device."""


class DriverMissingError(DeviceError, ImportError):
    """A library that the driver needs is not installed."""


class OperatorStopError(DeviceError):
    """Somebody pressed stop; the devices are sound, and what was begun was broken off."""


class CameraFeatureError(DeviceError):
    """A camera does not take a setting, or does not keep it."""

    def __init__(self, message: str, *, feature: str) -> None:
        super().__init__(message)
        self.feature = feature


class DeviceProtocolError(DeviceError):
    """A device answered what its protocol does not allow."""


class DeviceRefusalError(DeviceError):
    """A device understood a command and refused it; ``code`` is what it gave as the reason."""

    def __init__(self, message: str, *, code: int | str) -> None:
        super().__init__(message)
        self.code = code


class DeviceSettingsError(DeviceError):
    """A device is not set as it has to be; ``settings`` names what differs."""

    def __init__(self, message: str, *, settings: tuple[str, ...]) -> None:
        super().__init__(message)
        self.settings = settings


class DeviceResetError(DeviceError):
    """A device started anew meanwhile; what it knew, its position too, is lost."""


class CaptureError(DeviceError):
    """A capture could not be completed; nothing of it is kept.

    ``frames_refused`` counts the frames that were no good, by what was wrong with them.
    """

    def __init__(
        self,
        message: str,
        *,
        frames_complete: int,
        frames_asked: int,
        frames_refused: Mapping[str, int] | None = None,
    ) -> None:
        super().__init__(message)
        self.frames_complete = frames_complete
        self.frames_asked = frames_asked
        self.frames_refused = dict(frames_refused or {})


class StageAlarmError(DeviceError):
    """The stage is in alarm and takes no move until the alarm is cleared."""

    def __init__(self, message: str, *, code: int | str | None = None) -> None:
        super().__init__(message)
        self.code = code


class StageLimitError(DeviceError, ValueError):
    """A move was asked for outside the travel; nothing moved.

    ``limits_mm`` is None where the controller refused what the bench file allows.
    """

    def __init__(
        self, message: str, *, height_mm: float, limits_mm: tuple[float, float] | None
    ) -> None:
        super().__init__(message)
        self.height_mm = height_mm
        self.limits_mm = limits_mm


class StageNotHomedError(DeviceError):
    """A move was asked for before the stage was homed; nothing moved."""


class StageStoppedError(DeviceError):
    """The stage stands, but not where it was sent.

    ``is_asked`` says whether somebody stopped it; ``height_mm`` is None where it did not set out.
    """

    def __init__(self, message: str, *, is_asked: bool, height_mm: float | None) -> None:
        super().__init__(message)
        self.is_asked = is_asked
        self.height_mm = height_mm


SessionFault = Literal[
    "not a session", "in use", "made otherwise", "damaged", "changed", "unwritable", "no capture"
]


class SessionError(Exception):
    """A session directory cannot be opened, trusted or written.

    Parameters
    ----------
    fault
        What is wrong, where a program may want to know. What the system refused is the cause,
        an `OSError`.
    path
        The file or directory at fault.
    line
        Of the journal, from 1.
    keys
        Those that are not accepted, or differ from those of the session.
    """

    def __init__(
        self,
        message: str,
        *,
        fault: SessionFault | None = None,
        path: Path | None = None,
        line: int | None = None,
        keys: tuple[str, ...] = (),
    ) -> None:
        super().__init__(message)
        self.fault = fault
        self.path = path
        self.line = line
        self.keys = keys


class BenchConfigError(SessionError, ValueError):
    """A bench file or an override names a key or value that is not accepted."""


class PlanError(SessionError, ValueError):
    """A capture plan names a key or value that is not accepted."""
