"""Errors of the application itself, and those that every command turns into exit status 1."""

from acquisition.errors import (
    ApplicationError as ApplicationError,
    DeviceError,
    ExportError,
    HintError as HintError,
    ImageFileError as ImageFileError,
    SessionError,
)
from analysis.errors import AnalysisError
from calibration.errors import CalibrationError
from simulation.arguments import (
    ArgumentError as ArgumentError,
    ArgumentTypeError as ArgumentTypeError,
)

REPORTED_ERRORS = (
    AnalysisError,
    ApplicationError,
    CalibrationError,
    DeviceError,
    ExportError,
    SessionError,
)
"""Errors that a command reports in one line with exit status 1."""
