"""PSF width from one edge: maximum likelihood on the raw, unbinned pixels.

The most likely edge behind a JPEG: what is rounded there are cosines of blocks, not pixels. A JPEG
stores multiples of a step for each of the 64 cosines of a block of 8 x 8 codes. Each tells an
interval of the cosine before compression, and the noise of the codes is as white in the cosines,
their transform being orthonormal: the likelihood is that of ``rounded``, of cosines in place of
pixels. What compression loses is thereby part of the stated error, and ringing and the loss of high
frequencies move no width.

Method: Gaussian error function model of the edge (as the paper fits a Gaussian to the line spread
function) without the binning of ISO 12233, which is what biases narrow widths.

References
----------
ITU-T T.81 (1992), A.3.3 (the transform) and A.3.4 (the steps).
"""

from dataclasses import dataclass, field, replace
from math import ceil, cos, exp, floor, hypot, pi, sin, sqrt

import numpy as np

from calibration.edges._likelihood import LikelyEdge, WidthFit, maximise
from calibration.edges._model import CURVATURE, HIGH, LOG_SIGMA, LOW, OFFSET, TURN
from calibration.edges._residuals import Rounding, profile_flags
from calibration.edges._ridges import SMOOTHING_PX, ArtefactGradient
from calibration.edges._rounded import (
    Intervals,
    LikelyParameters,
    cosine_transform,
    is_more_likely,
    maximise_intervals,
    seen_rise,
)
from calibration.edges._segments import (
    SHORTEST_PX,
    BandPixels,
    EdgeLine,
    EdgeSegment,
    band_half_width,
)
from calibration.edges._shading import slope_left
from calibration.noise import LevelNoise
from simulation.arrays import AnyArray, FloatArray
from simulation.compiled import compiled, compiled_part

_SIDE = 8
_CODES = 256
EVEN_CODE = 128  # taken off before the transform
_ROUNDED_VARIANCE = 25.0  # of the variance, without noise: benchmarks/studies/edge_levels.py
_RECOVERED = 3.0  # codes: from this step on, the rounding of decoded codes hides no multiple
_ROUNDING = 1 / 12  # codes^2: of the codes before compression, and of those after it
_HALF_CODE = 4.0  # in the first cosine, the mean times 8
_FLAT_CODES = 2.0  # range of the codes of a block whose rounding errors are not independent
_USUAL_NOISE = 0.7  # codes, before compression
# Errors of widths from decoded pixels over their stated ones were 1.4, 4.3 and 6.3 at qualities of
# 95, 85 and 75, where the mean step of the 16 lowest cosines is 1.6, 4.9 and 8.3 (contrast 40 to
# 200, noise 0.5 to 2 codes).
_ERROR_PER_STEP = 0.8
_REC601 = np.array([0.299, 0.587, 0.114])  # of codes: ITU-T T.871, section 7
_BESIDE_PX = 8.0  # of an edge
_SHARE_GREY = 0.9  # of the pixels: other things may reach into the box about an edge
_STEPS_OF_ARTEFACT = 1.0  # of 0.7 to 1.4, all leave no ringing beside 800 edges, and all edges
_FEWEST_CROSSED = 3  # blocks that the edge crosses


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JpegCompression:
    """How a photograph was compressed, so far as the fit of an edge asks.

    ``steps`` is the luma's quantisation table, shape ``(8, 8)``, rows by vertical frequency;
    ``code_levels_dn``, shape ``(256,)``, is the level of each code in the plane. Its first pixel is
    at ``first_row``, ``first_col`` of a block. Unless ``is_luma``, the plane does not follow from
    what was compressed.
    """

    steps: FloatArray = field(repr=False)
    code_levels_dn: FloatArray = field(repr=False)
    first_row: int = 0
    first_col: int = 0
    is_luma: bool = True

    def __post_init__(self) -> None:
        if self.steps.shape != (_SIDE, _SIDE) or not np.all(self.steps >= 1):
            raise ValueError(f"steps must be 8 x 8 of at least 1, got {self.steps.tolist()}")
        if self.code_levels_dn.shape != (_CODES,) or not np.all(np.diff(self.code_levels_dn) > 0):
            raise ValueError("code_levels_dn must be 256 rising levels")

    @property
    def artefacts(self) -> ArtefactGradient:
        """The gradient of one step of a cosine: noise and ringing come in such steps."""
        frequency = np.pi * np.arange(_SIDE) / _SIDE
        squares = frequency[:, np.newaxis] ** 2 + frequency**2
        share = np.where(frequency > 0, 0.5, 1 / sqrt(_SIDE))
        height = self.steps * share[:, np.newaxis] * share
        codes_per_px = np.max(height * np.sqrt(squares) * np.exp(-0.5 * squares * SMOOTHING_PX**2))
        slopes = np.gradient(self.code_levels_dn)
        return ArtefactGradient(self.code_levels_dn, _STEPS_OF_ARTEFACT * codes_per_px * slopes)

    def cropped(self, top: int, left: int) -> "JpegCompression":
        """Return what holds for the plane without its first ``top`` rows and ``left`` columns."""
        return replace(
            self,
            first_row=(self.first_row + top) % _SIDE,
            first_col=(self.first_col + left) % _SIDE,
        )

    def along(
        self, plane_dn: FloatArray, colours_dn: AnyArray, line: EdgeLine
    ) -> "JpegCompression":
        """Return what holds for an edge of a colour photograph.

        Luma in light is not that of codes where colours differ; between greys both are the same.
        """
        reach_px = line.half_length_px + _BESIDE_PX
        right, down = abs(sin(line.normal_rad)) * reach_px, abs(cos(line.normal_rad)) * reach_px
        right, down = max(right, _BESIDE_PX), max(down, _BESIDE_PX)
        rows = slice(max(int(line.y_px - down), 0), int(line.y_px + down) + 1)
        cols = slice(max(int(line.x_px - right), 0), int(line.x_px + right) + 1)
        every = np.arange(float(_CODES))
        colours = np.asarray(colours_dn[rows, cols], dtype=np.float64)
        codes = np.interp(colours, self.code_levels_dn, every)
        own = np.interp(plane_dn[rows, cols], self.code_levels_dn, every)
        is_grey = bool(np.mean(np.abs(codes @ _REC601 - own) <= 0.5) >= _SHARE_GREY)
        return replace(self, is_luma=is_grey)


