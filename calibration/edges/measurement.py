"""Measure every straight edge of one photograph: width, contrast by frequency, roughness.

The paper's method of measuring a PSF from edges, kept for comparison. Pixels are projected on the
edge normal into bins of a quarter pixel, the binned edge is differentiated, and a Gaussian is
fitted to that line spread function; sigma_x and sigma_y are the medians over vertical and
horizontal edges, diagonal ones are not used.

The bin and the difference over two bins blur: they add ``h^2 / 12 + (2 h)^2 / 12`` to the variance,
with h = 1/4 px: +5.1 % at sigma 0.5 px, +1.3 % at 1 px.
"""

import math
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from math import sqrt
from pathlib import PurePath
from typing import Literal, NamedTuple, Self

import numpy as np
from pydantic import Field, model_validator

from acquisition.files import StoredModel
from calibration.choices import TargetChoice
from calibration.edges._compressed import mtf50_error_behind
from calibration.edges._detection import beside_target, find_edges, star_spokes
from calibration.edges._esfr import (
    WIDEST_GAP_PX,
    EdgeSfr,
    esfr_half_width_px,
    gap_message,
    gaussian_mtf50,
    is_aliased,
    measure_esfr,
    pixel_mtf50,
    widest_gap_px,
)
from calibration.edges._fit import CLIPPED_FRACTION, EdgeFit, JpegCompression, fit_edge
from calibration.edges._image import EdgeImage, Region, in_sensor_pixels
from calibration.edges._samples import (
    BinnedEdge,
    EdgeSamples,
    bin_edge,
    border_flags,
    edge_samples,
    roughness_px,
    share_within,
    without_shading,
)
from calibration.edges._segments import EdgeSegment, Orientation, band_half_width, orientation_of
from calibration.robust import median_err
from simulation.arrays import FloatArray
from simulation.by_value import ByValue
from simulation.notebook import Shown

_ENOUGH_FOR_NOISE = 64  # edges: their mean square error is that of all within some per cent

TRANSFER_FREQ_CY_PER_PX = np.linspace(0.0, 1.0, 51)
"""Frequencies at which the transfer is stored; beyond Nyquist for the aliased part."""


class AxisTransfer(StoredModel):
    """Contrast by frequency along one axis, lens and pixel together, from ``edges`` edges.

    ``mtf_err`` are standard errors at each frequency; None in older files.
    """

    freq_cy_per_px: tuple[float, ...] = Field(repr=False)
    mtf: tuple[float, ...] = Field(repr=False)
    edges: int | None = None
    mtf_err: tuple[float, ...] | None = Field(default=None, repr=False)

    @model_validator(mode="after")
    def _check(self) -> Self:
        count = len(self.freq_cy_per_px)
        for name, values in (("mtf", self.mtf), ("mtf_err", self.mtf_err)):
            if values is not None and len(values) != count:
                raise ValueError(f"{name} must have {count} numbers, as freq_cy_per_px")
        return self


class MeasuredTransfer(StoredModel):
    """Transfer along x (from vertical edges) and y (horizontal ones); None without edges."""

    x: AxisTransfer | None = None
    y: AxisTransfer | None = None


