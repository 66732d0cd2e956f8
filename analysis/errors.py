"""Errors raised when results are compared and reported."""

from functools import partial
from typing import Any, Literal

from acquisition.errors import KeepsFacts
from calibration.errors import DocumentError

DetectorFault = Literal["crashed", "hung", "not_finite", "shape", "missing", "output"]
"""How a detector of changes can fail; an exception that it raises counts as ``crashed``."""


class AnalysisError(KeepsFacts, Exception):
    """The captures or results do not allow the analysis that was asked for."""


class BeyondCurveError(AnalysisError):
    """A zoom that a curve of d' does not reach; ``largest_zoom`` is the curve's last."""

    def __init__(self, message: str, *, zoom: float, largest_zoom: float) -> None:
        super().__init__(message)
        self.zoom = zoom
        self.largest_zoom = largest_zoom


class NotDetectableError(AnalysisError):
    """A change is not detectable as requested: at ``zoom`` the curve's ``d_prime`` is too low."""

    def __init__(self, message: str, *, zoom: float, d_prime: float) -> None:
        super().__init__(message)
        self.zoom = zoom
        self.d_prime = d_prime


class OverlapError(AnalysisError):
    """Two images overlap too little; ``shared_px`` is the number of pixels they share."""

    def __init__(self, message: str, *, shared_px: int) -> None:
        super().__init__(message)
        self.shared_px = shared_px


class ResultsFileError(AnalysisError, DocumentError):
    """A results file cannot be read or written, or lacks what is needed."""


class SweepError(AnalysisError):
    """A sweep cannot go on: its workers are not fit for it, or a photograph was refused."""


class RefusedPhotographError(AnalysisError):
    """A photograph cannot be read or measured; a sweep lists it and goes on.

    ``is_unread`` says that the file could not be read, which may be otherwise another time.
    """

    def __init__(self, message: str, *, is_unread: bool = False) -> None:
        super().__init__(message)
        self.is_unread = is_unread


class SrDatasetError(AnalysisError):
    """A dataset of training pairs has other settings, or cannot be written."""


class DetectorError(AnalysisError):
    """A detector of changes cannot be run, or gave no usable answer; ``reason`` is the kind."""

    def __init__(self, message: str, *, reason: DetectorFault) -> None:
        super().__init__(message)
        self.reason: DetectorFault = reason

    def __reduce__(self) -> tuple[Any, ...]:
        # Errors come back from worker processes.
        return partial(type(self), reason=self.reason), self.args
