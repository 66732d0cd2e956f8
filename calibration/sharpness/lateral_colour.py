"""Lateral colour: how far red and blue stand from green across the same edge.

The same edge is fitted in each colour, with position, width and both levels free. What all colours
share (a curved edge, shading, a PSF that is not Gaussian) drops out of the difference.
"""

from collections.abc import Iterator, Sequence
from math import hypot, pi, sqrt

import numpy as np
from scipy.special import ndtr

from calibration.edges import EdgeImage, EdgeMeasurement, plane_places
from simulation.arrays import BoolArray, FloatArray

_COLOURS = ("red", "green", "blue")
_BAND_SIGMAS = 3.0
_BAND_EXTRA_PX = 2.0  # a shift of two pixels stays inside
_FEWEST_PIXELS = 30
_STEPS = 12
_SETTLED_PX = 1e-6
_FARTHEST_PX = 3.0  # beyond it is another edge
_WIDTH_FACTOR_MOST = 4.0


def with_colour_shifts(
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
        place = edge_place(distance, levels, edge.sigma_px)
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


def edge_place(
    distance_px: FloatArray, levels_dn: FloatArray, sigma_px: float
) -> tuple[float, float] | None:
    """Fit where an edge lies along the distance, with its standard error.

    Least squares of ``low + (high - low) Phi((d - place) / sigma)`` with all four free, by Gauss
    and Newton. None where it does not settle near 0.
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
