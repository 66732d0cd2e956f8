"""What can go wrong at the bench and on disk, each error with its facts."""

__all__ = [
    "BenchConfigError",
    "CameraFeatureError",
    "CaptureError",
    "DeviceDisconnectedError",
    "DeviceError",
    "DeviceInUseError",
    "DeviceProtocolError",
    "DeviceResetError",
    "DeviceTimeoutError",
    "DriverMissingError",
    "OperatorStopError",
    "PlanError",
    "SessionError",
    "StageAlarmError",
    "StageLimitError",
    "StageNotHomedError",
    "StreamInterruptedError",
]


class DeviceError(Exception):
    """A camera or stage did not do what it was asked."""


class DeviceTimeoutError(DeviceError, TimeoutError):
    """A device did not answer or settle within its time limit."""


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


class DeviceResetError(DeviceError):
    """A device started anew meanwhile; what it knew, its position too, is lost."""


class CaptureError(DeviceError):
    """A capture could not be completed; nothing of it is kept."""

    def __init__(self, message: str, *, frames_complete: int, frames_asked: int) -> None:
        super().__init__(message)
        self.frames_complete = frames_complete
        self.frames_asked = frames_asked


class StageAlarmError(DeviceError):
    """The stage is in alarm and takes no move until the alarm is cleared."""

    def __init__(self, message: str, *, code: int | str | None = None) -> None:
        super().__init__(message)
        self.code = code


class StageLimitError(DeviceError, ValueError):
    """A move was asked for outside the travel; nothing moved."""


class StageNotHomedError(DeviceError):
    """A move was asked for before the stage was homed; nothing moved."""


class SessionError(Exception):
    """A session directory cannot be opened, trusted or written."""


class BenchConfigError(SessionError, ValueError):
    """A bench file or an override names a key or value that is not accepted."""


class PlanError(SessionError, ValueError):
    """A capture plan names a key or value that is not accepted."""