def _behind_compression(
    likely: LikelyEdge,
    image_dn: FloatArray,
    line: EdgeLine,
    clearance_px: float,
    compression: JpegCompression,
) -> tuple[LikelyEdge, float | None]:
    """Return the fit with the widths, and the noise in codes, before compression.

    With fewer than three whole blocks across the edge, with clipped pixels, or where the plane is
    not the luma, the error of the decoded width grows by what was measured, the noise is not told.
    """
    if likely.is_censored or not compression.is_luma:
        return _less_sure(likely, compression), None
    sigma = float(np.exp(likely.total.parameters[LOG_SIGMA]))
    data = _block_intervals(
        image_dn,
        line,
        (min(band_half_width(sigma), clearance_px), clearance_px),
        np.ascontiguousarray(compression.steps, dtype=np.float64),
        np.ascontiguousarray(compression.code_levels_dn, dtype=np.float64),
        (compression.first_row, compression.first_col),
    )
    if len(data.lower) == 0:
        return _less_sure(likely, compression), None
    starts = likely.total.parameters, likely.optical.parameters
    total, optical = maximise_intervals(data, starts, likely.optical.is_found)
    if not total.is_found:
        return _less_sure(likely, compression), None
    is_square = is_more_likely(optical, total)
    before = likely._replace(
        total=_with_rounding(total), optical=_with_rounding(optical), is_square=is_square
    )
    return before, float(np.mean((optical if is_square else total).noise_dn))


def _with_rounding(found: LikelyParameters) -> WidthFit:
    """A fit with what rounding adds before compression, where there is hardly any noise.

    Unlike white noise it does not average out along an edge, until noise is .3 codes and more.
    """
    dark, bright = found.noise_dn
    share = exp(-3 * pi**2 * (dark**2 + bright**2))
    variance = (1 + _ROUNDED_VARIANCE * share) * found.log_sigma_variance
    return WidthFit(found.is_found, found.parameters, variance)


def _less_sure(likely: LikelyEdge, compression: JpegCompression) -> LikelyEdge:
    """Widths from decoded pixels, with larger errors the larger the steps of the low cosines."""
    factor = max(_ERROR_PER_STEP * float(np.mean(compression.steps[:4, :4])), 1.0) ** 2
    return likely._replace(
        total=likely.total._replace(log_sigma_variance=factor * likely.total.log_sigma_variance),
        optical=likely.optical._replace(
            log_sigma_variance=factor * likely.optical.log_sigma_variance
        ),
    )


