"""Measure every straight edge of one photograph: width, contrast by frequency, roughness."""

import math
from dataclasses import dataclass, field, replace
from pathlib import PurePath
from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from calibration.choices import Pattern
from calibration.edges.binned import BinnedEdge, bin_edge, without_shading
from calibration.edges.detection import find_edges
from calibration.edges.esfr import (
    EdgeSfr,
    esfr_half_width_px,
    gaussian_mtf50,
    measure_esfr,
    pixel_mtf50,
)
from calibration.edges.fit import SATURATED_FRACTION, EdgeFit, fit_edge
from calibration.edges.mosaic import in_sensor_pixels, sfr_in_sensor_pixels
from calibration.edges.orientation import Orientation, orientation_of
from calibration.edges.paper_method import lsf_fit
from calibration.edges.samples import EdgeSamples, edge_samples, roughness_px
from calibration.edges.segments import EdgeSegment, band_half_width
from calibration.noise import LevelNoise
from simulation.arrays import AnyArray, BoolArray, FloatArray

Method = Literal["all-angles", "paper"]

REJECTING_FLAGS = frozenset({"saturated", "too_short", "too_noisy"})
"""Flags that exclude an edge; the others are only remarks."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Region:
    """Part of an image that is used, in px: left, top, width and height."""

    x_px: int
    y_px: int
    width_px: int
    height_px: int

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

    ``clipped`` marks pixels that were clipped in the file, in any colour. The plane of one
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
    clipped: BoolArray | None = field(default=None, repr=False)
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


class EdgeMeasurement(BaseModel):
    """One measured edge; values that could not be determined are null.

    ``angle_deg`` in [0, 180) is the direction of the edge line against +x, y down. ``snr`` is
    None without any noise, ``chi2_reduced`` where the noise is known from this edge alone,
    ``optical_sigma_px`` where the edge is as sharp as the pixel square alone. MTF50 is the
    frequency of half contrast across the edge: of the fitted Gaussian with its pixel, or with
    the prefix ``esfr_`` without a model of the PSF; in line widths per height of the photograph and
    in line pairs per mm of the sensor it is null until ``with_sharpness`` adds it. The shifts are
    those of red and blue from green across the edge, positive away from the frame's centre, null
    without colours. ``contrast`` is Michelson's of the two
    levels, ``clipped_fraction`` of the pixels of the fit. ``esfr`` and ``binned`` are not kept in
    a file.
    """

    model_config = ConfigDict(frozen=True, extra="ignore", arbitrary_types_allowed=True)

    image: str
    capture: int | None
    height_mm: float | None
    x_px: float
    y_px: float
    angle_deg: float
    orientation: Orientation
    length_px: float
    snr: float | None
    sigma_px: float
    sigma_err_px: float
    optical_sigma_px: float | None
    optical_sigma_err_px: float | None
    mtf50_cy_per_px: float
    mtf50_err_cy_per_px: float | None = None
    mtf50_lw_per_ph: float | None = None
    mtf50_lp_per_mm: float | None = None
    esfr_mtf50_cy_per_px: float | None = None
    esfr_mtf50_err_cy_per_px: float | None = None
    esfr_mtf50_lw_per_ph: float | None = None
    esfr_mtf50_lp_per_mm: float | None = None
    esfr_mtf20_cy_per_px: float | None = None
    red_shift_px: float | None = None
    red_shift_err_px: float | None = None
    blue_shift_px: float | None = None
    blue_shift_err_px: float | None = None
    contrast: float | None = None
    roughness_px: float | None = None
    clipped_fraction: float | None = None
    chi2_reduced: float | None
    flags: tuple[str, ...]
    esfr: EdgeSfr | None = Field(default=None, exclude=True, repr=False)
    binned: BinnedEdge | None = Field(default=None, exclude=True, repr=False)

    @property
    def is_used(self) -> bool:
        """Whether the edge counts in the PSF."""
        return not REJECTING_FLAGS & set(self.flags)

    @property
    def normal_rad(self) -> float:
        """Angle of the edge normal, in radians modulo pi."""
        return float(np.deg2rad(self.angle_deg + 90.0))

    def __repr__(self) -> str:
        flags = "".join(f", {flag}" for flag in self.flags)
        return (
            f"EdgeMeasurement({PurePath(self.image).name} at ({self.x_px:.0f}, {self.y_px:.0f}), "
            f"{self.angle_deg:.1f} deg: sigma {self.sigma_px:.4f} ± {self.sigma_err_px:.4f} px"
            f"{flags})"
        )

    def __str__(self) -> str:
        return repr(self)


def measure_edges(
    source: EdgeImage, region: Region | None = None, method: Method = "all-angles"
) -> list[EdgeMeasurement]:
    """Find and fit every straight edge of one photograph.

    Parameters
    ----------
    source
        The photograph.
    region
        Only pixels inside it are used; positions are given in the whole image.
    method
        With ``paper``, the widths are those of Gaussians fitted to binned line spread functions.

    Raises
    ------
    ValueError
        If the region is not within the image.
    """
    image, clipped = source.image_dn, source.clipped
    left = top = 0
    if region is not None:
        source.refuse_beyond_frame(region)
        right, bottom = region.x_px + region.width_px, region.y_px + region.height_px
        left, top = region.x_px // source.pitch_px, region.y_px // source.pitch_px
        inside = np.s_[top : bottom // source.pitch_px, left : right // source.pitch_px]
        image = image[inside]
        clipped = None if clipped is None else clipped[inside]
    measurements = []
    for segment in find_edges(image):
        found = fit_edge(image, segment, noise=source.noise, saturation_dn=source.saturation_dn)
        fit = None if found is None else _determined(found)
        if fit is None:
            continue
        band = band_half_width(fit.sigma_px)
        samples = edge_samples(image, segment, fit, band)
        widened = lsf_fit(samples, fit) if method == "paper" else fit
        if widened is None:
            continue
        fraction = fit.clipped_fraction
        if clipped is not None:
            fraction = float(np.mean(_picked(clipped, segment, fit, band)))
        wide = edge_samples(image, segment, fit, esfr_half_width_px(fit.sigma_px))
        binned = None
        if method != "paper":
            on_sensor = in_sensor_pixels(fit, source.pitch_px) if source.pitch_px > 1 else fit
            even = without_shading(wide, image, segment, fit)
            binned = bin_edge(even, on_sensor, source.pitch_px)
        measured = _measurement(
            source,
            widened.moved(left, top),
            measure_esfr(wide, fit.sigma_px),
            roughness_px(samples, fit.sigma_px),
            fraction,
        )
        measurements.append(measured.model_copy(update={"binned": binned}))
    return measurements


def _determined(fit: EdgeFit) -> EdgeFit | None:
    """Drop an optical width whose error exceeds it; None if the total width's error does."""
    if not fit.sigma_err_px < fit.sigma_px:  # also where the error is not a number
        return None
    optical, err = fit.optical_sigma_px, fit.optical_sigma_err_px
    if optical is None or err is None or err < optical:
        return fit
    return replace(fit, optical_sigma_px=None, optical_sigma_err_px=None)


