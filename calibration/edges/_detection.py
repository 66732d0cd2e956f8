"""Find all straight edges of an image, at any angle, and tell those of a target from its scene.

Ridges of the gradient (Canny's non-maximum suppression and hysteresis) are grown into regions of
one direction; each region gets a line by total least squares weighted with the squared gradient;
collinear pieces are joined; what is too near is kept out of the fit's band.

A target is a printed pattern: many edges of the same two levels that meet in corners. Levels are
compared between neighbours, so that the light may fall off over the frame, and directions with
those nearby, so that perspective may turn them; an edge far wider than the pattern's near by is no
part of it. Where no such pattern stands out, all edges are the target's: one slanted edge, a fan of
edges, or a chart of a few large patches.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import ceil, cos, erf, inf, pi, sin, sqrt

import numpy as np

from calibration.edges._ridges import (
    PROFILE_PX,
    SHORTEST_REGION_PX,
    SMOOTHING_PX,
    ArtefactGradient,
    Gradient,
    RidgePixels,
    find_ridges,
    refined,
)
from calibration.edges._segments import (
    SHORTEST_PX,
    EdgeLine,
    EdgeSegment,
    band_half_width,
    corner_reach,
)
from calibration.robust import robust_sigma
from simulation.arrays import BoolArray, FloatArray, IntArray
from simulation.compiled import compiled


@compiled()
def _nearest_others(
    points: FloatArray, line: EdgeLine, own_px: float, reach_px: float
) -> FloatArray:
    """Distance to the nearest ridge beside an edge that is not its own, in steps along it.

    One per px of the edge's length, infinite where nothing is within reach. ``points`` are x and y
    of ridge pixels from top to bottom; those within ``own_px`` are the edge's.
    """
    c, s = cos(line.normal_rad), sin(line.normal_rad)
    length = 2.0 * line.half_length_px
    count = max(int(np.ceil(length)), 1)
    nearest = np.full(count, np.inf)
    reach_x = reach_px * abs(c) + line.half_length_px * abs(s)
    reach_y = reach_px * abs(s) + line.half_length_px * abs(c)
    for i in range(np.searchsorted(points[:, 1], line.y_px - reach_y), len(points)):
        dx, dy = points[i, 0] - line.x_px, points[i, 1] - line.y_px
        if dy > reach_y:
            break
        if abs(dx) > reach_x:
            continue
        across, along = abs(c * dx + s * dy), -s * dx + c * dy
        if across <= own_px or across > reach_px or abs(along) > line.half_length_px:
            continue
        k = min(int((along + line.half_length_px) / length * count), count - 1)
        nearest[k] = min(nearest[k], across)
    return nearest


@compiled()
def _stretches_beyond(nearest: FloatArray, least_px: float, margin_steps: int) -> IntArray:
    """First and last step of each stretch with nothing nearer than ``least_px``; shape ``(n, 2)``.

    A stretch ends ``margin_steps`` before what is too near.
    """
    count = len(nearest)
    stretches = np.empty((count + 1, 2), np.int64)
    found, first, blocked = 0, 0, -1
    for k in range(count + 1):
        if k < count and nearest[k] >= least_px:
            continue
        last = k - 1 - margin_steps if k < count else count - 1
        first = 0 if blocked < 0 else blocked + 1 + margin_steps
        if last >= first:
            stretches[found] = first, last
            found += 1
        blocked = k
    return stretches[:found]


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
    """Find straight edges, from top to bottom, and cut long ones into pieces of about ``cell_px``.

    Ridges weaker than the ``artefacts`` of compression are no edges, nor near to one.
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
    return _part(line, 0.5 * (first + last), last - first)


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
    middle, length = 0.5 * (cuts[0] - cuts[1]), max(line.length_px - cuts[0] - cuts[1], 4.0)
    return replace(_part(line, middle, length), found_length_px=line.found_length_px)


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
    return _nearest_others(ridge_points, line.line, own_px, _BESIDE_PX)