@compiled()
def _block_intervals(
    image_dn: FloatArray,
    line: EdgeLine,
    reach_px: tuple[float, float],
    steps: FloatArray,
    code_levels_dn: FloatArray,
    first: tuple[int, int],
) -> Intervals:
    """Cosines of the whole blocks around an edge with their intervals, in codes.

    The nearest pixel of a block is within the first reach, all are within the second.
    """
    rows, cols = image_dn.shape
    half_width_px, clearance_px = reach_px
    c, s = np.cos(line.normal_rad), np.sin(line.normal_rad)
    reach_x = (half_width_px + _SIDE) * abs(c) + line.half_length_px * abs(s)
    reach_y = (half_width_px + _SIDE) * abs(s) + line.half_length_px * abs(c)
    top = max(floor((line.y_px - reach_y + first[0]) / _SIDE) * _SIDE - first[0], 0)
    left = max(floor((line.x_px - reach_x + first[1]) / _SIDE) * _SIDE - first[1], 0)
    top += (-(top + first[0])) % _SIDE
    left += (-(left + first[1])) % _SIDE
    bottom = min(ceil(line.y_px + reach_y), rows - 1)
    right = min(ceil(line.x_px + reach_x), cols - 1)
    most = max((bottom - top) // _SIDE + 1, 0) * max((right - left) // _SIDE + 1, 0) * _SIDE**2
    x, y, codes, across = np.empty(most), np.empty(most), np.empty(most), np.empty(most)
    count = crossed = 0
    for row in range(top, bottom - _SIDE + 2, _SIDE):
        for col in range(left, right - _SIDE + 2, _SIDE):
            least, largest, longest = np.inf, -np.inf, 0.0
            is_whole = True
            for k in range(_SIDE**2):
                i, j = row + k // _SIDE, col + k % _SIDE
                dx, dy = j - line.x_px, i - line.y_px
                away = c * dx + s * dy
                code = float(np.argmin(np.abs(code_levels_dn - image_dn[i, j])))
                is_whole &= 0 < code < _CODES - 1
                x[count + k], y[count + k], codes[count + k] = dx, dy, code
                across[count + k] = away
                least, largest = min(least, away), max(largest, away)
                longest = max(longest, abs(c * dy - s * dx))
            nearest = max(least, -largest)
            if not is_whole or nearest > half_width_px or longest > line.half_length_px:
                continue
            if max(largest, -least) > clearance_px:
                continue
            crossed += int(nearest < 0)
            count += _SIDE**2
    if crossed < _FEWEST_CROSSED:
        count = 0
    pixels = BandPixels(
        x[:count],
        y[:count],
        codes[:count],
        across[:count],
        line.normal_rad,
        line.half_length_px,
    )
    return _with_bounds(pixels, steps, code_levels_dn)


@compiled_part()
def _with_bounds(pixels: BandPixels, steps: FloatArray, code_levels_dn: FloatArray) -> Intervals:
    """Bounds of the cosines before compression, from the decoded codes.

    Decoding rounds again: in a block with structure that is white noise of 1/12. In a flat one all
    codes are rounded alike: the first cosine is then known to half a code (four units) only, and
    small others are not told from 0.
    """
    count = len(pixels.values)
    transform = cosine_transform()
    lower, upper = np.empty(count), np.empty(count)
    extra, weights = np.full(count, _ROUNDING), np.ones(count)
    for k in range(0, count, _SIDE**2):
        block = pixels.values[k : k + _SIDE**2].reshape(_SIDE, _SIDE) - EVEN_CODE
        is_flat = block.max() - block.min() <= _FLAT_CODES
        cosines = transform @ block @ transform.T
        for i in range(_SIDE):
            for j in range(_SIDE):
                step, value = steps[i, j], cosines[i, j]
                n = k + i * _SIDE + j
                least = largest = value
                if is_flat and n == k:
                    least = step * ceil((value - _HALF_CODE) / step)
                    largest = max(step * floor((value + _HALF_CODE) / step), least)
                elif is_flat and step < 2 * _HALF_CODE:
                    weights[n] = 0.0
                elif step >= _RECOVERED:
                    least = largest = step * np.rint(value / step)
                else:
                    extra[n] = 2 * _ROUNDING
                lower[n], upper[n] = least - 0.5 * step, largest + 0.5 * step
    return Intervals(pixels, lower, upper, weights, 1.0, _USUAL_NOISE, extra, code_levels_dn)


NOISIEST_SNR = 3.0
_NOISIEST_ERROR = 0.1  # of sigma: what tells it no better is as likely to be something else
CLIPPED_FRACTION = 0.05  # of the pixels: from here on the fit relies on what is not clipped
_SEEN_LEAST = 0.85  # of the rise
# Relative error of sigma by the share of the rise that is not seen, as no lens is quite Gaussian:
# behind diffraction and aberrations a tenth costs 3 to 6 %, a twentieth 2 to 4 % (lenses of the
# public benchmark).
_SIGMA_BY_UNSEEN = 0.4
_CLIPPED_ERROR = 0.05  # of sigma: what is left then does not tell the width
_SIGMA_BY_SLOPE = 1.0  # relative change of sigma by a slope of this share of the contrast
SHARPEST_PX = 0.075  # optical widths below this look like a perfect lens


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeFit:
    """PSF width across one edge, total and optical, with standard errors.

    ``angle_deg`` in [0, 180) is the direction of the edge line against +x, y down.
    ``optical_sigma_px`` is None where the edge is as sharp as the pixel square alone,
    ``chi2_reduced`` where the noise is known from this edge only, ``clipped_fraction`` where the
    saturation is not known, ``rounding`` where it is no matter. ``slope_left`` is what light that
    falls off may still change up to the border, in parts of the contrast; the errors contain it.
    ``noise_codes`` is the noise before compression, where that is told.
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
    noise_codes: float | None = None

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
    """Fit total and optical PSF width to the pixels around one edge, in an image linear in light.

    The segment is right to about a pixel and a few degrees. None where no edge model fits. Without
    ``noise`` it is estimated from the residuals; pixels from 99.5 % of the saturation on, or at 0,
    are clipped; with ``compression`` the widths are those before.
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
    seen = 1.0 if saturation_dn is None else _seen(likely, saturation_dn)
    clipping = None if saturation_dn is None else _clipping_flag(likely, seen)
    noise_codes = None
    if compression is not None:
        likely, noise_codes = _behind_compression(
            likely, image_dn, segment.line, segment.clearance_px, compression
        )
    relative = hypot(_SIGMA_BY_SLOPE * slope, _SIGMA_BY_UNSEEN * (1 - seen))
    likely = likely._replace(
        total=_widened(likely.total, relative), optical=_widened(likely.optical, relative)
    )
    fit = _measurement(
        likely, segment, clipping, is_vague=is_vague, is_noise_known=noise is not None
    )
    fit = replace(fit, slope_left=slope, noise_codes=noise_codes)
    return fit if saturation_dn is not None else replace(fit, clipped_fraction=None)


def _slope_left(likely: LikelyEdge, image_dn: FloatArray, segment: EdgeSegment) -> float:
    low, high = likely.total.parameters[LOW], likely.total.parameters[HIGH]
    sigma_px = exp(likely.total.parameters[LOG_SIGMA])
    half_width_px = min(band_half_width(sigma_px), segment.clearance_px)
    slope_dn_per_px = slope_left(
        image_dn, segment.line, half_width_px, segment.clearance_px, (float(low), float(high))
    )
    return float(slope_dn_per_px * half_width_px / (high - low))


def _widened(fit: WidthFit, relative: float) -> WidthFit:
    """The fit with a further relative error of its width."""
    return fit._replace(log_sigma_variance=fit.log_sigma_variance + relative**2)


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


def _seen(likely: LikelyEdge, saturation_dn: float) -> float:
    """Share of the rise below the saturation; 1 where hardly any pixel is clipped."""
    if not likely.is_censored or likely.clipped_fraction <= CLIPPED_FRACTION:
        return 1.0
    total = likely.total.parameters
    return seen_rise(total[LOW], total[HIGH], saturation_dn)


def _clipping_flag(likely: LikelyEdge, seen: float) -> str | None:
    """``saturated`` where the unclipped pixels do not tell the width, else ``clipped``."""
    if likely.clipped_fraction <= CLIPPED_FRACTION:
        return None
    error = sqrt(likely.total.log_sigma_variance)
    is_told = likely.is_censored and seen >= _SEEN_LEAST and error <= _CLIPPED_ERROR
    return "clipped" if is_told else "saturated"


def _width(fit: WidthFit) -> tuple[float, float]:
    """Sigma and its standard error."""
    sigma = exp(fit.parameters[LOG_SIGMA])
    return sigma, sigma * sqrt(fit.log_sigma_variance)