def _picked(
    clipped: BoolArray, segment: EdgeSegment, fit: EdgeFit, half_width_px: float
) -> FloatArray:
    samples: EdgeSamples = edge_samples(clipped.astype(np.float64), segment, fit, half_width_px)
    return samples.levels_dn


def _measurement(
    source: EdgeImage,
    fit: EdgeFit,
    esfr: EdgeSfr | None,
    rough_px: float | None,
    clipped_fraction: float | None,
) -> EdgeMeasurement:
    """The edge in sensor pixels, converted from those of a colour plane."""
    if source.pitch_px > 1:
        fit = in_sensor_pixels(fit, source.pitch_px).moved(source.first_x_px, source.first_y_px)
        esfr = None if esfr is None else sfr_in_sensor_pixels(esfr, source.pitch_px)
        rough_px = None if rough_px is None else rough_px * source.pitch_px
    return EdgeMeasurement(
        image=source.name,
        capture=source.capture,
        height_mm=source.height_mm,
        x_px=fit.x_px,
        y_px=fit.y_px,
        angle_deg=fit.angle_deg,
        orientation=orientation_of(fit.angle_deg),
        length_px=fit.length_px,
        snr=fit.snr if math.isfinite(fit.snr) else None,
        sigma_px=fit.sigma_px,
        sigma_err_px=fit.sigma_err_px,
        optical_sigma_px=fit.optical_sigma_px,
        optical_sigma_err_px=fit.optical_sigma_err_px,
        mtf50_cy_per_px=_gaussian_mtf50(fit),
        esfr_mtf50_cy_per_px=None if esfr is None else esfr.mtf50_cy_per_px,
        esfr_mtf50_err_cy_per_px=None if esfr is None else esfr.mtf50_err_cy_per_px,
        esfr_mtf20_cy_per_px=None if esfr is None else esfr.mtf20_cy_per_px,
        contrast=_contrast(fit),
        roughness_px=rough_px,
        clipped_fraction=clipped_fraction,
        chi2_reduced=fit.chi2_reduced,
        flags=_flags(source, fit, clipped_fraction),
        esfr=esfr,
    )


def _gaussian_mtf50(fit: EdgeFit) -> float:
    """Frequency of half contrast across the edge, of the fitted Gaussian with its pixel."""
    if fit.optical_sigma_px is None:
        return gaussian_mtf50(fit.sigma_px)
    return pixel_mtf50(fit.optical_sigma_px, fit.normal_rad)


def _contrast(fit: EdgeFit) -> float | None:
    """Michelson contrast of the edge's two levels; None if their sum is not positive."""
    total = fit.high_dn + fit.low_dn
    return abs(fit.high_dn - fit.low_dn) / total if total > 0 else None


def _flags(source: EdgeImage, fit: EdgeFit, fraction: float | None) -> tuple[str, ...]:
    flags = fit.flags
    if fraction is not None and fraction > SATURATED_FRACTION and "saturated" not in flags:
        flags = ("saturated", *flags)
    return (*flags, "jpeg") if source.is_jpeg else flags
