"""Find all straight edges of an image, at any angle.

Ridges of the gradient (Canny's non-maximum suppression and hysteresis) are grown into regions
of one direction; each region gets a line by total least squares weighted with the squared
gradient; collinear pieces are joined; what is too near is kept out of the fit's band.
"""

from dataclasses import replace
from math import ceil, cos, erf, inf, pi, sin, sqrt

import numpy as np

from calibration.edge_search.clearance import clear_stretches, nearest_others
from calibration.edge_search.gradient import PROFILE_PX, SMOOTHING_PX, Gradient, RidgePixels
from calibration.edge_search.ridges import (
    SHORTEST_REGION_PX,
    ArtefactGradient,
    find_ridges,
    refined,
)
from calibration.edge_search.segments import (
    SHORTEST_PX,
    EdgeSegment,
    band_half_width,
    corner_reach,
)
from simulation.arrays import FloatArray

_SHORTEST_EDGE_PX = 12.0
_JOINED_OFFSET_PX = 1.5
_JOINED_GAP_PX = 12.0
_NARROWEST_SIGMAS, _NARROWEST_EXTRA_PX = 2.0, 1.0  # half of a band that has both levels
_MOST = 0.7  # of a piece's length: a wider band is worth the rest
_LEAVES_PX = 1.5  # along the edge: where edges leave the frame, their ridges end 1.0 px before it
_BESIDE_PX = 60.0  # other edges farther away are not looked for
_CELL_PX = 128.0
_WIDEST_GUESS_PX = 4.0
_AFFORDED = 0.1  # of a line's length: what a wide edge may lose more at a corner


def _cut_variances(whole_px2: FloatArray) -> FloatArray:
    """Variances of Gaussians that are cut off at the reach of a ridge's profile, in px^2."""
    end = PROFILE_PX / np.sqrt(whole_px2)
    density = np.exp(-0.5 * end * end) / sqrt(2 * pi)
    inside = np.array([erf(one / sqrt(2)) for one in end.tolist()])
    return np.asarray(whole_px2 * (1 - 2 * end * density / inside))


_WHOLE_PX2 = np.linspace(0.1, 0.5 * (_WIDEST_GUESS_PX**2 + SMOOTHING_PX**2), 100)
_CUT_PX2 = _cut_variances(_WHOLE_PX2)


def find_edges(
    image_dn: FloatArray,
    *,
    cell_px: float = _CELL_PX,
    artefacts: ArtefactGradient | None = None,
) -> list[EdgeSegment]:
    """Find straight edges and cut long ones into pieces of about ``cell_px``.

    Parameters
    ----------
    image_dn
        Shape ``(rows, cols)``, finite.
    cell_px
        Length of the pieces: each measures the PSF at its own position in the field.
    artefacts
        What compression makes of a flat area: ridges that are weaker are no edges, nor are they
        near to one. None where nothing was compressed.

    Returns
    -------
    list of EdgeSegment
        From top to bottom; empty where there is none.
    """
    rows, cols = image_dn.shape
    gradient = Gradient.of(image_dn) if min(rows, cols) >= SHORTEST_REGION_PX else None
    if gradient is None:
        return []
    ridges = find_ridges(gradient, image_dn, artefacts)
    lines = [
        EdgeSegment(
            x_px=x,
            y_px=y,
            normal_rad=normal,
            length_px=length,
            found_length_px=length,
            sigma_px=1.0,
        )
        for x, y, normal, length in ridges.lines.tolist()
    ]
    pieces = []
    for line in _joined(lines):
        if line.found_length_px < _SHORTEST_EDGE_PX:
            continue
        trimmed = _trimmed(_sized(ridges.pixels, line), rows, cols)
        pieces.extend(_clear_pieces(trimmed, ridges.points, cell_px))
    return sorted(pieces, key=lambda e: (e.y_px, e.x_px))


def _ends(line: EdgeSegment) -> tuple[FloatArray, FloatArray]:
    along = np.array([-np.sin(line.normal_rad), np.cos(line.normal_rad)])
    middle = np.array([line.x_px, line.y_px])
    return middle - 0.5 * line.length_px * along, middle + 0.5 * line.length_px * along


