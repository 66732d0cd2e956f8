"""Errors of the application itself, and those that every command turns into exit status 1."""

from acquisition.errors import DeviceError, ExportError, KeepsFacts, SessionError
from analysis.errors import AnalysisError
from calibration.errors import CalibrationError
from simulation.arguments import (
    ArgumentError as ArgumentError,
    ArgumentTypeError as ArgumentTypeError,
)


class ApplicationError(KeepsFacts, Exception):
    """A command cannot do its work with the files it was given."""


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
