"""Find all straight edges of an image, at any angle.

Ridges of the gradient (Canny's non-maximum suppression and hysteresis) are grown into regions
of one direction; each region gets a line by total least squares weighted with the squared
gradient; collinear pieces are joined; what stands too near is kept out of the fit's band.
"""

from dataclasses import dataclass, replace
from math import atan2, cos, hypot, pi, sin, sqrt

import cv2
import numpy as np
from numba import njit
from numpy.typing import NDArray

from calibration.edge_segments import EdgeSegment

__all__ = ["find_edges"]

Array = NDArray[np.float64]

_SMOOTHING_PX = 1.0
_RAYLEIGH_MEDIAN = 1.1774100225154747  # median of |gradient| over its sigma, in pure noise
_NOISE_HIGH = 5.0
_NOISE_LOW = 2.5
_LEAST_OF_STRONGEST = 0.04
_DIRECTION_TOLERANCE_RAD = np.deg2rad(22.5)
_SHORTEST_REGION_PX = 8
_SHORTEST_EDGE_PX = 12.0
_SMALLEST_NEIGHBOUR_PX = 6
_LARGEST_SAGITTA = 0.02  # of the length: a bend the fit's curvature takes up
_ROUGHEST_PX = 0.7  # rms distance of the ridge from its line
_LINE_BAND_PX = 3.0
_LINE_ROUNDS = 3
_JOINED_OFFSET_PX = 1.5
_CORNER_SIGMAS = 2.5
_CELL_PX = 128.0
_CANNY_LARGEST = 26_000.0  # cv2.Canny takes 79109 times this in 32 bits: 27 145 would overflow


@dataclass(frozen=True, slots=True)
class _Gradient:
    x: NDArray[np.float32]
    y: NDArray[np.float32]
    magnitude: NDArray[np.float32]
    ridge: NDArray[np.bool_]


def find_edges(image_dn: Array, *, cell_px: float = _CELL_PX) -> list[EdgeSegment]:
    """Find straight edges and cut long ones into pieces of about ``cell_px``.

    Parameters
    ----------
    image_dn
        Shape ``(rows, cols)``, finite.
    cell_px
        Length of the pieces: each measures the PSF at its own place in the field.

    Returns
    -------
    list of EdgeSegment
        From top to bottom; empty where there is none.
    """
    rows, cols = image_dn.shape
    if min(rows, cols) < _SHORTEST_REGION_PX or not np.ptp(image_dn) > 0:
        return []
    gradient = _gradient(image_dn)
    ridge_rows, ridge_cols = np.nonzero(gradient.ridge)
    if ridge_rows.size == 0:
        return []
    direction = np.arctan2(gradient.y, gradient.x)
    labels = np.zeros(image_dn.shape, dtype=np.int32)
    count = _grow(gradient.ridge, direction.astype(np.float64), labels, _DIRECTION_TOLERANCE_RAD)
    lines = []
    ordered = np.argsort(labels[ridge_rows, ridge_cols], kind="stable")
    sorted_labels = labels[ridge_rows, ridge_cols][ordered]
    starts = np.searchsorted(sorted_labels, np.arange(1, count + 2))
    for k in range(count):
        members = ordered[starts[k] : starts[k + 1]]
        if members.size >= _SHORTEST_REGION_PX:
            line = _line(gradient, ridge_rows[members], ridge_cols[members])
            if line is not None:
                lines.append(line)
    lines = [line for line in _joined(lines) if line.found_length_px >= _SHORTEST_EDGE_PX]
    # A speck of noise is no neighbour that would spoil a fit.
    region_sizes = np.diff(starts, prepend=0)[sorted_labels]
    solid = ordered[region_sizes >= _SMALLEST_NEIGHBOUR_PX]
    solid = solid[np.argsort(ridge_rows[solid], kind="stable")]
    ridge_points = np.column_stack([ridge_cols[solid], ridge_rows[solid]]).astype(np.float64)
    pieces = []
    for line in lines:
        sized = _sized(gradient, image_dn, line)
        for piece in _trimmed(sized, rows, cols).pieces(cell_px):
            clear = _with_clearance(piece, ridge_points)
            if clear is not None:
                pieces.append(clear)
    return sorted(pieces, key=lambda e: (e.y_px, e.x_px))