def _joined(lines: list[EdgeSegment]) -> list[EdgeSegment]:
    """Join pieces that continue each other across a gap."""
    waiting = sorted(lines, key=lambda e: -e.length_px)
    x, y, half = (
        np.array([getattr(e, name) for e in waiting]) for name in ("x_px", "y_px", "length_px")
    )
    half = half / 2
    is_free = np.ones(len(waiting), dtype=np.bool_)
    joined: list[EdgeSegment] = []
    for first, longest in enumerate(waiting):
        if not is_free[first]:
            continue
        is_free[first] = False
        line = longest
        longer: EdgeSegment | None = longest
        while longer is not None:
            line, longer = longer, None
            c, s = cos(line.normal_rad), sin(line.normal_rad)
            across = np.abs(c * (x - line.x_px) + s * (y - line.y_px))
            along = np.abs(-s * (x - line.x_px) + c * (y - line.y_px))
            reach = half + 0.5 * line.length_px + _widest_gap_px(line)
            near = np.flatnonzero(is_free & (across <= _JOINED_OFFSET_PX) & (along <= reach))
            for index in near.tolist():
                longer = _continuation(line, waiting[index])
                if longer is not None:
                    is_free[index] = False
                    break
        joined.append(line)
    return joined


def _widest_gap_px(line: EdgeSegment) -> float:
    return max(_JOINED_GAP_PX, 0.1 * line.length_px)


def _continuation(line: EdgeSegment, other: EdgeSegment) -> EdgeSegment | None:
    """Join the two into one edge, if ``other`` continues ``line``."""
    apart = (other.normal_rad - line.normal_rad + pi) % (2 * pi) - pi
    shorter = min(line.length_px, other.length_px)
    if abs(apart) > max(np.deg2rad(2.0), 1.5 / shorter):
        return None
    c, s = cos(line.normal_rad), sin(line.normal_rad)
    positions, offsets = [], []
    for x, y in _ends(other):
        positions.append(-s * (x - line.x_px) + c * (y - line.y_px))
        offsets.append(abs(c * (x - line.x_px) + s * (y - line.y_px)))
    if max(offsets) > _JOINED_OFFSET_PX:
        return None
    half = 0.5 * line.length_px
    gap = max(min(positions) - half, -half - max(positions))
    if gap > _widest_gap_px(line):
        return None
    first, last = min(-half, *positions), max(half, *positions)
    middle = 0.5 * (first + last)
    return replace(
        line,
        x_px=line.x_px - s * middle,
        y_px=line.y_px + c * middle,
        length_px=last - first,
        found_length_px=last - first,
    )


def _sized(pixels: RidgePixels, line: EdgeSegment) -> EdgeSegment:
    """Refine the line on the gradient across it, and guess the width of the edge."""
    gradient = pixels.x, pixels.y, pixels.moments
    better, spread_px2 = refined(pixels.rows, pixels.cols, gradient, line.line)
    if spread_px2 < 0:
        return line
    # The squared gradient of a Gaussian edge is a Gaussian of half its variance.
    variance_px2 = 2.0 * spread_px2 - SMOOTHING_PX**2
    return replace(
        line,
        x_px=better.x_px,
        y_px=better.y_px,
        normal_rad=better.normal_rad,
        sigma_px=sqrt(max(variance_px2, 0.1)),
    )


def _trimmed(line: EdgeSegment, rows: int, cols: int) -> EdgeSegment:
    """Trim ends that are corners; an end at which the edge leaves the frame stays."""
    whole_px = _whole_corner_px(line.sigma_px)
    corner = max(corner_reach(line.sigma_px), min(whole_px, _AFFORDED * line.length_px))
    along = np.array([-sin(line.normal_rad), cos(line.normal_rad)])
    first, last = _ends(line)
    cuts = [
        0.0 if _to_frame_px(end, outwards, rows, cols) < _LEAVES_PX else corner
        for end, outwards in ((first, -along), (last, along))
    ]
    middle = 0.5 * (cuts[0] - cuts[1])
    return replace(
        line,
        x_px=line.x_px - middle * sin(line.normal_rad),
        y_px=line.y_px + middle * cos(line.normal_rad),
        length_px=max(line.length_px - cuts[0] - cuts[1], 4.0),
    )


