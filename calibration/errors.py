"""What can go wrong between photographs and a calibration."""

__all__ = [
    "CalibrationError",
    "DocumentError",
    "GeometryError",
    "GeometryFileError",
    "HomographyFileError",
    "NoEdgeError",
    "NoiseError",
    "NoiseFileError",
    "PsfFileError",
    "RegistrationError",
]


class CalibrationError(Exception):
    """The photographs or files do not allow the measurement that was asked for."""


class DocumentError(CalibrationError):
    """A file cannot be read or written, or does not hold what is needed of it.

    ``source`` names the file, ``key`` the value at fault in dotted form (``edges.0.snr``); it is
    None where the fault is not in a value.
    """

    def __init__(self, message: str, *, source: str | None = None, key: str | None = None) -> None:
        super().__init__(message)
        self.source = source
        self.key = key


class GeometryError(CalibrationError):
    """The captures do not tell the geometry of camera and stage."""


class GeometryFileError(CalibrationError):
    """A geometry.json cannot be read or written, or lacks a value that is needed."""


class HomographyFileError(CalibrationError):
    """An H.json cannot be read, or lacks a value that is needed."""


class NoEdgeError(CalibrationError):
    """No edge that may count was found."""


class NoiseError(CalibrationError):
    """Dark and flat captures do not tell a camera's noise."""


class NoiseFileError(DocumentError):
    """A noise.json cannot be read, or lacks a value that is needed."""


class PsfFileError(DocumentError):
    """A psf.json cannot be read or written, or lacks a value that is needed."""


class RegistrationError(CalibrationError):
    """Two images could not be aligned well enough to be compared."""