def mean_transfer(edges: Sequence[EdgeSfr]) -> AxisTransfer | None:
    """Return the median over edges at each frequency; None where there is no edge.

    The part in phase with the edge is taken, in which noise cancels; a modulus would pile it up.
    """
    if not edges:
        return None
    curves = np.array([edge.transform(TRANSFER_FREQ_CY_PER_PX).real for edge in edges])
    mtf = np.maximum(np.median(curves, axis=0), 0.0)
    some = edges[:: max(len(edges) // _ENOUGH_FOR_NOISE, 1)]
    errs = np.array([edge.transform_err(TRANSFER_FREQ_CY_PER_PX) for edge in some])
    return AxisTransfer(
        freq_cy_per_px=tuple(round(freq, 6) for freq in TRANSFER_FREQ_CY_PER_PX.tolist()),
        mtf=tuple(mtf.tolist()),
        edges=len(edges),
        mtf_err=tuple(median_err(curves, errs).tolist()),
    )


BIN_PX = 0.25
_FEWEST_BINS = 8


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _LineSpread:
    """Line spread function in bins of ``BIN_PX``; shape ``(n,)`` each."""

    place_px: FloatArray = field(repr=False)
    value_per_px: FloatArray = field(repr=False)


def _line_spread(samples: EdgeSamples) -> _LineSpread:
    """Differentiate the edge after averaging its pixels in bins of a quarter pixel.

    Bins without a pixel are interpolated; the difference spans two bins.
    """
    bins = np.round(samples.distance_px / BIN_PX).astype(np.int64)
    first = int(bins.min())
    count = np.bincount(bins - first)
    position = np.asarray((first + np.arange(count.size)) * BIN_PX, dtype=np.float64)
    used = count > 0
    level = np.bincount(bins - first, samples.unit_levels)[used] / count[used]
    filled = np.interp(position, position[used], level)
    return _LineSpread(place_px=position, value_per_px=np.gradient(filled, BIN_PX))


def _lsf_fit(samples: EdgeSamples, fit: EdgeFit) -> EdgeFit | None:
    """Return the edge with the width of a Gaussian fitted to its line spread function, or None."""
    from scipy.optimize import OptimizeWarning, curve_fit  # .1 s, which no other method needs

    spread = _line_spread(samples)
    if spread.place_px.size < _FEWEST_BINS:
        return None
    start = (1.0, 0.0, max(fit.sigma_px, BIN_PX))
    try:
        with warnings.catch_warnings():
            # Where the pixels do not determine a width, scipy warns and gives an infinite variance.
            warnings.simplefilter("ignore", OptimizeWarning)
            values, covariance = curve_fit(
                _gaussian, spread.place_px, spread.value_per_px, p0=start, maxfev=400
            )
    except RuntimeError:  # scipy: no convergence
        return None
    sigma, variance = abs(float(values[2])), float(covariance[2, 2])
    if not (sigma > 0 and np.isfinite(variance)):
        return None
    return replace(
        fit,
        sigma_px=sigma,
        sigma_err_px=sqrt(variance),
        optical_sigma_px=None,
        optical_sigma_err_px=None,
        chi2_reduced=None,
    )


def _gaussian(place_px: FloatArray, area: float, centre_px: float, sigma_px: float) -> FloatArray:
    reach = (place_px - centre_px) / sigma_px
    return np.asarray(area / (abs(sigma_px) * sqrt(2 * np.pi)) * np.exp(-0.5 * reach**2))


Method = Literal["all-angles", "paper"]

REJECTING_FLAGS = frozenset(
    {
        "saturated",
        "masked",
        "too_short",
        "too_noisy",
        "uneven",
        "curved",
        "beside_target",
        "star_spoke",
    }
)
"""Flags that exclude an edge; the others are only remarks."""

_CLIPPED_FLAGS = {"clipped", "saturated"}  # the fit itself judges how far the levels are seen
_MASKED_MOST = 0.02  # of the pixels: what stands for them moves sigma by less than its error
_UNSEEN_MOST = 0.05  # of the contrast: in the narrowest band, 2 sigma + 1 px, 2.3 % are not seen
_SIGMA_STEP = 1e-4  # relative
# Relative change of MTF50 by a slope of this share of the contrast: contrast is told from a band
# twice as wide as the one that the width is fitted in.
_MTF50_BY_SLOPE = 2.5
_DIFFERS_SIGMAS, _DIFFERS_LEAST = 3.0, 0.02  # of MTF50


class EdgeMeasurement(Shown, ByValue, StoredModel, arbitrary_types_allowed=True):
    """One measured edge; values that could not be determined are None, null in a file.

    Parameters
    ----------
    image, capture, height_mm
        The photograph, and the index and height of its capture in a session.
    x_px, y_px, length_px
        Position and length of the edge.
    angle_deg
        Direction of the edge line relative to +x, y down, in [0, 180).
    snr
        Signal-to-noise ratio of the edge; None if there is no noise.
    sigma_px, sigma_err_px
        Total width across the edge, with its standard error.
    optical_sigma_px, optical_sigma_err_px
        Width of the lens alone; None if the edge is as sharp as the pixel square alone.
    mtf50_cy_per_px, mtf50_err_cy_per_px
        Frequency of half contrast across the edge, of the fitted Gaussian with its pixel.
    esfr_mtf50_cy_per_px, esfr_mtf50_err_cy_per_px, esfr_mtf20_cy_per_px
        Frequency of half (a fifth) of the contrast, as measured from the edge, whatever the shape
        of the PSF. The flag ``esfr_differs`` says that the two MTF50 contradict each other.
    mtf50_lw_per_ph, mtf50_lp_per_mm, esfr_mtf50_lw_per_ph, esfr_mtf50_lp_per_mm
        The same in line widths per picture height and in line pairs per mm on the sensor; None
        until ``with_sharpness`` adds them.
    esfr_missing
        Why the measured values are None.
    red_shift_px, red_shift_err_px, blue_shift_px, blue_shift_err_px
        Shift of red and of blue from green across the edge, positive away from the centre of the
        frame; None without colours.
    contrast
        Michelson contrast of the two levels.
    roughness_px
        Roughness of the edge line.
    clipped_fraction
        Share of the pixels of the fit that are clipped.
    chi2_reduced
        Reduced chi-squared of the fit; None if the noise is known from this edge alone.
    flags
        Remarks on the edge; some exclude it from the PSF.
    levels_dn, esfr, binned
        Dark and bright level, SFR and binned profile; not stored in a file.
    """

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
    esfr_missing: str | None = None
    red_shift_px: float | None = None
    red_shift_err_px: float | None = None
    blue_shift_px: float | None = None
    blue_shift_err_px: float | None = None
    contrast: float | None = None
    roughness_px: float | None = None
    clipped_fraction: float | None = None
    chi2_reduced: float | None
    flags: tuple[str, ...]
    levels_dn: tuple[float, float] | None = Field(default=None, exclude=True, repr=False)
    esfr: EdgeSfr | None = Field(default=None, exclude=True, repr=False)
    binned: BinnedEdge | None = Field(default=None, exclude=True, repr=False)

    @property
    def is_used(self) -> bool:
        """Whether the edge is used for the PSF: it has no flag that excludes it."""
        return not REJECTING_FLAGS & set(self.flags)

    @property
    def normal_rad(self) -> float:
        """Angle of the edge normal, in radians modulo pi."""
        return float(np.deg2rad(self.angle_deg + 90.0))

    def moved(self, right_px: float, down_px: float) -> "EdgeMeasurement":
        """Return the edge in an image whose origin is so many px further left and up."""
        if right_px == 0 and down_px == 0:
            return self
        place = {"x_px": self.x_px + right_px, "y_px": self.y_px + down_px}
        return self.model_copy(update=place)

    def __repr__(self) -> str:
        flags = "".join(f", {flag}" for flag in self.flags)
        return (
            f"EdgeMeasurement({PurePath(self.image).name} at ({self.x_px:.0f}, {self.y_px:.0f}), "
            f"{self.angle_deg:.1f} deg: sigma {self.sigma_px:.4f} ± {self.sigma_err_px:.4f} px"
            f"{flags})"
        )

    def __str__(self) -> str:
        return repr(self)


def edges_of_image(
    source: EdgeImage, region: Region | None = None, method: Method = "all-angles"
) -> list[EdgeMeasurement]:
    """Find and fit every straight edge of one photograph, inside a region of it if asked.

    With ``paper``, the widths are those of Gaussians fitted to binned line spread functions.
    """
    left = top = 0
    if region is not None:
        source.refuse_beyond_frame(region)
        left, top = region.x_px // source.pitch_px, region.y_px // source.pitch_px
        source = source.within(region)
    # One type of image: each is compiled for itself. Rounding is 1e-7 of the levels.
    source = replace(source, image_dn=np.ascontiguousarray(source.image_dn, dtype=np.float32))
    artefacts = None if source.compression is None else source.compression.artefacts
    segments = find_edges(source.image_dn, artefacts=artefacts)
    found = (_measured_edge(source, each, method) for each in segments)
    shift_px = source.pitch_px * left, source.pitch_px * top
    return [edge.moved(*shift_px) for edge in found if edge is not None]


def _measured_edge(
    source: EdgeImage, segment: EdgeSegment, method: Method
) -> EdgeMeasurement | None:
    """Measure one edge of the pixels that are used; None where nothing fits."""
    image = source.image_dn
    compression = source.compression_at(segment)
    found = fit_edge(
        image,
        segment,
        noise=source.noise,
        saturation_dn=source.saturation_dn,
        compression=compression,
    )
    fit = None if found is None else _determined(found)
    if fit is None:
        return None
    near_px = band_half_width(fit.sigma_px)
    samples = edge_samples(image, segment, fit, esfr_half_width_px(fit.sigma_px))
    is_clipped = bool(_CLIPPED_FLAGS & set(fit.flags))
    if source.clipped is not None:
        share = share_within(source.clipped, segment, fit, near_px)
        fit = replace(fit, clipped_fraction=share)
        is_clipped |= share > CLIPPED_FRACTION
    if source.masked is not None:
        share = share_within(source.masked, segment, fit, near_px)
        fit = replace(fit, flags=(*(["masked"] if share > _MASKED_MOST else []), *fit.flags))
    is_seen = is_clipped or _is_seen(fit, samples)
    if not (is_seen or _is_at_border(fit, image.shape, near_px)):
        return None
    binned, contrast = None, _Contrast(missing="pixels beside the edge are clipped")
    if not is_clipped:
        on_sensor = in_sensor_pixels(fit, source.pitch_px) if source.pitch_px > 1 else fit
        even = without_shading(samples, image, segment, fit)
        border = border_flags(even, fit, is_jpeg=source.is_jpeg)
        fit = replace(fit, flags=(*fit.flags, *border))
        binned = bin_edge(even, on_sensor, source.pitch_px)
        contrast = _Contrast.of(binned, _gaussian_mtf50(on_sensor))
        contrast = contrast.widened(segment, fit, compression)
    rough_px = roughness_px(samples, fit.sigma_px)
    if method == "paper":
        widened = _lsf_fit(edge_samples(image, segment, fit, near_px), fit)
        if widened is None:
            return None
        fit, binned = widened, None
    if source.pitch_px > 1:
        fit = in_sensor_pixels(fit, source.pitch_px).moved(source.first_x_px, source.first_y_px)
        rough_px = None if rough_px is None else rough_px * source.pitch_px
    return _measurement(source, fit, contrast, rough_px, binned)


def _determined(fit: EdgeFit) -> EdgeFit | None:
    """Drop an optical width whose error exceeds it; None if the total width's error does."""
    if not fit.sigma_err_px < fit.sigma_px:  # also where the error is not a number
        return None
    optical, err = fit.optical_sigma_px, fit.optical_sigma_err_px
    if optical is None or err is None or err < optical:
        return fit
    return replace(fit, optical_sigma_px=None, optical_sigma_err_px=None)


def _is_seen(fit: EdgeFit, samples: EdgeSamples) -> bool:
    """Whether there are pixels of both levels of the edge: a slope alone has none."""
    margin_dn = _UNSEEN_MOST * abs(fit.high_dn - fit.low_dn)
    darkest, brightest = samples.levels_dn.min(), samples.levels_dn.max()
    low_dn, high_dn = sorted((fit.low_dn, fit.high_dn))
    return bool(low_dn >= darkest - margin_dn and high_dn <= brightest + margin_dn)


def _is_at_border(fit: EdgeFit, shape: tuple[int, ...], half_width_px: float) -> bool:
    """Whether the frame cuts the band along the edge: a level may lie outside."""
    rows, cols = shape
    return min(fit.x_px, fit.y_px, cols - 1 - fit.x_px, rows - 1 - fit.y_px) < half_width_px


class _Gaussian(NamedTuple):
    """MTF50 of the fitted Gaussian with its pixel, and its standard error, in cy/px."""

    mtf50: float
    err: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Contrast:
    """The e-SFR of an edge, or why there is none."""

    esfr: EdgeSfr | None = None
    missing: str | None = None

    @classmethod
    def of(cls, binned: BinnedEdge | None, gaussian: _Gaussian) -> "_Contrast":
        if binned is None:
            return cls(missing="too few pixels lie beside the edge")
        gap_px = widest_gap_px(binned)
        if is_aliased(binned, gap_px):
            return cls(missing=gap_message(binned, gap_px))
        esfr = measure_esfr(binned)
        if esfr is None:
            return cls(missing="the levels beside the edge are not even")
        # Between distances so far apart, it is as likely to be wrong as the Gaussian.
        if gap_px > WIDEST_GAP_PX * binned.pitch_px and _differs(esfr, gaussian):
            return cls(missing=gap_message(binned, gap_px))
        return cls(esfr=esfr)

    def widened(
        self, segment: EdgeSegment, fit: EdgeFit, compression: JpegCompression | None
    ) -> "_Contrast":
        """The same with what uneven light and compression may have done to MTF50 in its error."""
        if self.esfr is None:
            return self
        mtf50, err = self.esfr.mtf50_cy_per_px, self.esfr.mtf50_err_cy_per_px
        if mtf50 is None or err is None:
            return self
        if compression is not None:
            err = mtf50 * mtf50_error_behind(compression, segment, fit, self.esfr)
        err = math.hypot(err, mtf50 * _MTF50_BY_SLOPE * fit.slope_left)
        return replace(self, esfr=replace(self.esfr, mtf50_err_cy_per_px=err))


def _measurement(
    source: EdgeImage,
    fit: EdgeFit,
    contrast: _Contrast,
    rough_px: float | None,
    binned: BinnedEdge | None,
) -> EdgeMeasurement:
    """The edge in sensor pixels."""
    esfr = contrast.esfr
    gaussian = _gaussian_mtf50(fit)
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
        mtf50_cy_per_px=gaussian.mtf50,
        mtf50_err_cy_per_px=gaussian.err,
        esfr_mtf50_cy_per_px=None if esfr is None else esfr.mtf50_cy_per_px,
        esfr_mtf50_err_cy_per_px=None if esfr is None else esfr.mtf50_err_cy_per_px,
        esfr_mtf20_cy_per_px=None if esfr is None else esfr.mtf20_cy_per_px,
        esfr_missing=contrast.missing,
        contrast=_contrast(fit),
        roughness_px=rough_px,
        clipped_fraction=fit.clipped_fraction,
        chi2_reduced=fit.chi2_reduced,
        flags=_flags(source, fit, _differs(esfr, gaussian)),
        levels_dn=(fit.low_dn, fit.high_dn),
        esfr=esfr,
        binned=binned,
    )


def _gaussian_mtf50(fit: EdgeFit) -> _Gaussian:
    optical, err = fit.optical_sigma_px, fit.optical_sigma_err_px
    if optical is None or err is None:
        mtf50 = gaussian_mtf50(fit.sigma_px)
        return _Gaussian(mtf50, mtf50 * fit.sigma_err_px / fit.sigma_px)
    mtf50 = pixel_mtf50(optical, fit.normal_rad)
    wider = pixel_mtf50(optical * (1 + _SIGMA_STEP), fit.normal_rad)
    return _Gaussian(mtf50, (mtf50 - wider) * err / (optical * _SIGMA_STEP))


def _differs(esfr: EdgeSfr | None, gaussian: _Gaussian) -> bool:
    """Whether the contrast contradicts the fitted Gaussian by more than their errors."""
    if esfr is None or esfr.mtf50_cy_per_px is None or esfr.mtf50_err_cy_per_px is None:
        return False
    apart = abs(esfr.mtf50_cy_per_px - gaussian.mtf50)
    surprising = _DIFFERS_SIGMAS * math.hypot(esfr.mtf50_err_cy_per_px, gaussian.err)
    return apart > max(surprising, _DIFFERS_LEAST * gaussian.mtf50)


def _contrast(fit: EdgeFit) -> float | None:
    """Michelson contrast of the edge's two levels; None if their sum is not positive."""
    total = fit.high_dn + fit.low_dn
    return abs(fit.high_dn - fit.low_dn) / total if total > 0 else None


def _flags(source: EdgeImage, fit: EdgeFit, differs: bool) -> tuple[str, ...]:
    flags, fraction = fit.flags, fit.clipped_fraction
    # A plane made of clipped colours, or corrected, has no level from which on it is clipped.
    is_hidden = source.clipped is not None and fraction is not None and fraction > CLIPPED_FRACTION
    if is_hidden and "saturated" not in flags:
        flags = ("saturated", *(flag for flag in flags if flag != "clipped"))
    if differs:
        flags = (*flags, "esfr_differs")
    return (*flags, "jpeg") if source.is_jpeg else flags


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeSelection:
    """Which edges of a photograph count.

    ``region`` returns its part, None for all. With the target ``auto``, edges of the scene beside a
    target are flagged ``beside_target`` and spokes of a Siemens star ``star_spoke``; with ``all``,
    every edge counts.
    """

    region: Callable[[EdgeImage], Region | None] = lambda _: None
    target: TargetChoice = "auto"

    def measured_in(self, source: EdgeImage, method: Method) -> list[EdgeMeasurement]:
        """Measure the edges of a photograph."""
        edges = edges_of_image(source, self.region(source), method)
        return _told_apart(edges, source.pitch_px) if self.target == "auto" else edges


def _told_apart(edges: Sequence[EdgeMeasurement], pitch_px: int = 1) -> list[EdgeMeasurement]:
    """Flag the edges that are not of an edge target, of all that a photograph has.

    The spokes of a star are ``star_spoke``, edges of the scene ``beside_target``.
    """
    spokes = star_spokes([_segment(edge, pitch_px) for edge in edges]).tolist()
    flags = ["star_spoke" if one else "" for one in spokes]
    known = [n for n, edge in enumerate(edges) if edge.levels_dn is not None and not flags[n]]
    segments = [_segment(edges[n], pitch_px) for n in known]
    levels_dn = np.array([edges[n].levels_dn for n in known]).reshape(-1, 2)
    for number, is_beside in zip(known, beside_target(segments, levels_dn).tolist(), strict=True):
        flags[number] = "beside_target" if is_beside else ""
    return [
        edge.model_copy(update={"flags": (*edge.flags, flag)}) if flag else edge
        for edge, flag in zip(edges, flags, strict=True)
    ]


def _segment(edge: EdgeMeasurement, pitch_px: int) -> EdgeSegment:
    """Where the edge lies, in the pixels in which it was measured."""
    return EdgeSegment(
        x_px=edge.x_px / pitch_px,
        y_px=edge.y_px / pitch_px,
        normal_rad=edge.normal_rad,
        length_px=edge.length_px / pitch_px,
        found_length_px=edge.length_px / pitch_px,
        sigma_px=edge.sigma_px / pitch_px,
    )
