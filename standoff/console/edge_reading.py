"""The edge in a region of one frame, measured as `calibration` measures it."""

import math
import re
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from acquisition.focus import Region
from calibration.choices import Pattern
from calibration.edges import EdgeImage, EdgeMeasurement, edges_of_image, plane_places
from calibration.sharpness import lp_per_mm, reported_mtf50
from simulation.arrays import FloatArray
from standoff.console.frames import LiveFrame

PROFILE_POINTS = 64
PROFILE_SIGMAS = 5.0
SAME_LINE_DEG, SAME_LINE_PX, SAME_LINE_GAP = 3.0, 3.0, 0.25
"""A long edge is measured in pieces: they differ by no more than this in direction and beside the
line, and the gap between them is no more than this share of them."""

WIDTH_ERR, SURE_LENGTH_PX = 0.011, 150.0
"""Largest relative standard error of the width of a short edge; of a longer one, the square of its
length over this. The borders of things in photographs and prints are straight and even over 7 to
24 px, and what is not even about them makes their width vague: of 77 that no other sign gives away,
74 have more than 0.018 and none less than (length / 141 px)^2. Photographed edges from an SNR of 10
on have less."""

LEAST_SIGMA_PX = 0.2
"""A square pixel alone has 0.29: what is narrower is a stair of whole pixels."""

VOTES = 5
"""Readings of which most decide whether there is an edge, so that it does not flicker."""

_BAYER = re.compile(r"Bayer(RG|GR|GB|BG)")
_PATTERNS: dict[str, Pattern] = {"RG": "RGGB", "GR": "GRBG", "GB": "GBRG", "BG": "BGGR"}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class EdgeReading:
    """The longest edge that can be measured in a region of one frame.

    ``sigma_px`` is the width with the pixel, as `calibration` reports it; errors are standard
    errors of this one frame. ``flags`` are what `calibration` remarks on it; ``edges`` counts
    those of the region, a long one in pieces once. ``distance_px`` and ``levels`` are the edge
    spread function, levels from 0 (dark) to 1.
    """

    sigma_px: float
    sigma_err_px: float
    mtf50_cy_per_px: float
    mtf50_err_cy_per_px: float | None
    mtf50_lp_per_mm: float | None
    angle_deg: float
    edges: int
    flags: tuple[str, ...]
    distance_px: FloatArray
    levels: FloatArray


def read_edge(
    frame: LiveFrame, region: Region, pixel_pitch_um: float | None
) -> tuple[EdgeReading | None, str]:
    """Measure the longest edge of a region of one frame; without one, say why not.

    Of a colour camera, the first green pixels of the mosaic are measured.
    """
    try:
        source = edge_source(frame, region)
    except ValueError:
        return None, "the region is outside the picture: choose it again"
    return edge_in(source, pixel_pitch_um)


def edge_source(frame: LiveFrame, region: Region) -> EdgeImage:
    """The pixels of a region, those of green where they have colours."""
    settings = frame.settings
    light_dn = region.cut(frame.image_dn).astype(np.float64) - settings.black_level_dn
    saturation_dn = settings.max_level_dn - settings.black_level_dn
    bayer = _BAYER.match(settings.pixel_format)
    if bayer is None:
        return EdgeImage(name="live", image_dn=light_dn, saturation_dn=saturation_dn)
    green = next(p for p in plane_places(_PATTERNS[bayer[1]]) if p.colour == "green")
    # The region may begin at any pixel of the mosaic.
    first_x = (green.first_x_px - region.x_px) % 2
    first_y = (green.first_y_px - region.y_px) % 2
    return EdgeImage(
        name="live",
        image_dn=np.ascontiguousarray(light_dn[first_y::2, first_x::2]),
        saturation_dn=saturation_dn,
        pitch_px=2,
        first_x_px=first_x,
        first_y_px=first_y,
    )


def edge_in(source: EdgeImage, pixel_pitch_um: float | None) -> tuple[EdgeReading | None, str]:
    """Measure the longest edge of some pixels; without one, say why not."""
    edges = edges_of_image(source)
    usable = [edge for edge in edges if edge.is_used]
    used = [edge for edge in usable if _is_certain(edge, source.pitch_px)]
    if not usable:
        return None, _why_not(edges)
    if not used:
        return None, (
            "no straight edge is certain: what is there is too short or too noisy to distinguish "
            "from a texture; make the region larger, or expose more"
        )
    longest = max(used, key=lambda edge: edge.length_px)
    return _reading(longest, count_edges(used), pixel_pitch_um), ""


