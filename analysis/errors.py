"""What can go wrong when results are compared and reported."""

__all__ = ["AnalysisError", "ResultsFileError"]


class AnalysisError(Exception):
    """The captures or results do not allow the analysis that was asked for."""


class ResultsFileError(AnalysisError):
    """A results file cannot be read or written."""
