"""Errors at the bench and on disk, each with its details."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal


class KeepsFacts:
    """Mixin of errors whose details go with them to another process.

    Python makes an error anew of its message alone, which those that need details refuse.
    """

    args: tuple[Any, ...]

    def __reduce__(self) -> tuple[Any, ...]:
        return _with_facts, (type(self), self.args, dict(vars(self)))


def _with_facts(kind: type[Exception], args: tuple[Any, ...], facts: dict[str, Any]) -> Exception:
    error = kind.__new__(kind)
    error.args = args
    vars(error).update(facts)
    return error


class DeviceError(KeepsFacts, Exception):
    """A camera or stage did not do what it was asked to."""


class DeviceTimeoutError(DeviceError, TimeoutError):
    """A device did not answer or settle within its time limit."""

    def __init__(self, message: str, *, timeout_s: float | None = None) -> None:
        super().__init__(message)
        self.timeout_s = timeout_s


class StageStalledError(DeviceTimeoutError):
    """A stage came no nearer to its target, or to rest, for ``timeout_s``; it was stopped first."""

    def __init__(self, message: str, *, timeout_s: float, state: str, height_mm: float) -> None:
        super().__init__(message, timeout_s=timeout_s)
        self.state = state
        self.height_mm = height_mm


class DeviceDisconnectedError(DeviceError, ConnectionError):
    """A device is gone: cable, power or another program."""


class NoRouteError(DeviceDisconnectedError):
    """No network interface of this computer leads to ``address``."""

    def __init__(self, message: str, *, address: str) -> None:
        super().__init__(message)
        self.address = address


class StreamInterruptedError(DeviceDisconnectedError):
    """A camera's stream was interrupted; the next start reopens the camera, so try once more."""


class DeviceInUseError(DeviceError):
    """Another program controls the device."""


class DriverMissingError(DeviceError, ImportError):
    """A library that the driver needs is not installed."""


class StageNotStoppedError(DeviceError):
    """A stage was told to stop, and nothing says that it did."""


class ApplicationError(KeepsFacts, Exception):
    """A question cannot be answered with the files that were given."""


class ImageFileError(ApplicationError):
    """An image file cannot be read or written."""


class HintError(ApplicationError):
    """What an operator says of a pair of photographs does not belong to it."""


class ExportError(KeepsFacts, Exception):
    """A session cannot be written in another format."""


class OperatorStopError(DeviceError):
    """The operator pressed stop; the devices are sound, and work in progress was abandoned."""


class CameraFeatureError(DeviceError):
    """A camera does not accept a setting, or does not keep it."""

    def __init__(self, message: str, *, feature: str) -> None:
        super().__init__(message)
        self.feature = feature


class MissingFeatureError(CameraFeatureError):
    """A camera has no feature of that name; ``names`` are all those that would have done."""

    def __init__(self, message: str, *, names: tuple[str, ...]) -> None:
        super().__init__(message, feature=names[0])
        self.names = names


class DeviceProtocolError(DeviceError):
    """A device sent an answer that its protocol does not allow."""


DescriptionFault = Literal[
    "not XML",
    "too large",
    "circle",
    "missing node",
    "node",
    "register",
    "formula",
    "nowhere",
    "packed",
]


class CameraDescriptionError(DeviceProtocolError):
    """What a camera says of its own features cannot be used; ``nodes`` names those at fault."""

    def __init__(
        self, message: str, *, fault: DescriptionFault, nodes: tuple[str, ...] = ()
    ) -> None:
        super().__init__(message)
        self.fault: DescriptionFault = fault
        self.nodes = nodes


class DeviceRefusalError(DeviceError):
    """A device understood a command and refused it; ``code`` is the reason it gave."""

    def __init__(self, message: str, *, code: int | str) -> None:
        super().__init__(message)
        self.code = code


class DeviceSettingsError(DeviceError):
    """A device does not have the expected settings; ``settings`` names those that differ."""

    def __init__(self, message: str, *, settings: tuple[str, ...]) -> None:
        super().__init__(message)
        self.settings = settings


class DeviceResetError(DeviceError):
    """A device restarted in the meantime; its state, including its position, is lost."""


class CaptureError(DeviceError):
    """A capture could not be completed; nothing of it is kept.

    ``frames_refused`` counts the rejected frames by what was wrong with them; ``packets_resent``
    came meanwhile.
    """

    def __init__(
        self,
        message: str,
        *,
        frames_complete: int,
        frames_asked: int,
        frames_refused: Mapping[str, int] | None = None,
        packets_resent: int = 0,
        resends_packets: bool | None = None,
    ) -> None:
        super().__init__(message)
        self.packets_resent = packets_resent
        self.resends_packets = resends_packets
        self.frames_complete = frames_complete
        self.frames_asked = frames_asked
        self.frames_refused = dict(frames_refused or {})


class StageAlarmError(DeviceError):
    """The stage is in alarm and accepts no move until the alarm is cleared."""

    def __init__(self, message: str, *, code: int | str | None = None) -> None:
        super().__init__(message)
        self.code = code


class StageLimitError(DeviceError, ValueError):
    """A move outside the travel was requested; nothing moved."""

    def __init__(
        self, message: str, *, height_mm: float, limits_mm: tuple[float, float] | None
    ) -> None:
        super().__init__(message)
        self.height_mm = height_mm
        self.limits_mm = limits_mm


class StageNotHomedError(DeviceError):
    """A move was requested before the stage was homed; nothing moved."""


class StageStoppedError(DeviceError):
    """The stage has stopped, asked to or not, but not where it was sent."""

    def __init__(self, message: str, *, is_asked: bool, height_mm: float | None) -> None:
        super().__init__(message)
        self.is_asked = is_asked
        self.height_mm = height_mm


SessionFault = Literal[
    "not a session",
    "in use",
    "made otherwise",
    "damaged",
    "changed",
    "unwritable",
    "no capture",
    "unknown files",
]


class SessionError(KeepsFacts, Exception):
    """A session directory cannot be opened, trusted or written.

    ``fault`` says what is wrong, where a program may want to know. If the system refused something,
    the cause is an `OSError`. ``path`` is the file or directory at fault, ``line`` that of the
    journal, from 1, and ``keys`` are not accepted, or differ from those of the session.
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


class SessionTypeError(SessionError, TypeError):
    """What was given for the folder of a session is no path."""


class BenchConfigError(SessionError, ValueError):
    """A bench file or an override names a key or value that is not accepted."""


class PlanError(SessionError, ValueError):
    """A capture plan names a key or value that is not accepted."""
