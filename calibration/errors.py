"""What can go wrong between photographs and a calibration."""

__all__ = [
    "CalibrationError",
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


class NoiseFileError(CalibrationError):
    """A noise.json cannot be read, or lacks a value that is needed."""


class PsfFileError(CalibrationError):
    """A psf.json cannot be read or written, or lacks a value that is needed."""


class RegistrationError(CalibrationError):
    """Two images could not be aligned well enough to be compared."""
