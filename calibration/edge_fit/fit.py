"""PSF width from one edge: maximum likelihood on the raw, unbinned pixels.

Method: Gaussian error function model of the edge (as the paper fits a Gaussian to the line
spread function) without the binning of ISO 12233, which is what biases narrow widths.
"""

from dataclasses import dataclass, replace
from math import cos, exp, sin, sqrt

import numpy as np

from calibration.edge_fit.clipping import seen_rise
from calibration.edge_fit.jpeg import JpegCompression, behind_compression
from calibration.edge_fit.likelihood import maximise
from calibration.edge_fit.likely_edge import LikelyEdge, WidthFit
from calibration.edge_fit.model import (
    CURVATURE,
    HIGH,
    LOG_SIGMA,
    LOW,
    OFFSET,
    TURN,
)
from calibration.edge_fit.residuals import profile_flags
from calibration.edge_fit.rounding import Rounding
from calibration.edge_fit.shading import slope_left
from calibration.edge_search import SHORTEST_PX, EdgeSegment, band_half_width
from calibration.noise import LevelNoise
from simulation.arrays import FloatArray

NOISIEST_SNR = 3.0
_NOISIEST_ERROR = 0.1  # of sigma: what tells it no better is as likely to be something else
CLIPPED_FRACTION = 0.05  # of the pixels: from here on the fit relies on what is not clipped
# Of the rise. Photographed edges that were clipped at 0.95 of it came out with 0.5 %, at
# 0.9 with -5 %: no lens is quite Gaussian.
_SEEN_LEAST = 0.9
_CLIPPED_ERROR = 0.05  # of sigma: what is left then does not tell the width
_SIGMA_BY_SLOPE = 1.0  # relative change of sigma by a slope of this share of the contrast
SHARPEST_PX = 0.075  # optical widths below this look like a perfect lens


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeFit:
    """PSF width across one edge, total and optical, with standard errors.

    ``angle_deg`` in [0, 180) is the direction of the edge line against +x, y down;
    ``curvature_per_px`` its curvature at the middle. ``optical_sigma_px`` is None where the
    edge is as sharp as the pixel square alone. ``chi2_reduced`` is None where the noise is
    known from this edge's residuals only. ``clipped_fraction`` is of the pixels of the fit, None
    where the saturation level is not known. ``rounding`` tells of rounding errors that the
    noise is too small to make random; None where there are none. ``slope_left`` is what light that
    falls off may still change from the edge to the border of the pixels, in parts of the contrast;
    the errors of the widths contain it.
    """

    x_px: float
    y_px: float
    angle_deg: float
    length_px: float
    sigma_px: float
    sigma_err_px: float
    optical_sigma_px: float | None
    optical_sigma_err_px: float | None
    low_dn: float
    high_dn: float
    noise_dn: float
    curvature_per_px: float
    chi2_reduced: float | None
    flags: tuple[str, ...]
    clipped_fraction: float | None = None
    rounding: Rounding | None = None
    slope_left: float = 0.0

    @property
    def snr(self) -> float:
        """Contrast of the edge over the noise of one pixel."""
        return abs(self.high_dn - self.low_dn) / self.noise_dn if self.noise_dn > 0 else np.inf

    @property
    def normal_rad(self) -> float:
        """Angle of the edge normal, in radians modulo pi."""
        return float(np.deg2rad(self.angle_deg + 90.0))

    def moved(self, right_px: float, down_px: float) -> "EdgeFit":
        """Return the same fit in an image whose origin is further left and up."""
        return replace(self, x_px=self.x_px + right_px, y_px=self.y_px + down_px)


def fit_edge(
    image_dn: FloatArray,
    segment: EdgeSegment,
    *,
    noise: LevelNoise | None = None,
    saturation_dn: float | None = None,
    compression: JpegCompression | None = None,
) -> EdgeFit | None:
    """Fit total and optical PSF width to the pixels around one edge.

    Parameters
    ----------
    image_dn
        Shape ``(rows, cols)``, float64, linear in light.
    segment
        Where the edge is, to within about a pixel and a few degrees.
    noise
        Noise of one pixel of ``image_dn``; None estimates it from the residuals.
    saturation_dn
        Pixels at or above 99.5 % of it, or at 0, count as saturated.
    compression
        How the image was compressed: the widths are then those before, with errors that contain
        what was lost. None if it was not, or is not known.

    Returns
    -------
    EdgeFit or None
        None where no edge model fits: no contrast, too few pixels or no convergence.
    """
    noise_line = np.empty(0)
    if noise is not None:
        noise_line = np.array([noise.offset_dn2, noise.slope_dn, noise.floor_dn2])
    image_dn = np.ascontiguousarray(image_dn, dtype=np.float32)  # nothing is done if it is
    likely = maximise(
        image_dn,
        segment.line,
        segment.sigma_px,
        segment.clearance_px,
        noise_line,
        np.inf if saturation_dn is None else float(saturation_dn),
    )
    if not likely.total.is_found:
        return None
    # What noise tells no better may be no edge at all; what compression hides of one is weighted.
    is_vague = sqrt(likely.total.log_sigma_variance) > _NOISIEST_ERROR
    slope = _slope_left(likely, image_dn, segment)
    # What compression adds to the error is no matter of what is seen of the rise.
    clipping = None if saturation_dn is None else _clipping_flag(likely, saturation_dn)
    if compression is not None:
        likely = behind_compression(
            likely, image_dn, segment.line, segment.clearance_px, compression
        )
    likely = likely._replace(
        total=_widened(likely.total, slope), optical=_widened(likely.optical, slope)
    )
    fit = _measurement(
        likely, segment, clipping, is_vague=is_vague, is_noise_known=noise is not None
    )
    fit = replace(fit, slope_left=slope)
    return fit if saturation_dn is not None else replace(fit, clipped_fraction=None)


