"""Errors raised between photographs and a calibration."""

from typing import Literal

from acquisition.errors import KeepsFacts

GeometryReason = Literal[
    "no_captures", "several_sizes", "one_height", "not_matched", "heights_reversed", "nothing_left"
]
RegistrationReason = Literal[
    "no_detail",
    "no_board",
    "no_matches",
    "no_common_pose",
    "inside_out",
    "mirrored",
    "not_mirrored",
    "nearer",
    "little_overlap",
    "unlike",
    "not_settled",
    "no_lens",
    "low_correlation",
    "contradiction",
    "uncertain",
]


class CalibrationError(KeepsFacts, Exception):
    """The photographs or files do not allow the measurement that was asked for."""


class DocumentError(CalibrationError):
    """A file cannot be read or written, or lacks what is needed at ``key`` (``edges.0.snr``)."""

    def __init__(self, message: str, *, source: str | None = None, key: str | None = None) -> None:
        super().__init__(message)
        self.source = source
        self.key = key


class GeometryError(CalibrationError):
    """The captures do not determine the geometry of camera and stage, for a reason."""

    def __init__(
        self, message: str, *, reason: GeometryReason | None = None, subject: str | None = None
    ) -> None:
        super().__init__(message)
        self.reason = reason
        self.subject = subject


class GeometryFileError(DocumentError):
    """A geometry.json cannot be read or written, or lacks a value that is needed."""


class HomographyFileError(DocumentError):
    """An H.json cannot be read or written, or lacks a value that is needed."""


class DepthFileError(DocumentError):
    """A depth map or a list of planes cannot be read, or holds no depth."""


class NoEdgeError(CalibrationError):
    """No usable edge was found; ``flags`` are those for which edges were rejected."""

    def __init__(
        self,
        message: str,
        *,
        subject: str = "",
        found: int = 0,
        flags: frozenset[str] = frozenset(),
    ) -> None:
        super().__init__(message)
        self.subject = subject
        self.found = found
        self.flags = flags


NoiseReason = Literal["no_dark", "no_flat", "settings", "levels", "no_gain"]
"""What the captures lack: darks, flats, a common gain and format, levels, a rising variance."""


class NoiseError(CalibrationError):
    """Dark and flat captures, ``saturated`` ones left out, do not determine a camera's noise."""

    def __init__(self, message: str, *, reason: NoiseReason, saturated: int = 0) -> None:
        super().__init__(message)
        self.reason = reason
        self.saturated = saturated


class LensFileError(DocumentError):
    """A lens.json or its table cannot be written."""


class LimitsFileError(DocumentError):
    """A limits file cannot be read, has an unknown key, or sets no limit."""


class NoiseFileError(DocumentError):
    """A noise.json cannot be read, or lacks a value that is needed."""


PairReason = Literal[
    "no_pair", "saturated", "not_aligned", "little_overlap", "one_distance", "sharp"
]
"""``sharp``: the far photograph is no softer than the near one."""


class PairError(CalibrationError):
    """Photographs of a scene from two distances, named if known, do not determine the PSF."""

    def __init__(
        self, message: str, *, reason: PairReason, photographs: tuple[str, ...] = ()
    ) -> None:
        super().__init__(message)
        self.reason = reason
        self.photographs = photographs


class PsfFileError(DocumentError):
    """A psf.json cannot be read or written, or lacks a value that is needed."""


class RegistrationError(CalibrationError):
    """Two images could not be aligned well enough to be compared.

    ``reason`` says which requirement failed, ``at_fault`` which image if only one is to blame; the
    figure that failed is a ``count``, a ``correlation`` or an ``error_px``, the others None.
    """

    def __init__(
        self,
        message: str,
        *,
        reason: RegistrationReason | None = None,
        at_fault: Literal["reference", "followup"] | None = None,
        count: int | None = None,
        correlation: float | None = None,
        error_px: float | None = None,
    ) -> None:
        super().__init__(message)
        self.reason = reason
        self.at_fault = at_fault
        self.count = count
        self.correlation = correlation
        self.error_px = error_px
