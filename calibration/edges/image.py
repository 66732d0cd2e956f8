"""A photograph with edges: its plane linear in light, what is known of it, and parts of it."""

from dataclasses import dataclass, field, replace

from calibration.choices import Pattern
from calibration.edge_fit import JpegCompression
from calibration.edge_search import EdgeSegment
from calibration.noise import LevelNoise
from simulation.arguments import check_fields
from simulation.arrays import AnyArray, BoolArray, FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class Region:
    """Part of an image that is used, in px: left, top, width and height."""

    x_px: int
    y_px: int
    width_px: int
    height_px: int

    def __post_init__(self) -> None:
        check_fields(self)

    @classmethod
    def centre(cls, rows: int, cols: int) -> "Region":
        """Return the central half along both axes, for which the paper's PSF holds."""
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

    ``compression`` tells how a JPEG was made, if that is known and the plane is its luma.
    ``clipped`` marks pixels that were clipped in the file, in any colour, ``masked`` those that
    are no measurement. The plane of one
    colour of a mosaic has ``pitch_px`` 2: its pixels stand that far apart on the sensor, the
    first one at ``first_x_px``, ``first_y_px``. ``colours_dn`` are the linear levels of a colour
    photograph, shape ``(rows, cols, 3)``; ``pattern`` is that of a raw mosaic.
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
        """Check that a region is within the frame.

        Raises
        ------
        ValueError
            If it is not.
        """
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
