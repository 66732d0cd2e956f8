"""The limits file: what sharpness a camera must have, as TOML that a person writes."""

from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal, Self

from pydantic import Field, ValidationError, model_validator

from acquisition.written_files import (
    WrittenTable,
    read_toml,
    validate_written,
    validation_lines,
)
from calibration.errors import LimitsFileError

Positive = Annotated[float, Field(gt=0)]
Share = Annotated[float, Field(gt=0, le=1)]
FrequencyUnit = Literal["cy/px", "LW/PH", "lp/mm"]


class Mtf50Limits(WrittenTable):
    """``[mtf50]``: least frequencies of half contrast."""

    min_cy_per_px: Positive | None = Field(None, description="every edge, in cycles per pixel")
    min_lw_per_ph: Positive | None = Field(
        None, description="every edge, in line widths per picture height"
    )
    min_lp_per_mm: Positive | None = Field(
        None, description="every edge, in line pairs per mm of the sensor"
    )
    centre_min_cy_per_px: Positive | None = Field(None, description="median of the central zone")
    centre_min_lw_per_ph: Positive | None = Field(None, description="likewise")
    centre_min_lp_per_mm: Positive | None = Field(None, description="likewise")
    corner_min_cy_per_px: Positive | None = Field(
        None, description="median of every corner, meridional and sagittal apart"
    )
    corner_min_lw_per_ph: Positive | None = Field(None, description="likewise")
    corner_min_lp_per_mm: Positive | None = Field(None, description="likewise")


class SigmaLimits(WrittenTable):
    """``[sigma]``: largest widths of the PSF across every edge."""

    max_px: Positive | None = Field(None, description="total, of lens and pixel")
    optical_max_px: Positive | None = Field(None, description="of the lens alone")


class LateralColourLimits(WrittenTable):
    """``[lateral_colour]``: largest shift of red or blue from green across every edge."""

    max_px: Positive | None = Field(None, description="either way")


class UniformityLimits(WrittenTable):
    """``[uniformity]``: least ratios between parts of the field."""

    corner_to_centre_min: Share | None = Field(
        None, description="MTF50 of the softest corner over that of the central zone"
    )
    corner_to_corner_min: Share | None = Field(
        None, description="MTF50 of the softest corner over that of the sharpest: tilt, decentring"
    )


class Zones(WrittenTable):
    """``[zones]``: what is the centre and what a corner, in half diagonals from the centre."""

    centre_radius: Share = Field(0.3, description="the central zone reaches so far")
    corner_radius: Share = Field(0.7, description="the corners begin here")

    @model_validator(mode="after")
    def _are_apart(self) -> Self:
        if not self.centre_radius <= self.corner_radius:
            raise ValueError(
                f"centre_radius {self.centre_radius:g} must not exceed corner_radius "
                f"{self.corner_radius:g}"
            )
        return self


class SharpnessLimits(WrittenTable):
    """A limits file: tables of limits, each of which may be left out."""

    mtf50: Mtf50Limits = Mtf50Limits.model_validate({})
    sigma: SigmaLimits = SigmaLimits.model_validate({})
    lateral_colour: LateralColourLimits = LateralColourLimits.model_validate({})
    uniformity: UniformityLimits = UniformityLimits.model_validate({})
    zones: Zones = Zones.model_validate({})

    def given(self) -> Iterator[tuple[str, float]]:
        """Every limit that is set: its dotted key and its bound, in the order of the tables."""
        for table in ("mtf50", "sigma", "lateral_colour", "uniformity"):
            for name, bound in getattr(self, table):
                if bound is not None:
                    yield f"{table}.{name}", bound


def read_limits(path: Path) -> SharpnessLimits:
    """Read a limits file.

    Raises
    ------
    LimitsFileError
        If it cannot be read, a key is unknown or its value not accepted, or no limit is set; the
        message names the file and the key.
    """
    source = str(path)
    try:
        limits = validate_written(SharpnessLimits, read_toml(path))
    except OSError as error:
        raise LimitsFileError(f"limits file {path}: {error.strerror}", source=source) from error
    except ValidationError as error:
        lines = validation_lines(error, SharpnessLimits)
        raise LimitsFileError(f"limits file {path}: {lines}", source=source) from error
    except ValueError as error:
        raise LimitsFileError(f"limits file {path}: {error}", source=source) from error
    if not any(limits.given()):
        raise LimitsFileError(
            f"limits file {path}: it sets no limit; set one, such as min_cy_per_px = 0.2 "
            "under [mtf50]",
            source=source,
        )
    return limits
