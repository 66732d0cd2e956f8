"""The most likely edge behind a JPEG: what is rounded there are cosines of blocks, not pixels.

A JPEG stores multiples of a step for each of the 64 cosines of a block of 8 x 8 codes. Each tells
an interval of the cosine before compression, and the noise of the codes is as white in the
cosines, their transform being orthonormal: the likelihood is that of ``rounded``, of cosines
in place of pixels. What compression loses is thereby part of the stated error, and
ringing and the loss of high frequencies move no width.

References
----------
ITU-T T.81 (1992), A.3.3 (the transform) and A.3.4 (the steps).
"""

from dataclasses import dataclass, field, replace
from math import ceil, cos, exp, floor, pi, sin, sqrt

import numpy as np

from calibration.edge_fit.block_cosines import cosine_transform
from calibration.edge_fit.likely_edge import LikelyEdge, WidthFit
from calibration.edge_fit.model import LOG_SIGMA
from calibration.edge_fit.rounded import (
    Intervals,
    LikelyParameters,
    is_more_likely,
    maximise_intervals,
)
from calibration.edge_search import (
    SMOOTHING_PX,
    ArtefactGradient,
    BandPixels,
    EdgeLine,
    band_half_width,
)
from simulation.arrays import AnyArray, FloatArray
from simulation.compiled import compiled, compiled_part

_SIDE = 8
_CODES = 256
_EVEN_CODE = 128  # taken off before the transform
_ROUNDED_VARIANCE = 25.0  # of the variance, without noise: benchmarks/bench_edge_levels.py
_RECOVERED = 3.0  # codes: from this step on, the rounding of decoded codes hides no multiple
_ROUNDING = 1 / 12  # codes^2: of the codes before compression, and of those after it
_HALF_CODE = 4.0  # in the first cosine, the mean times 8
_FLAT_CODES = 2.0  # range of the codes of a block whose rounding errors are not independent
_USUAL_NOISE = 0.7  # codes, before compression
# Errors of widths from decoded pixels over their stated ones were 1.4, 4.3 and 6.3 at qualities of
# 95, 85 and 75, where the mean step of the 16 lowest cosines is 1.6, 4.9 and 8.3 (contrast 40 to
# 200, noise 0.5 to 2 codes).
_ERROR_PER_STEP = 0.8
# Relative error of MTF50 beyond its stated one, for a step in parts of the contrast at that
# frequency, by an edge that is a block long: 288 edges of 53 px at qualities of 85 and 95.
_MTF50_PER_STEP = 0.9
_REC601 = np.array([0.299, 0.587, 0.114])  # of codes: ITU-T T.871, section 7
_BESIDE_PX = 8.0  # of an edge
_SHARE_GREY = 0.9  # of the pixels: other things may reach into the box about an edge
_STEPS_OF_ARTEFACT = 1.0  # of 0.7 to 1.4, all leave no ringing beside 800 edges, and all edges
_FEWEST_CROSSED = 3  # blocks that the edge crosses


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JpegCompression:
    """How a photograph was compressed, so far as the fit of an edge asks.

    ``steps`` is the luma's quantisation table, shape ``(8, 8)``, rows by vertical frequency.
    ``code_levels_dn``, shape ``(256,)`` and rising, is the level of each code in the plane that is
    measured. The plane's first pixel is at ``first_row``, ``first_col`` of a block. Where
    ``is_luma`` is false, the plane does not follow from what was compressed.
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

    def mtf50_error(
        self, mtf50_cy_per_px: float, normal_rad: float, levels_dn: tuple[float, float], px: float
    ) -> float:
        """Relative error of the contrast's frequency of 50 % by steps of cosines there.

        Parameters
        ----------
        mtf50_cy_per_px, normal_rad
            That frequency, and the direction in which it is.
        levels_dn
            Dark and bright level of the edge.
        px
            Length of the edge: blocks lose details independently.
        """
        index = 2 * _SIDE * mtf50_cy_per_px * np.abs([sin(normal_rad), cos(normal_rad)])
        row, col = np.minimum(np.rint(index).astype(int), _SIDE - 1)
        low, high = np.interp(levels_dn, self.code_levels_dn, np.arange(float(_CODES)))
        return float(_MTF50_PER_STEP * self.steps[row, col] / (high - low) * sqrt(_SIDE / px))

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

        Parameters
        ----------
        plane_dn, colours_dn
            Shapes ``(rows, cols)`` and ``(rows, cols, 3)``, linear in light.
        line
            The edge.
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


def behind_compression(
    likely: LikelyEdge,
    image_dn: FloatArray,
    line: EdgeLine,
    clearance_px: float,
    compression: JpegCompression,
) -> LikelyEdge:
    """Return the fit with the widths before compression.

    Where fewer than three whole blocks lie across the edge, within its length and clearance, or
    pixels are clipped, or the plane is not the luma, a width from the decoded pixels is all there
    is: its error grows by what was measured.
    """
    if likely.is_censored or not compression.is_luma:
        return _less_sure(likely, compression)
    sigma = float(np.exp(likely.total.parameters[LOG_SIGMA]))
    data = block_intervals(
        image_dn,
        line,
        (min(band_half_width(sigma), clearance_px), clearance_px),
        np.ascontiguousarray(compression.steps, dtype=np.float64),
        np.ascontiguousarray(compression.code_levels_dn, dtype=np.float64),
        (compression.first_row, compression.first_col),
    )
    if len(data.lower) == 0:
        return _less_sure(likely, compression)
    starts = likely.total.parameters, likely.optical.parameters
    total, optical = maximise_intervals(data, starts, likely.optical.is_found)
    if not total.is_found:
        return _less_sure(likely, compression)
    return likely._replace(
        total=_with_rounding(total),
        optical=_with_rounding(optical),
        is_square=is_more_likely(optical, total),
    )


def _with_rounding(found: LikelyParameters) -> WidthFit:
    """A fit with what rounding adds before compression, where there is hardly any noise.

    What is rounded follows the level, and goes on along an edge from one row to the next: unlike
    white noise it does not average out. Noise of .3 codes and more makes it white.
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
def block_intervals(
    image_dn: FloatArray,
    line: EdgeLine,
    reach_px: tuple[float, float],
    steps: FloatArray,
    code_levels_dn: FloatArray,
    first: tuple[int, int],
) -> Intervals:
    """Cosines of the whole blocks around an edge with their intervals, in codes.

    Parameters
    ----------
    image_dn
        Shape ``(rows, cols)``.
    line
        The edge as it was fitted.
    reach_px
        A block is taken where its nearest pixel is within the first distance from the line and all
        are within the second.
    steps, code_levels_dn, first
        As in ``JpegCompression``.

    Returns
    -------
    Intervals
        Pixels in the order of their blocks; none where too few blocks are crossed.
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

    Decoding rounds the codes again. In a block with structure that is white noise of 1/12, which
    hides no multiple of a large step. In a flat one all codes are rounded alike: the first cosine
    is then known to half a code (four units) only, and small others are not told from 0.
    """
    count = len(pixels.values)
    transform = cosine_transform()
    lower, upper = np.empty(count), np.empty(count)
    extra, weights = np.full(count, _ROUNDING), np.ones(count)
    for k in range(0, count, _SIDE**2):
        block = pixels.values[k : k + _SIDE**2].reshape(_SIDE, _SIDE) - _EVEN_CODE
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