def _gradient(image_dn: Array) -> _Gradient:
    spread = float(np.ptp(image_dn))
    scaled = ((image_dn - image_dn.min()) / spread).astype(np.float32)
    # The median takes hot pixels away and leaves edges where they are; fits see the raw image.
    smooth = cv2.GaussianBlur(
        cv2.medianBlur(scaled, 3), (0, 0), _SMOOTHING_PX, borderType=cv2.BORDER_REPLICATE
    )
    gx = cv2.Scharr(smooth, cv2.CV_32F, 1, 0, scale=1 / 32, borderType=cv2.BORDER_REPLICATE)
    gy = cv2.Scharr(smooth, cv2.CV_32F, 0, 1, scale=1 / 32, borderType=cv2.BORDER_REPLICATE)
    magnitude = cv2.magnitude(gx, gy)
    noise = float(np.median(magnitude)) / _RAYLEIGH_MEDIAN
    strongest = float(magnitude.max())
    high = max(_NOISE_HIGH * noise, _LEAST_OF_STRONGEST * strongest)
    low = max(_NOISE_LOW * noise, 0.4 * high)
    to_int16 = _CANNY_LARGEST / strongest
    ridge = cv2.Canny(
        np.rint(gx * to_int16).astype(np.int16),
        np.rint(gy * to_int16).astype(np.int16),
        low * to_int16,
        high * to_int16,
        L2gradient=True,
    )
    return _Gradient(np.asarray(gx), np.asarray(gy), np.asarray(magnitude), ridge > 0)


@njit(cache=True)
def _grow(
    ridge: NDArray[np.bool_], direction: Array, labels: NDArray[np.int32], tolerance: float
) -> int:
    """Label connected ridge pixels whose gradient direction stays near the region's mean."""
    rows, cols = ridge.shape
    stack = np.empty((rows * cols, 2), dtype=np.int32)
    count = 0
    for r0 in range(rows):
        for c0 in range(cols):
            if not ridge[r0, c0] or labels[r0, c0] != 0:
                continue
            count += 1
            labels[r0, c0] = count
            sum_x = cos(direction[r0, c0])
            sum_y = sin(direction[r0, c0])
            stack[0, 0] = r0
            stack[0, 1] = c0
            waiting = 1
            while waiting > 0:
                waiting -= 1
                r, c = stack[waiting, 0], stack[waiting, 1]
                for nr in range(max(r - 1, 0), min(r + 2, rows)):
                    for nc in range(max(c - 1, 0), min(c + 2, cols)):
                        if not ridge[nr, nc] or labels[nr, nc] != 0:
                            continue
                        apart = direction[nr, nc] - atan2(sum_y, sum_x)
                        apart = abs((apart + pi) % (2 * pi) - pi)
                        if apart > tolerance:
                            continue
                        labels[nr, nc] = count
                        sum_x += cos(direction[nr, nc])
                        sum_y += sin(direction[nr, nc])
                        stack[waiting, 0] = nr
                        stack[waiting, 1] = nc
                        waiting += 1
    return count


def _ridge_places(
    gradient: _Gradient, rows: NDArray[np.int64], cols: NDArray[np.int64]
) -> tuple[Array, Array]:
    """Places (x, y) of ridge pixels below the pixel, by a parabola along the nearer axis."""
    x, y = cols.astype(np.float64), rows.astype(np.float64)
    is_steep_x = np.abs(gradient.x[rows, cols]) >= np.abs(gradient.y[rows, cols])
    step_c, step_r = is_steep_x.astype(np.int64), (~is_steep_x).astype(np.int64)
    height, width = gradient.magnitude.shape
    before = gradient.magnitude[np.maximum(rows - step_r, 0), np.maximum(cols - step_c, 0)]
    here = gradient.magnitude[rows, cols]
    after = gradient.magnitude[
        np.minimum(rows + step_r, height - 1), np.minimum(cols + step_c, width - 1)
    ]
    bend = (2.0 * here - before - after).astype(np.float64)
    shift = np.clip(0.5 * (after - before) / np.where(bend > 0, bend, np.inf), -0.5, 0.5)
    return x + shift * step_c, y + shift * step_r


