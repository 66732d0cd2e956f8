"""What is known of the geometry of camera and stage: values, errors, and what is not determined."""

from dataclasses import dataclass
from math import hypot, sqrt
from typing import Literal

from calibration.geometry.board import DEFAULT_BOARD, CharucoBoard
from calibration.geometry.pupil import PupilFit

__all__ = [
    "CaptureGeometry",
    "GeometryCalibration",
    "GeometryOptions",
    "Measured",
    "ScaleSource",
    "length_of",
]

ScaleSource = Literal["board", "given", "bench"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Measured:
    """A value and its standard error."""

    value: float
    err: float


@dataclass(frozen=True, slots=True, kw_only=True)
class GeometryOptions:
    """What is known beforehand.

    Parameters
    ----------
    nominal_focal_px
        Focal length by the bench file, over the pixel pitch.
    scale_px_per_mm
        Scale at the lowest height, if somebody measured it.
    board
        The ChArUco board, where captures of kind board show one.
    """

    nominal_focal_px: float | None = None
    scale_px_per_mm: float | None = None
    board: CharucoBoard = DEFAULT_BOARD


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureGeometry:
    """One capture that was used.

    ``height_residual_mm`` is the height read back less the one its image fits; ``sideways_mm``
    how far the camera stood beside the straight line of travel, x and y on the target.
    """

    name: str
    index: int | None
    kind: str
    target: str
    orientation_deg: float
    height_mm: float
    scale_px_per_mm: Measured | None
    height_residual_mm: float
    sideways_mm: tuple[float, float]
    match_count: int
    rms_px: float


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class GeometryCalibration:
    """The geometry of camera and stage; None for what the captures do not determine.

    Parameters
    ----------
    pupil
        Pupil offset, its error and the scatter of the heights.
    heights_mm
        Distinct heights, ascending.
    scales
        Scale in px/mm at each of them, None without any length.
    scale_source
        What the scale rests on.
    focal_length_px
        Measured with a board or a given scale, else as the bench file has it and without error.
    k1, k2
        Radial distortion, relative at the image corner.
    principal_px
        Offset of the principal point from the middle of the image, x and y.
    tilt_x_deg, tilt_y_deg, tilt_deg
        Inclination of the optical axis against the normal of the target.
    axis_drift
        Drift in px/mm at the lowest height, x and y; ``axis_drift_px_per_mm`` is its length.
    pierce_px
        Where the stage's travel pierces the image.
    captures, excluded
        What was used, and of what was not: name and reason.
    undetermined
        Name of a value that is None: why.
    notes
        What was odd.
    """

    width_px: int
    height_px: int
    pupil: PupilFit
    heights_mm: tuple[float, ...]
    scales: tuple[Measured, ...] | None
    scale_source: ScaleSource | None
    focal_length_px: Measured | None
    k1: Measured | None
    k2: Measured | None
    principal_px: tuple[Measured, Measured] | None
    tilt_x_deg: Measured | None
    tilt_y_deg: Measured | None
    tilt_deg: Measured | None
    axis_drift: tuple[Measured, Measured]
    pierce_px: tuple[float, float]
    captures: tuple[CaptureGeometry, ...]
    excluded: tuple[tuple[str, str], ...]
    undetermined: dict[str, str]
    notes: tuple[str, ...]

    @property
    def axis_drift_px_per_mm(self) -> Measured:
        """Length of the drift."""
        return length_of(*self.axis_drift)

    @property
    def corner_radius_px(self) -> float:
        """Distance of the corner pixels from the middle of the image."""
        return hypot(self.width_px - 1, self.height_px - 1) / 2


def length_of(x: Measured, y: Measured) -> Measured:
    """Length of a vector of two values with independent errors."""
    length = hypot(x.value, y.value)
    if length == 0:
        return Measured(value=0.0, err=hypot(x.err, y.err) / sqrt(2))
    return Measured(value=length, err=hypot(x.value * x.err, y.value * y.err) / length)