def _clear_stretches(
    line: EdgeSegment, nearest: FloatArray, half_width_px: float
) -> list[EdgeSegment]:
    """Stretches of an edge that leave a band of this half width clear."""
    tail = corner_reach(line.sigma_px)
    step = line.length_px / len(nearest)
    found = _stretches_beyond(nearest, half_width_px + tail, ceil(tail / step))
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


_LEAST_EDGES = 12  # three squares: fewer are no pattern
_LEAST_SHARE = 0.5  # of the edges with corners: two patterns of one size are none
_LEVEL_APART = 0.3  # of the contrast: light falls off less from one square to the next
_CORNER_SINE = 0.5  # sides meet at 30 degrees or more
_CORNER_SLACK_PX = 4.0  # by which ends before a corner are uncertain
_TURNED_DEG = 12.0  # perspective turns lines less from one square to the next
_NEIGHBOURS = 8
_FARTHEST = 2.5  # times the distance of the pattern's own neighbours: the next square, half seen
# Times the pattern's own near by: shadows, and what is far out of focus. Sides of real boards
# reach 1.7; an edge with the levels and corners of the pattern is its own unless beyond doubt.
_WIDER, _WIDER_WITH_CORNER = 1.6, 2.0
_WIDER_SIGMAS = 6.0
_OTHER_PATCH_EDGES = 4  # a square of other levels, aligned with the pattern, belongs to it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Edges:
    """Edges as arrays: middle and unit direction ``(n, 2)`` in x, y; the rest ``(n,)``."""

    middle: FloatArray
    along: FloatArray
    half_px: FloatArray
    sigma_px: FloatArray
    reach_px: FloatArray
    levels_dn: FloatArray
    contrast_dn: FloatArray

    @property
    def ends(self) -> FloatArray:
        """First and then last ends, shape ``(2 n, 2)``."""
        step = self.half_px[:, None] * self.along
        return np.concatenate([self.middle - step, self.middle + step])


def beside_target(segments: Sequence[EdgeSegment], levels_dn: FloatArray) -> BoolArray:
    """Which edges belong to the scene beside a target; none where no target stands out.

    Levels are dark and bright, shape ``(n, 2)``; the answer has shape ``(n,)``.
    """
    count = len(segments)
    nothing = np.zeros(count, np.bool_)
    if count < _LEAST_EDGES:
        return nothing
    edges = _edges(segments, np.asarray(levels_dn, dtype=np.float64))
    corners = _corners(edges)
    pattern = _pattern(edges, corners)
    if pattern is None:
        return nothing
    beside = ~pattern & ~_within(edges, pattern)
    is_next, is_aligned = _like_neighbours(edges, pattern)
    beside &= ~(is_next & is_aligned)
    group = _groups(corners, count)
    sizes = np.bincount(group[is_aligned], minlength=count)
    beside &= ~(is_aligned & (sizes[group] >= _OTHER_PATCH_EDGES))
    return np.asarray(beside | _is_wider(edges, pattern))


_SPOKES_LEAST = 8
_SPOKE_TURNS, _SPOKE_TURNS_LEAST = 8, 4
_SPOKE_SLACK_PX, _SPOKE_SLACK = 2.0, 0.02  # and of the distance to where they meet
_SPOKE_PAIRS = 400
_SPOKES_RIM = 1.1  # of where most spokes end
_SPOKES_SHARE = 0.5  # of all edges inside the rim
_SPOKES_CROSS = 0.5  # sine of their angle: nearly parallel lines do not say where they meet