def _whole_corner_px(sigma_px: float) -> float:
    """How far a corner reaches by a guessed width, which is of the middle of a wide edge alone."""
    spread_px2 = 0.5 * (sigma_px**2 + SMOOTHING_PX**2)
    whole_px2 = float(np.interp(spread_px2, _CUT_PX2, _WHOLE_PX2))
    return float(corner_reach(sqrt(max(2 * whole_px2 - SMOOTHING_PX**2, sigma_px**2))))


def _to_frame_px(end: FloatArray, outwards: FloatArray, rows: int, cols: int) -> float:
    """How far it is from the end of a line, on along it, to the outermost pixels' centres."""
    ways = []
    for place, step, last in zip(
        end.tolist(), outwards.tolist(), (cols - 1, rows - 1), strict=True
    ):
        room = last - place if step > 0 else place
        ways.append(room / abs(step) if step else inf)
    return min(ways)


def _clear_pieces(line: EdgeSegment, ridge_points: FloatArray, cell_px: float) -> list[EdgeSegment]:
    """Pieces of an edge, each with the band about it that no other edge reaches.

    The edge is interrupted where another one crosses it or leaves too narrow a band.
    """
    widest = band_half_width(line.sigma_px)
    narrowest = _NARROWEST_SIGMAS * line.sigma_px + _NARROWEST_EXTRA_PX
    nearest, tail = _nearest(line, ridge_points), corner_reach(line.sigma_px)
    if nearest.min() >= widest + tail:
        pieces = line.pieces(cell_px)
        parts = np.array_split(nearest, len(pieces)) if len(pieces) > 1 else [nearest]
        return [
            replace(piece, clearance_px=float(part.min()) - tail)
            for piece, part in zip(pieces, parts, strict=True)
        ]
    return [
        _widened(piece, ridge_points, (widest, 0.5 * (widest + narrowest)))
        for stretch in _clear_stretches(line, nearest, narrowest)
        for piece in stretch.pieces(cell_px)
    ]


def _widened(
    piece: EdgeSegment, ridge_points: FloatArray, half_widths_px: tuple[float, ...]
) -> EdgeSegment:
    """Most of the piece where that makes room for a wider band, else all of it."""
    nearest = _nearest(piece, ridge_points)
    for half_width in half_widths_px:
        clear = _clear_stretches(piece, nearest, half_width)
        longest = max(clear, key=lambda e: e.length_px, default=None)
        if longest is not None and longest.length_px >= _MOST * piece.length_px:
            return longest
    return replace(piece, clearance_px=float(nearest.min()) - corner_reach(piece.sigma_px))


def _nearest(line: EdgeSegment, ridge_points: FloatArray) -> FloatArray:
    own_px = max(2.5, 1.5 * line.sigma_px)
    return nearest_others(ridge_points, line.line, own_px, _BESIDE_PX)


def _clear_stretches(
    line: EdgeSegment, nearest: FloatArray, half_width_px: float
) -> list[EdgeSegment]:
    """Stretches of an edge that leave a band of this half width clear."""
    tail = corner_reach(line.sigma_px)
    step = line.length_px / len(nearest)
    found = clear_stretches(nearest, half_width_px + tail, ceil(tail / step))
    stretches = []
    for first, last in found.tolist():
        if last - first + 1 == len(nearest):
            stretch = line
        else:
            middle = 0.5 * (first + last + 1 - len(nearest)) * step
            length = (last - first + 1) * step
            if length < SHORTEST_PX:
                continue
            stretch = _part(line, middle, length)
        clearance = float(nearest[first : last + 1].min()) - tail
        stretches.append(replace(stretch, clearance_px=clearance))
    return stretches


def _part(line: EdgeSegment, middle_px: float, length_px: float) -> EdgeSegment:
    """The part of a line that is so long, about a position along it."""
    return replace(
        line,
        x_px=line.x_px - middle_px * sin(line.normal_rad),
        y_px=line.y_px + middle_px * cos(line.normal_rad),
        length_px=length_px,
        found_length_px=length_px,
    )
