"""What can go wrong when results are compared and reported."""

__all__ = ["AnalysisError", "OverlapError", "ResultsFileError"]


class AnalysisError(Exception):
    """The captures or results do not allow the analysis that was asked for."""


class OverlapError(AnalysisError):
    """Two images share too little; ``shared_px`` is what they do share."""

    def __init__(self, message: str, *, shared_px: int) -> None:
        super().__init__(message)
        self.shared_px = shared_px


class ResultsFileError(AnalysisError):
    """A results file cannot be read or written, or does not hold what is needed of it.

    ``source`` names the file, ``key`` the value at fault in dotted form (``curves.0.zoom``); it is
    None where the fault is not in a value.
    """

    def __init__(self, message: str, *, source: str | None = None, key: str | None = None) -> None:
        super().__init__(message)
        self.source = source
        self.key = key