def _slope_left(likely: LikelyEdge, image_dn: FloatArray, segment: EdgeSegment) -> float:
    low, high = likely.total.parameters[LOW], likely.total.parameters[HIGH]
    sigma_px = exp(likely.total.parameters[LOG_SIGMA])
    half_width_px = min(band_half_width(sigma_px), segment.clearance_px)
    slope_dn_per_px = slope_left(
        image_dn, segment.line, half_width_px, segment.clearance_px, (float(low), float(high))
    )
    return float(slope_dn_per_px * half_width_px / (high - low))


def _widened(fit: WidthFit, slope: float) -> WidthFit:
    """The fit with what a slope of this share of the contrast may do to its width."""
    variance = fit.log_sigma_variance + (_SIGMA_BY_SLOPE * slope) ** 2
    return fit._replace(log_sigma_variance=variance)


def _measurement(
    likely: LikelyEdge,
    segment: EdgeSegment,
    clipping: str | None,
    *,
    is_vague: bool,
    is_noise_known: bool,
) -> EdgeFit:
    total = likely.total.parameters
    sigma, sigma_err = _width(likely.total)
    optical: float | None = None
    optical_err: float | None = None
    best = likely.optical if likely.is_square else likely.total
    if likely.optical.is_found:
        optical, optical_err = _width(likely.optical)
        if optical < SHARPEST_PX:
            optical = optical_err = None
    half_length_px = segment.line.half_length_px
    # The shape that fits worse gives a sharp edge along the rows a wrong angle: its misfit at a
    # few distances looks like a slope.
    position = best.parameters
    angle = segment.normal_rad + position[TURN] / half_length_px
    contrast = abs(best.parameters[HIGH] - best.parameters[LOW])
    flags = list(profile_flags(likely.profile, contrast))
    if clipping is not None:
        flags.insert(0, clipping)
    for flag, applies in (
        ("too_short", segment.length_px < SHORTEST_PX),
        ("too_noisy", contrast < NOISIEST_SNR * likely.noise_dn or is_vague),
        ("outliers", likely.has_outliers),
        ("shaded", likely.is_shaded),
    ):
        if applies:
            flags.append(flag)
    return EdgeFit(
        x_px=float(segment.x_px + position[OFFSET] * cos(angle)),
        y_px=float(segment.y_px + position[OFFSET] * sin(angle)),
        angle_deg=float(np.rad2deg(angle) + 90.0) % 180.0,
        length_px=segment.length_px,
        sigma_px=sigma,
        sigma_err_px=sigma_err,
        optical_sigma_px=optical,
        optical_sigma_err_px=optical_err,
        low_dn=float(total[LOW]),
        high_dn=float(total[HIGH]),
        noise_dn=float(likely.noise_dn),
        curvature_per_px=float(2 * position[CURVATURE] / half_length_px**2),
        chi2_reduced=float(likely.chi2_reduced) if is_noise_known else None,
        flags=tuple(flags),
        clipped_fraction=likely.clipped_fraction,
        rounding=likely.rounding if likely.rounding.dark_step_dn > 0 else None,
    )


def _clipping_flag(likely: LikelyEdge, saturation_dn: float) -> str | None:
    """``saturated`` where the pixels that are not clipped do not tell the width, else ``clipped``.

    The width is that of a Gaussian through the part of the rise that is seen.
    """
    if likely.clipped_fraction <= CLIPPED_FRACTION:
        return None
    total = likely.total
    is_told = (
        likely.is_censored
        and seen_rise(total.parameters[LOW], total.parameters[HIGH], saturation_dn) >= _SEEN_LEAST
        and sqrt(total.log_sigma_variance) <= _CLIPPED_ERROR
    )
    return "clipped" if is_told else "saturated"


def _width(fit: WidthFit) -> tuple[float, float]:
    """Sigma and its standard error."""
    sigma = exp(fit.parameters[LOG_SIGMA])
    return sigma, sigma * sqrt(fit.log_sigma_variance)
