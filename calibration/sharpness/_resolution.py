"""MTF50 in the units that people ask for, with its uncertainty, and lateral colour.

Lateral colour: how far red and blue stand from green across the same edge. The same edge is fitted
in each colour, with position, width and both levels free. What all colours share (a curved edge,
shading, a PSF that is not Gaussian) drops out of the difference.

ISO 12233:2023, clause 4: line widths per picture height are ``2 f H``, with the frequency ``f`` in
cycles per pixel and the picture's height ``H`` in pixels; a line pair is one cycle.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from math import cos, hypot, pi, sin, sqrt, tan

import numpy as np
from scipy.special import ndtr

from calibration.edges import EdgeImage, EdgeMeasurement, plane_places
from calibration.estimate import NORMAL_95
from simulation.arrays import BoolArray, FloatArray

_COLOURS = ("red", "green", "blue")
_BAND_SIGMAS = 3.0
_BAND_EXTRA_PX = 2.0  # a shift of two pixels stays inside
_FEWEST_PIXELS = 30
_STEPS = 12
_SETTLED_PX = 1e-6
_FARTHEST_PX = 3.0  # beyond it is another edge
_WIDTH_FACTOR_MOST = 4.0


def _with_colour_shifts(
    edges: Sequence[EdgeMeasurement], source: EdgeImage
) -> list[EdgeMeasurement]:
    """Return the edges with the shifts of red and blue from green; without colours, as they are.

    The shift is along the edge's normal, in px, positive away from the frame's centre.
    """
    if source.colours_dn is None and source.pattern is None:
        return list(edges)
    return [_with_shifts(edge, source) if edge.is_used else edge for edge in edges]


def _with_shifts(edge: EdgeMeasurement, source: EdgeImage) -> EdgeMeasurement:
    found = {}
    pixels = list(_pixels_by_colour(edge, source))
    if len(pixels) < len(_COLOURS) or _is_grey(pixels):
        return edge
    for colour, (distance, levels) in zip(_COLOURS, pixels, strict=True):
        place = _edge_place(distance, levels, edge.sigma_px)
        if place is None:
            return edge
        found[colour] = place
    sign = _outward(edge, source.frame)
    green, green_err = found["green"]
    shifts = {}
    for colour in ("red", "blue"):
        place_px, err_px = found[colour]
        shifts[f"{colour}_shift_px"] = sign * (place_px - green)
        shifts[f"{colour}_shift_err_px"] = hypot(err_px, green_err)
    return edge.model_copy(update=shifts)


def _outward(edge: EdgeMeasurement, frame: tuple[int, int]) -> float:
    """1 where the edge's normal points away from the frame's centre, else -1."""
    rows, cols = frame
    right, down = edge.x_px - (cols - 1) / 2, edge.y_px - (rows - 1) / 2
    outwards = right * np.cos(edge.normal_rad) + down * np.sin(edge.normal_rad)
    return 1.0 if outwards >= 0 else -1.0


def _is_grey(pixels: Sequence[tuple[FloatArray, FloatArray]]) -> bool:
    """Whether all colours are the same numbers: a grey photograph stored as colour."""
    first = pixels[0][1]
    return all(np.array_equal(levels, first) for _, levels in pixels[1:])


def _pixels_by_colour(
    edge: EdgeMeasurement, source: EdgeImage
) -> Iterator[tuple[FloatArray, FloatArray]]:
    """Distance and level of the pixels around an edge in red, green and blue."""
    rows, cols = source.frame
    normal = edge.normal_rad
    c, s = np.cos(normal), np.sin(normal)
    width = _BAND_SIGMAS * edge.sigma_px + _BAND_EXTRA_PX
    half = 0.5 * edge.length_px
    reach_x, reach_y = width * abs(c) + half * abs(s), width * abs(s) + half * abs(c)
    left, right = max(int(edge.x_px - reach_x), 0), min(int(edge.x_px + reach_x) + 2, cols)
    top, bottom = max(int(edge.y_px - reach_y), 0), min(int(edge.y_px + reach_y) + 2, rows)
    y, x = np.mgrid[top:bottom, left:right]
    across = (x - edge.x_px) * c + (y - edge.y_px) * s
    along = (y - edge.y_px) * c - (x - edge.x_px) * s
    inside = (np.abs(across) <= width) & (np.abs(along) <= half)
    part = np.s_[top:bottom, left:right]
    for number, colour in enumerate(_COLOURS):
        chosen = inside & _has_colour(colour, source, x, y)
        image = source.image_dn if source.colours_dn is None else source.colours_dn[:, :, number]
        yield across[chosen], np.asarray(image[part][chosen], dtype=np.float64)


def _has_colour(colour: str, source: EdgeImage, x: FloatArray, y: FloatArray) -> BoolArray | bool:
    """Which pixels tell a colour: all of a colour photograph, a part of a mosaic."""
    if source.pattern is None:
        return True
    here = np.zeros(x.shape, dtype=np.bool_)
    for place in plane_places(source.pattern):
        if place.colour == colour:
            here |= (x % 2 == place.first_x_px) & (y % 2 == place.first_y_px)
    return here


def _edge_place(
    distance_px: FloatArray, levels_dn: FloatArray, sigma_px: float
) -> tuple[float, float] | None:
    """Fit where an edge lies along the distance, with its standard error; None if not near 0.

    Least squares of ``low + (high - low) Phi((d - place) / sigma)`` by Gauss and Newton.
    """
    if distance_px.size < _FEWEST_PIXELS:
        return None
    place, sigma = 0.0, sigma_px
    for _ in range(_STEPS):
        shape, slope = _edge_and_slope(distance_px, place, sigma)
        levels = np.column_stack([1 - shape, shape])
        low, high = np.linalg.lstsq(levels, levels_dn, rcond=None)[0].tolist()
        contrast = high - low
        scaled = (distance_px - place) / sigma
        design = np.column_stack([levels, -contrast * slope, -contrast * scaled * slope])
        left = levels_dn - low - contrast * shape
        normal = design.T @ design
        try:
            step = np.linalg.solve(normal, design.T @ left)
        except np.linalg.LinAlgError:
            return None
        place += float(step[2])
        sigma = float(np.clip(sigma + step[3], 0.5 * sigma, 2.0 * sigma))
        if not (
            abs(place) < _FARTHEST_PX
            and sigma_px / _WIDTH_FACTOR_MOST < sigma < _WIDTH_FACTOR_MOST * sigma_px
        ):
            return None
        if abs(step[2]) < _SETTLED_PX:
            break
    variance = float(left @ left) / max(left.size - 4, 1)
    return place, sqrt(variance * float(np.linalg.inv(normal)[2, 2]))


def _edge_and_slope(
    distance_px: FloatArray, place_px: float, sigma_px: float
) -> tuple[FloatArray, FloatArray]:
    scaled = (distance_px - place_px) / sigma_px
    slope = np.exp(-0.5 * scaled**2) / (sqrt(2 * pi) * sigma_px)
    return np.asarray(ndtr(scaled)), np.asarray(slope)


_SERIES_BELOW = 1e-4  # where sinc'/sinc is -pi^2 f / 3 to 1e-9


@dataclass(frozen=True, slots=True, kw_only=True)
class _Mtf50:
    """Frequency of half contrast in cy/px, its error if known, and whether it is of the e-SFR."""

    cy_per_px: float
    err_cy_per_px: float | None
    is_model_free: bool

    @property
    def reach_95_cy_per_px(self) -> float | None:
        """Half width of the 95 % interval."""
        return None if self.err_cy_per_px is None else NORMAL_95 * self.err_cy_per_px


def reported_mtf50(edge: EdgeMeasurement) -> _Mtf50:
    """Return the MTF50 to report for an edge: of its e-SFR, else of the fitted Gaussian.

    The e-SFR assumes no shape of the PSF, as ISO 12233 asks. Where an edge does not determine it
    with an error (too short, phases with gaps, contrast above a half at 1 cy/px), the Gaussian's
    stands in, and ``is_model_free`` says so.
    """
    value, err = edge.esfr_mtf50_cy_per_px, edge.esfr_mtf50_err_cy_per_px
    if value is not None and err is not None:
        return _Mtf50(cy_per_px=value, err_cy_per_px=err, is_model_free=True)
    known = edge.mtf50_err_cy_per_px
    return _Mtf50(
        cy_per_px=edge.mtf50_cy_per_px,
        err_cy_per_px=_gaussian_mtf50_err(edge) if known is None else known,
        is_model_free=False,
    )


def lw_per_ph(cy_per_px: float, picture_height_px: float) -> float:
    """Convert cycles per pixel to line widths per picture height."""
    return 2.0 * cy_per_px * picture_height_px


def lp_per_mm(cy_per_px: float, pixel_pitch_um: float) -> float:
    """Convert cycles per pixel to line pairs per millimetre on the sensor."""
    return 1000.0 * cy_per_px / pixel_pitch_um


def picture_height_px(edge: EdgeMeasurement) -> float | None:
    """Return the height of an edge's own photograph; None where its units are not known."""
    if edge.mtf50_lw_per_ph is None:
        return None
    return edge.mtf50_lw_per_ph / lw_per_ph(edge.mtf50_cy_per_px, 1.0)