def star_spokes(segments: Sequence[EdgeSegment]) -> BoolArray:
    """Which edges are of a Siemens star: lines of many directions through one point, and its rim.

    Inside the rim, half of the edges or more are spokes. The answer has shape ``(n,)``.
    """
    count = len(segments)
    nothing = np.zeros(count, np.bool_)
    if count < _SPOKES_LEAST:
        return nothing
    x, y, normal, length = np.array(
        [(s.x_px, s.y_px, s.normal_rad, s.length_px) for s in segments]
    ).T
    across = np.column_stack([np.cos(normal), np.sin(normal)])
    offset = np.sum(across * np.column_stack([x, y]), axis=1)
    first, second = np.triu_indices(count, 1)
    chosen = np.abs(np.sin(normal[first] - normal[second])) > _SPOKES_CROSS
    pairs = np.column_stack([first[chosen], second[chosen]])
    best, reach_px = nothing, np.zeros(count)
    for pair in pairs[:: max(1, len(pairs) // _SPOKE_PAIRS)]:
        met = np.linalg.solve(across[pair], offset[pair])
        apart = np.hypot(x - met[0], y - met[1])
        slack = _SPOKE_SLACK_PX + _SPOKE_SLACK * apart
        through = (np.abs(across @ met - offset) < slack) & (apart > 0.5 * length)
        if through.sum() > best.sum():
            best, reach_px = through, apart
    turns = np.floor(normal[best] % np.pi / np.pi * _SPOKE_TURNS)
    if best.sum() < _SPOKES_LEAST or np.unique(turns).size < _SPOKE_TURNS_LEAST:
        return nothing
    # Not the farthest: a line of something else may pass through the centre.
    rim_px = _SPOKES_RIM * float(np.percentile((reach_px + 0.5 * length)[best], 75))
    inside = np.asarray(reach_px <= rim_px)
    return inside if best.sum() >= _SPOKES_SHARE * inside.sum() else nothing


def _edges(segments: Sequence[EdgeSegment], levels_dn: FloatArray) -> _Edges:
    x, y, normal, length, sigma = np.array(
        [(s.x_px, s.y_px, s.normal_rad, s.length_px, s.sigma_px) for s in segments]
    ).T
    reach = np.array([corner_reach(s.sigma_px) for s in segments])
    return _Edges(
        middle=np.column_stack([x, y]),
        along=np.column_stack([-np.sin(normal), np.cos(normal)]),
        half_px=0.5 * length,
        sigma_px=sigma,
        reach_px=reach + _CORNER_SLACK_PX,
        levels_dn=levels_dn,
        contrast_dn=levels_dn[:, 1] - levels_dn[:, 0],
    )


def _groups(pairs: IntArray, count: int) -> IntArray:
    """Number of the group that each edge is in, of edges that pairs link."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    links = np.ones(len(pairs), np.int8), (pairs[:, 0], pairs[:, 1])
    return np.asarray(
        connected_components(coo_array(links, shape=(count, count)), directed=False)[1]
    )


def _are_alike(edges: _Edges, pairs: IntArray) -> BoolArray:
    """Whether both levels of two edges are the same, but for the light."""
    i, j = pairs.T
    apart = np.abs(edges.levels_dn[i] - edges.levels_dn[j]).max(axis=1)
    least = np.minimum(edges.contrast_dn[i], edges.contrast_dn[j])
    return np.asarray(apart <= _LEVEL_APART * least)


def _corners(edges: _Edges) -> IntArray:
    """Pairs of edges of the same levels that meet in a corner, shape ``(pairs, 2)``."""
    from scipy.spatial import KDTree  # with what follows .1 s, where there are enough edges

    count = len(edges.half_px)
    # Ends at a corner of 90 degrees are sqrt(2) times their distance from it apart.
    widest = 2.0 * float(np.median(edges.reach_px))
    ends = KDTree(edges.ends).query_pairs(widest, output_type="ndarray")
    pairs = np.unique(np.sort(ends % count, axis=1), axis=0)
    i, j = pairs.T
    (ux, uy), (vx, vy) = edges.along[i].T, edges.along[j].T
    sine = ux * vy - uy * vx
    is_corner = (np.abs(sine) >= _CORNER_SINE) & _are_alike(edges, pairs)
    safe = np.where(is_corner, sine, 1.0)
    dx, dy = (edges.middle[j] - edges.middle[i]).T
    # Where the lines cross, along each from its middle.
    for edge, position in ((i, (dx * vy - dy * vx) / safe), (j, (dx * uy - dy * ux) / safe)):
        beyond = np.abs(position) - edges.half_px[edge]
        is_corner &= (beyond >= -_CORNER_SLACK_PX) & (beyond <= edges.reach_px[edge])
    return np.asarray(pairs[is_corner])


def _pattern(edges: _Edges, corners: IntArray) -> BoolArray | None:
    """The most numerous edges of the same levels with corners; None if they do not stand out."""
    count = len(edges.half_px)
    has_corner = np.zeros(count, np.bool_)
    has_corner[corners] = True
    chosen = np.flatnonzero(has_corner)
    if len(chosen) < _LEAST_EDGES:
        return None
    near, _ = _neighbours(edges.middle[chosen], edges.middle[chosen], _NEIGHBOURS + 1)
    links = np.column_stack([np.repeat(chosen, _NEIGHBOURS), chosen[near[:, 1:]].ravel()])
    links = np.concatenate([corners, links[_are_alike(edges, links)]])
    group = _groups(links, count)
    sizes = np.bincount(group[chosen], minlength=count)
    largest = int(sizes.argmax())
    if sizes[largest] < max(_LEAST_EDGES, _LEAST_SHARE * len(chosen)):
        return None
    return np.asarray(has_corner & (group == largest))


def _neighbours(points: FloatArray, to: FloatArray, count: int) -> tuple[IntArray, FloatArray]:
    """Indices of the nearest ``points`` to each of others, and their distances."""
    from scipy.spatial import KDTree

    distance, near = KDTree(points).query(to, count)
    return np.asarray(near, np.int64), np.asarray(distance, np.float64)


def _within(edges: _Edges, pattern: BoolArray) -> BoolArray:
    """Whether the middle of an edge is in the area of the pattern."""
    from scipy.spatial import ConvexHull

    ends = edges.ends[np.tile(pattern, 2)]
    planes = ConvexHull(ends, qhull_options="QJ").equations
    away = edges.middle @ planes[:, :2].T + planes[:, 2]
    return np.asarray(away.max(axis=1) <= 0)


def _is_wider(edges: _Edges, pattern: BoolArray) -> BoolArray:
    """Whether an edge is far wider than those of the pattern near by, beyond their scatter."""
    chosen = np.flatnonzero(pattern)
    near, _ = _neighbours(edges.middle[chosen], edges.middle, _NEIGHBOURS)
    ratio = edges.sigma_px / np.median(edges.sigma_px[chosen[near]], axis=1)
    scatter = robust_sigma(ratio[chosen] - 1.0)
    least = np.where(pattern, _WIDER_WITH_CORNER, _WIDER)
    return np.asarray(ratio > np.maximum(least, 1.0 + _WIDER_SIGMAS * scatter))


def _like_neighbours(edges: _Edges, pattern: BoolArray) -> tuple[BoolArray, BoolArray]:
    """Whether an edge is near the pattern and has its levels, and whether it has its directions."""
    chosen = np.flatnonzero(pattern)
    near, distance = _neighbours(edges.middle[chosen], edges.middle, _NEIGHBOURS)
    reach = _FARTHEST * float(np.median(distance[chosen, -1]))
    nearest = chosen[near]
    levels = np.median(edges.levels_dn[nearest], axis=1)
    contrast = np.minimum(levels[:, 1] - levels[:, 0], edges.contrast_dn)
    is_alike = np.abs(edges.levels_dn - levels).max(axis=1) <= _LEVEL_APART * contrast
    ux, uy = edges.along.T
    vx, vy = np.moveaxis(edges.along[nearest], -1, 0)
    sine = np.abs(ux[:, None] * vy - uy[:, None] * vx)
    is_aligned = sine.min(axis=1) <= np.sin(np.deg2rad(_TURNED_DEG))
    return np.asarray(is_alike & (distance[:, -1] <= reach)), np.asarray(is_aligned)