def _line(
    gradient: _Gradient, rows: NDArray[np.int64], cols: NDArray[np.int64]
) -> EdgeSegment | None:
    """Line through a region of ridge pixels, or None where they are no straight edge."""
    x, y = _ridge_places(gradient, rows, cols)
    gx = gradient.x[rows, cols].astype(np.float64)
    gy = gradient.y[rows, cols].astype(np.float64)
    root_weight = np.hypot(gx, gy)
    normal = atan2(float(gy.sum()), float(gx.sum()))
    cx, cy = float(np.mean(x)), float(np.mean(y))
    kept = np.ones(x.size, dtype=np.bool_)
    for _ in range(_LINE_ROUNDS):
        along = -np.sin(normal) * (x - cx) + np.cos(normal) * (y - cy)
        across = np.cos(normal) * (x - cx) + np.sin(normal) * (y - cy)
        if kept.sum() < _SHORTEST_REGION_PX or np.ptp(along[kept]) < _SHORTEST_REGION_PX - 1:
            return None
        slope, shift = np.polyfit(along[kept], across[kept], 1, w=root_weight[kept])
        cx += shift * np.cos(normal)
        cy += shift * np.sin(normal)
        normal -= float(np.arctan(slope))
        # The ridge runs around a corner for its last pixels: they are not of this line.
        away = np.abs(across - slope * along - shift)
        kept = away <= max(_ROUGHEST_PX, 2.5 * float(np.median(away)))
    along = (-np.sin(normal) * (x - cx) + np.cos(normal) * (y - cy))[kept]
    across = (np.cos(normal) * (x - cx) + np.sin(normal) * (y - cy))[kept]
    if along.size < max(_SHORTEST_REGION_PX, 0.6 * x.size):
        return None
    length = float(np.ptp(along))
    bend = np.polyfit(along, across, 2)
    rough = float(np.sqrt(np.mean((across - np.polyval(bend, along)) ** 2)))
    if rough > _ROUGHEST_PX or abs(bend[0]) * length**2 / 4 > max(_LARGEST_SAGITTA * length, 0.5):
        return None
    middle = 0.5 * float(along.max() + along.min())
    return EdgeSegment(
        x_px=float(cx - middle * np.sin(normal)),
        y_px=float(cy + middle * np.cos(normal)),
        normal_rad=float(normal),
        length_px=length + 1.0,
        found_length_px=length + 1.0,
        sigma_px=1.0,
    )


def _ends(line: EdgeSegment) -> tuple[Array, Array]:
    along = np.array([-np.sin(line.normal_rad), np.cos(line.normal_rad)])
    middle = np.array([line.x_px, line.y_px])
    return middle - 0.5 * line.length_px * along, middle + 0.5 * line.length_px * along


def _joined(lines: list[EdgeSegment]) -> list[EdgeSegment]:
    """Join pieces that continue each other across a gap."""
    waiting = sorted(lines, key=lambda e: -e.length_px)
    x, y = np.array([e.x_px for e in waiting]), np.array([e.y_px for e in waiting])
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
            away = np.abs(
                cos(line.normal_rad) * (x - line.x_px) + sin(line.normal_rad) * (y - line.y_px)
            )
            for place in np.flatnonzero(is_free & (away <= _JOINED_OFFSET_PX)).tolist():
                longer = _continuation(line, waiting[place])
                if longer is not None:
                    is_free[place] = False
                    break
        joined.append(line)
    return joined


def _continuation(line: EdgeSegment, other: EdgeSegment) -> EdgeSegment | None:
    """The two as one edge, where ``other`` lies on the prolongation of ``line``."""
    apart = (other.normal_rad - line.normal_rad + pi) % (2 * pi) - pi
    shorter = min(line.length_px, other.length_px)
    if abs(apart) > max(np.deg2rad(2.0), 1.5 / shorter):
        return None
    c, s = cos(line.normal_rad), sin(line.normal_rad)
    places, offsets = [], []
    for x, y in _ends(other):
        places.append(-s * (x - line.x_px) + c * (y - line.y_px))
        offsets.append(abs(c * (x - line.x_px) + s * (y - line.y_px)))
    if max(offsets) > _JOINED_OFFSET_PX:
        return None
    half = 0.5 * line.length_px
    gap = max(min(places) - half, -half - max(places))
    if gap > max(12.0, 0.1 * line.length_px):
        return None
    first, last = min(-half, *places), max(half, *places)
    middle = 0.5 * (first + last)
    return replace(
        line,
        x_px=line.x_px - s * middle,
        y_px=line.y_px + c * middle,
        length_px=last - first,
        found_length_px=last - first,
    )