class SteadyEdge:
    """Whether there is an edge, by most of the last readings: a doubtful one does not flicker."""

    def __init__(self) -> None:
        self._seen: deque[bool] = deque(maxlen=VOTES)
        self._is_shown = False
        self._last: EdgeReading | None = None

    def add(self, reading: EdgeReading | None, why_not: str) -> tuple[EdgeReading | None, str]:
        """The newest reading that has an edge, or why there is none."""
        self._seen.append(reading is not None)
        ahead = 2 * sum(self._seen) - len(self._seen)
        self._is_shown = ahead > 0 or (ahead == 0 and self._is_shown)
        if reading is not None:
            self._last = reading
        if not self._is_shown:
            return None, why_not or "no straight edge is certain: it comes and goes"
        return self._last, ""


def _is_certain(edge: EdgeMeasurement, pitch_px: int) -> bool:
    """Whether an edge is too long and too well known to be a bit of a curve or a texture."""
    length_px = edge.length_px / pitch_px
    largest = max(WIDTH_ERR, (length_px / SURE_LENGTH_PX) ** 2)
    is_known = edge.sigma_err_px <= largest * edge.sigma_px
    return edge.sigma_px >= LEAST_SIGMA_PX and is_known


def count_edges(pieces: Sequence[EdgeMeasurement]) -> int:
    """Number of edges that pieces belong to; those that continue one another are one edge."""
    edges: list[list[EdgeMeasurement]] = []
    for piece in pieces:
        joined = [edge for edge in edges if any(_continues(piece, other) for other in edge)]
        edges = [edge for edge in edges if edge not in joined]
        edges.append([piece, *(other for edge in joined for other in edge)])
    return len(edges)


def _continues(one: EdgeMeasurement, other: EdgeMeasurement) -> bool:
    turned_deg = (one.angle_deg - other.angle_deg + 90.0) % 180.0 - 90.0
    if abs(turned_deg) > SAME_LINE_DEG:
        return False
    along_rad = math.radians(other.angle_deg + 0.5 * turned_deg)  # between the two
    right_px, down_px = one.x_px - other.x_px, one.y_px - other.y_px
    along_px = abs(right_px * math.cos(along_rad) + down_px * math.sin(along_rad))
    beside_px = abs(down_px * math.cos(along_rad) - right_px * math.sin(along_rad))
    length_px = 0.5 * (one.length_px + other.length_px)
    return beside_px <= SAME_LINE_PX and along_px <= (1 + SAME_LINE_GAP) * length_px


def _reading(edge: EdgeMeasurement, edges: int, pixel_pitch_um: float | None) -> EdgeReading:
    mtf50 = reported_mtf50(edge)
    distance_px = levels = np.empty(0)
    if edge.binned is not None:
        distance_px, levels = edge.binned.distance_px, edge.binned.levels
        near = np.flatnonzero(np.abs(distance_px) <= PROFILE_SIGMAS * edge.sigma_px)
        near = near[:: max(1, -(-near.size // PROFILE_POINTS))]
        distance_px, levels = distance_px[near], levels[near]
    return EdgeReading(
        sigma_px=edge.sigma_px,
        sigma_err_px=edge.sigma_err_px,
        mtf50_cy_per_px=mtf50.cy_per_px,
        mtf50_err_cy_per_px=mtf50.err_cy_per_px,
        mtf50_lp_per_mm=(
            None if pixel_pitch_um is None else lp_per_mm(mtf50.cy_per_px, pixel_pitch_um)
        ),
        angle_deg=edge.angle_deg,
        edges=edges,
        flags=edge.flags,
        distance_px=distance_px,
        levels=levels,
    )


def _why_not(edges: list[EdgeMeasurement]) -> str:
    flags = {flag for edge in edges for flag in edge.flags}
    if "saturated" in flags:
        return "the edge is saturated: expose less"
    if "uneven" in flags:
        return "no straight edge in the region: the levels along it are uneven"
    if "curved" in flags:
        return "no straight edge in the region: it is curved"
    if "too_noisy" in flags:
        return "the edge is too noisy: expose more"
    if "too_short" in flags:
        return "the edge is too short: make the region larger"
    return "no straight edge in the region"