def _gaussian_mtf50_err(edge: EdgeMeasurement) -> float:
    """Standard error of the fitted Gaussian's MTF50, from that of its width."""
    if edge.optical_sigma_px is None or edge.optical_sigma_err_px is None:
        return edge.mtf50_cy_per_px * edge.sigma_err_px / edge.sigma_px
    freq, sigma = edge.mtf50_cy_per_px, edge.optical_sigma_px
    by_sigma = 4 * pi**2 * sigma * freq**2
    by_freq = 4 * pi**2 * sigma**2 * freq
    for share in (cos(edge.normal_rad), sin(edge.normal_rad)):
        by_freq -= share * _log_sinc_slope(freq * share)
    return edge.optical_sigma_err_px * by_sigma / by_freq


def _log_sinc_slope(x: float) -> float:
    """Derivative of ``log(sin(pi x) / (pi x))``."""
    if abs(x) < _SERIES_BELOW:
        return -(pi**2) * x / 3
    return pi / tan(pi * x) - 1 / x


def with_sharpness(edges: Sequence[EdgeMeasurement], source: EdgeImage) -> list[EdgeMeasurement]:
    """Return the edges with MTF50 in all units and, in colour, with their shifts."""
    height_px, pitch_um = source.frame[0], source.pixel_pitch_um
    found = []
    for edge in edges:
        esfr = edge.esfr_mtf50_cy_per_px
        values: dict[str, float | None] = {
            "mtf50_err_cy_per_px": _gaussian_mtf50_err(edge),
            "mtf50_lw_per_ph": lw_per_ph(edge.mtf50_cy_per_px, height_px),
            "esfr_mtf50_lw_per_ph": None if esfr is None else lw_per_ph(esfr, height_px),
        }
        if pitch_um is not None:
            values["mtf50_lp_per_mm"] = lp_per_mm(edge.mtf50_cy_per_px, pitch_um)
            values["esfr_mtf50_lp_per_mm"] = None if esfr is None else lp_per_mm(esfr, pitch_um)
        found.append(edge.model_copy(update=values))
    return _with_colour_shifts(found, source)
