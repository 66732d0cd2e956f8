"""A photograph with edges: its plane linear in light, its regions, the planes of a raw mosaic.

The colour planes of a raw mosaic, and edges measured on them in pixels of the sensor. A plane of
one colour samples the sensor at every second pixel either way, but each of its samples is still one
sensor pixel wide: half the plane's pitch. The fit's own pixel square would be twice too wide there,
so the optical width is worked out from the total one instead, which no pixel model has touched.
"""

from dataclasses import dataclass, field, replace
from functools import lru_cache
from math import sqrt
from typing import TYPE_CHECKING, Literal

import numpy as np

from calibration.choices import PATTERNS, Pattern
from calibration.edges._fit import SHARPEST_PX, EdgeFit, JpegCompression
from calibration.edges._model import edge_profile
from calibration.edges._segments import EdgeSegment
from calibration.noise import LevelNoise
from simulation.arguments import check_fields
from simulation.arrays import AnyArray, BoolArray, FloatArray

if TYPE_CHECKING:
    from scipy.interpolate import PchipInterpolator


@dataclass(frozen=True, slots=True, kw_only=True)
class Region:
    """The part of an image to use: left, top, width and height, in px."""

    x_px: int
    y_px: int
    width_px: int
    height_px: int

    def __post_init__(self) -> None:
        check_fields(self)

    @classmethod
    def centre(cls, rows: int, cols: int) -> "Region":
        """Return the central half along both axes, the part that the paper calibrates."""
        return cls(
            x_px=cols // 4,
            y_px=rows // 4,
            width_px=cols - 2 * (cols // 4),
            height_px=rows - 2 * (rows // 4),
        )

    def __str__(self) -> str:
        return f"{self.x_px},{self.y_px},{self.width_px},{self.height_px}"


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeImage:
    """One photograph with edges: a plane linear in light, and what is known about it.

    ``clipped`` marks pixels that were clipped in the file, in any colour, ``masked`` those that are
    no measurement. The plane of one colour of a mosaic has ``pitch_px`` 2: its pixels stand that
    far apart on the sensor, from ``first_x_px``, ``first_y_px`` on. ``colours_dn`` has the shape
    ``(rows, cols, 3)``; ``pattern`` is that of a raw mosaic.
    """

    name: str
    image_dn: FloatArray = field(repr=False)
    capture: int | None = None
    height_mm: float | None = None
    noise: LevelNoise | None = None
    saturation_dn: float | None = None
    is_jpeg: bool = False
    compression: JpegCompression | None = None
    clipped: BoolArray | None = field(default=None, repr=False)
    masked: BoolArray | None = field(default=None, repr=False)
    pitch_px: int = 1
    first_x_px: int = 0
    first_y_px: int = 0
    sensor_shape: tuple[int, int] | None = None
    pixel_pitch_um: float | None = None
    colours_dn: AnyArray | None = field(default=None, repr=False)
    pattern: Pattern | None = None

    @property
    def frame(self) -> tuple[int, int]:
        """Rows and columns of the whole sensor."""
        rows, cols = self.image_dn.shape
        return self.sensor_shape or (rows, cols)

    def refuse_beyond_frame(self, region: Region) -> None:
        """Check that a region is within the frame."""
        rows, cols = self.frame
        right, bottom = region.x_px + region.width_px, region.y_px + region.height_px
        if not (0 <= region.x_px < right <= cols and 0 <= region.y_px < bottom <= rows):
            raise ValueError(f"region {region} is not within {self.name} ({cols}x{rows})")

    def within(self, region: Region) -> "EdgeImage":
        """Return the part of the photograph that lies in a region; positions count from there."""
        pitch = self.pitch_px
        rows = slice(region.y_px // pitch, (region.y_px + region.height_px) // pitch)
        cols = slice(region.x_px // pitch, (region.x_px + region.width_px) // pitch)
        clipped, masked = (
            None if mask is None else mask[rows, cols] for mask in (self.clipped, self.masked)
        )
        compression = self.compression
        if compression is not None:
            compression = compression.cropped(rows.start, cols.start)
        return replace(
            self,
            image_dn=self.image_dn[rows, cols],
            clipped=clipped,
            masked=masked,
            compression=compression,
            colours_dn=None if self.colours_dn is None else self.colours_dn[rows, cols],
        )

    def compression_at(self, segment: EdgeSegment) -> JpegCompression | None:
        """How an edge was compressed; None where that is not known."""
        if self.compression is None or self.colours_dn is None:
            return self.compression
        return self.compression.along(self.image_dn, self.colours_dn, segment.line)


PITCH_PX = 2
_BAND_SIGMAS = 6.0
_BAND_EXTRA_PX = 6.0  # what the edge fit takes on either side: 3 px of the plane
_STEPS = 801
_WIDEST_PX = 4.0  # beyond, the difference of the variances no longer changes
_TABLE_STEPS = 36
_ANGLE_STEP_DEG = 3.0  # over which the correction changes by less than 1e-3 of itself


@dataclass(frozen=True, slots=True, kw_only=True)
class PlanePlace:
    """Where one colour of a mosaic begins: column and row of its first pixel."""

    colour: Literal["red", "green", "blue"]
    first_x_px: int
    first_y_px: int

    def plane(self, mosaic: AnyArray) -> FloatArray:
        """The pixels of this colour, shape about half of ``mosaic``'s along both axes."""
        return np.ascontiguousarray(
            mosaic[self.first_y_px :: PITCH_PX, self.first_x_px :: PITCH_PX], dtype=np.float64
        )


def plane_places(pattern: Pattern) -> tuple[PlanePlace, ...]:
    """Return the four planes of a pattern, row by row; green has two."""
    if pattern not in PATTERNS:
        raise ValueError(f"the Bayer pattern must be one of {', '.join(PATTERNS)}, got {pattern}")
    names: dict[str, Literal["red", "green", "blue"]] = {"R": "red", "G": "green", "B": "blue"}
    return tuple(
        PlanePlace(colour=names[letter], first_x_px=k % 2, first_y_px=k // 2)
        for k, letter in enumerate(pattern)
    )


def in_sensor_pixels(fit: EdgeFit, pitch_px: int) -> EdgeFit:
    """Convert a fit on a colour plane to sensor pixels; positions count from its first pixel.

    The optical width is the one that has this total width over the square of a sensor pixel.
    """
    sigma, err = fit.sigma_px * pitch_px, fit.sigma_err_px * pitch_px
    optical = _optical_of_total(sigma, fit.normal_rad)
    optical_err = None
    if optical is not None:
        step = 1e-3 * sigma
        above = _optical_of_total(sigma + step, fit.normal_rad)
        optical_err = err * ((above or optical) - optical) / step
    return replace(
        fit,
        x_px=fit.x_px * pitch_px,
        y_px=fit.y_px * pitch_px,
        length_px=fit.length_px * pitch_px,
        sigma_px=sigma,
        sigma_err_px=err,
        optical_sigma_px=optical,
        optical_sigma_err_px=optical_err,
        curvature_per_px=fit.curvature_per_px / pitch_px,
    )


def _optical_of_total(sigma_px: float, normal_rad: float) -> float | None:
    """Optical width behind a unit pixel of a total width; None where it is the pixel's alone."""
    # The square is the same every 90 degrees and mirrored at 45.
    turn = abs((np.rad2deg(normal_rad) + 45.0) % 90.0 - 45.0)
    below = _ANGLE_STEP_DEG * (turn // _ANGLE_STEP_DEG)
    share = (turn - below) / _ANGLE_STEP_DEG
    offsets = [_offset_px2(sigma_px, below + k * _ANGLE_STEP_DEG) for k in (0, 1)]
    if offsets[0] is None or offsets[1] is None:
        return None
    variance = sigma_px**2 - ((1 - share) * offsets[0] + share * offsets[1])
    return sqrt(variance) if variance > SHARPEST_PX**2 else None


def _offset_px2(sigma_px: float, turn_deg: float) -> float | None:
    """Total less optical variance: about 1/12, more exactly by matching the two profiles."""
    table = _offsets(turn_deg)
    if sigma_px < table.x[0]:
        return None
    return float(table(min(sigma_px, float(table.x[-1]))))


@lru_cache(maxsize=32)
def _offsets(turn_deg: float) -> "PchipInterpolator":
    """Total less optical variance by total width, for one direction of the edge."""
    from scipy.interpolate import PchipInterpolator  # .2 s, where there is a mosaic

    optical = np.geomspace(SHARPEST_PX, _WIDEST_PX, _TABLE_STEPS)
    total = np.array([_total_of_optical(o, np.deg2rad(turn_deg)) for o in optical.tolist()])
    return PchipInterpolator(total, total**2 - optical**2)


def _total_of_optical(optical_px: float, normal_rad: float) -> float:
    """Width of the plain Gaussian edge nearest to a Gaussian edge behind a pixel square."""
    from scipy.optimize import minimize_scalar

    start = sqrt(optical_px**2 + 1 / 12)
    reach = _BAND_SIGMAS * start + _BAND_EXTRA_PX
    distance = np.linspace(-reach, reach, _STEPS)
    truth = edge_profile(distance, optical_px, normal_rad)

    def misfit(sigma_px: float) -> float:
        return float(np.sum((truth - edge_profile(distance, sigma_px)) ** 2))

    found = minimize_scalar(
        misfit, bounds=(0.7 * start, 1.3 * start), method="bounded", options={"xatol": 1e-9}
    )
    return float(found.x)
