"""Errors of the application itself, and those that every command turns into exit status 1."""

from acquisition.errors import DeviceError, ExportError, KeepsFacts, SessionError
from analysis.errors import AnalysisError
from calibration.errors import CalibrationError


class ApplicationError(KeepsFacts, Exception):
    """A command cannot do its work with the files it was given."""


class ArgumentError(ValueError):
    """An argument of a public function that cannot be, or does not go with the others.

    ``argument`` names it, where the message leaves that to whoever shows it.

    Examples
    --------
    >>> try:
    ...     standoff.reading("sunlight")
    ... except standoff.ArgumentError as error:
    ...     print(error)
    expected auto, linear, srgb or gamma:G such as gamma:2.2, got 'sunlight'
    """

    def __init__(self, text: str, *, argument: str | None = None) -> None:
        super().__init__(text)
        self.argument = argument


class ImageFileError(ApplicationError):
    """An image file cannot be read or written."""


class HintError(ApplicationError):
    """What an operator says of a pair of photographs does not belong to it."""


REPORTED_ERRORS = (
    AnalysisError,
    ApplicationError,
    CalibrationError,
    DeviceError,
    ExportError,
    SessionError,
)
"""Errors that a command reports in one line with exit status 1."""
