"""Which edges of a photograph belong to a target, and which to the scene beside it.

A target is a printed pattern: many edges of the same two levels that meet in corners. Levels are
compared between neighbours, so that the light may fall off over the frame, and directions with
those nearby, so that perspective may turn them; an edge far wider than the pattern's near by is no
part of it. Where no such pattern stands out, all edges are the target's: one slanted edge, a fan of
edges, or a chart of a few large patches.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calibration.edge_search.segments import EdgeSegment, corner_reach
from calibration.robust import robust_sigma
from simulation.arrays import BoolArray, FloatArray, IntArray

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

    Parameters
    ----------
    segments
        The edges of one photograph.
    levels_dn
        Their dark and bright levels, shape ``(n, 2)``.

    Returns
    -------
    ndarray of bool, shape (n,)
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
    near, _ = _nearest(edges.middle[chosen], edges.middle[chosen], _NEIGHBOURS + 1)
    links = np.column_stack([np.repeat(chosen, _NEIGHBOURS), chosen[near[:, 1:]].ravel()])
    links = np.concatenate([corners, links[_are_alike(edges, links)]])
    group = _groups(links, count)
    sizes = np.bincount(group[chosen], minlength=count)
    largest = int(sizes.argmax())
    if sizes[largest] < max(_LEAST_EDGES, _LEAST_SHARE * len(chosen)):
        return None
    return np.asarray(has_corner & (group == largest))


def _nearest(points: FloatArray, to: FloatArray, count: int) -> tuple[IntArray, FloatArray]:
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
    near, _ = _nearest(edges.middle[chosen], edges.middle, _NEIGHBOURS)
    ratio = edges.sigma_px / np.median(edges.sigma_px[chosen[near]], axis=1)
    scatter = robust_sigma(ratio[chosen] - 1.0)
    least = np.where(pattern, _WIDER_WITH_CORNER, _WIDER)
    return np.asarray(ratio > np.maximum(least, 1.0 + _WIDER_SIGMAS * scatter))


def _like_neighbours(edges: _Edges, pattern: BoolArray) -> tuple[BoolArray, BoolArray]:
    """Whether an edge is near the pattern and has its levels, and whether it has its directions."""
    chosen = np.flatnonzero(pattern)
    near, distance = _nearest(edges.middle[chosen], edges.middle, _NEIGHBOURS)
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