def _sized(gradient: _Gradient, image_dn: Array, line: EdgeSegment) -> EdgeSegment:
    """Refine the line on all gradient pixels near it, and guess the width of the edge."""
    rows, cols = image_dn.shape
    c, s = cos(line.normal_rad), sin(line.normal_rad)
    reach = 0.5 * line.length_px
    left = max(int(line.x_px - reach * abs(s) - 4), 0)
    right = min(int(line.x_px + reach * abs(s) + 5), cols)
    top = max(int(line.y_px - reach * abs(c) - 4), 0)
    bottom = min(int(line.y_px + reach * abs(c) + 5), rows)
    x = np.arange(left, right) - line.x_px
    y = (np.arange(top, bottom) - line.y_px)[:, None]
    across = c * x + s * y
    along = -s * x + c * y
    inside = (np.abs(across) <= _LINE_BAND_PX) & (np.abs(along) <= reach)
    box = np.s_[top:bottom, left:right]
    slope_across = (c * gradient.x[box] + s * gradient.y[box])[inside]
    weight = np.maximum(slope_across, 0.0).astype(np.float64) ** 2
    if np.count_nonzero(weight) < _SHORTEST_REGION_PX:
        return line
    turn, shift = np.polyfit(along[inside], across[inside], 1, w=np.sqrt(weight))
    distance = across[inside] - turn * along[inside] - shift
    # The squared gradient of a Gaussian edge is a Gaussian of half its variance.
    variance = 2.0 * float(np.average(distance**2, weights=weight)) - _SMOOTHING_PX**2
    return replace(
        line,
        x_px=line.x_px + shift * c,
        y_px=line.y_px + shift * s,
        normal_rad=line.normal_rad - float(np.arctan(turn)),
        sigma_px=sqrt(max(variance, 0.1)),
    )


def _trimmed(line: EdgeSegment, rows: int, cols: int) -> EdgeSegment:
    """Take the ends off where they are corners; an end at the border of the frame stays."""
    corner = _CORNER_SIGMAS * line.sigma_px + 0.5
    first, last = _ends(line)
    cuts = []
    for x, y in (first, last):
        border = min(x, y, cols - 1 - x, rows - 1 - y)
        cuts.append(0.0 if border < 3.0 else corner)
    middle = 0.5 * (cuts[0] - cuts[1])
    return replace(
        line,
        x_px=line.x_px - middle * sin(line.normal_rad),
        y_px=line.y_px + middle * cos(line.normal_rad),
        length_px=max(line.length_px - cuts[0] - cuts[1], 4.0),
    )


def _with_clearance(piece: EdgeSegment, ridge_points: Array) -> EdgeSegment | None:
    """Limit the fit's band to what no other edge reaches; None where nothing is left.

    ``ridge_points`` holds x and y of the ridge pixels, from top to bottom.
    """
    c, s = cos(piece.normal_rad), sin(piece.normal_rad)
    reach = hypot(0.5 * piece.length_px, 40.0)
    first, last = np.searchsorted(ridge_points[:, 1], [piece.y_px - reach, piece.y_px + reach])
    offset = ridge_points[first:last] - (piece.x_px, piece.y_px)
    offset = offset[np.abs(offset[:, 0]) < reach]
    across = np.abs(c * offset[:, 0] + s * offset[:, 1])
    along = np.abs(-s * offset[:, 0] + c * offset[:, 1])
    own = max(2.5, 1.5 * piece.sigma_px)
    others = across[(along <= 0.5 * piece.length_px) & (across > own)]
    if others.size == 0:
        return piece
    clearance = float(others.min()) - 2.5 * piece.sigma_px - 0.5
    if clearance < 2.0 * piece.sigma_px + 1.0:
        return None
    return replace(piece, clearance_px=clearance)
