"""Where an edge lies in an image, and the raw pixels around it."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

__all__ = ["EdgeSegment", "EdgeWindow", "edge_window"]

Array = NDArray[np.float64]

_BAND_SIGMAS = 6.0
_BAND_EXTRA_PX = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeSegment:
    """A straight piece of edge, as found: good to about a tenth of a pixel.

    ``normal_rad`` is the angle of the normal from the dark to the bright side against +x,
    y down. ``length_px`` is what may be fitted (ends at corners are trimmed off),
    ``found_length_px`` what was found. Nothing else lies within ``clearance_px`` of the edge.
    """

    x_px: float
    y_px: float
    normal_rad: float
    length_px: float
    found_length_px: float
    sigma_px: float
    clearance_px: float = np.inf

    def pieces(self, longest_px: float) -> list["EdgeSegment"]:
        """Cut into equal pieces of about ``longest_px``, at least one."""
        count = max(1, round(self.length_px / longest_px))
        length = self.length_px / count
        along_x, along_y = -np.sin(self.normal_rad), np.cos(self.normal_rad)
        places = (np.arange(count) - (count - 1) / 2) * length
        return [
            replace(
                self,
                x_px=float(self.x_px + t * along_x),
                y_px=float(self.y_px + t * along_y),
                length_px=length,
                found_length_px=self.found_length_px if count == 1 else length,
            )
            for t in places
        ]


@dataclass(frozen=True, slots=True, kw_only=True)
class EdgeWindow:
    """Raw pixels near an edge; ``x`` and ``y`` in px from its middle, each shape ``(n,)``."""

    x: Array
    y: Array
    values: Array
    centre_x_px: float
    centre_y_px: float
    normal_rad: float
    half_length_px: float
    side_levels: tuple[float, float]
    smooth_levels: Array
    is_clipped: bool


def edge_window(image_dn: Array, segment: EdgeSegment, sigma_px: float) -> EdgeWindow:
    """Collect the pixels within 6 sigma + 3 px of the edge, as far as nothing else is near.

    Parameters
    ----------
    image_dn
        Shape ``(rows, cols)``.
    segment
        The edge.
    sigma_px
        Its total width, or a guess.

    Returns
    -------
    EdgeWindow
        ``smooth_levels`` is a noise-free guess of each pixel's level, for the noise weights;
        ``is_clipped`` says that another edge limits the band.
    """
    rows, cols = image_dn.shape
    half_width = _BAND_SIGMAS * sigma_px + _BAND_EXTRA_PX
    is_clipped = half_width > segment.clearance_px
    half_width = min(half_width, segment.clearance_px)
    half_length = 0.5 * segment.length_px
    c, s = float(np.cos(segment.normal_rad)), float(np.sin(segment.normal_rad))
    reach_x = half_width * abs(c) + half_length * abs(s)
    reach_y = half_width * abs(s) + half_length * abs(c)
    left = max(int(np.ceil(segment.x_px - reach_x)), 0)
    right = min(int(np.floor(segment.x_px + reach_x)), cols - 1)
    top = max(int(np.ceil(segment.y_px - reach_y)), 0)
    bottom = min(int(np.floor(segment.y_px + reach_y)), rows - 1)
    x = np.arange(left, right + 1) - segment.x_px
    y = (np.arange(top, bottom + 1) - segment.y_px)[:, None]
    across = c * x + s * y
    along = -s * x + c * y
    inside = (np.abs(across) <= half_width) & (np.abs(along) <= half_length)
    picked_rows, picked_cols = np.nonzero(inside)
    values = image_dn[top : bottom + 1, left : right + 1][inside].astype(np.float64)
    across = across[inside]
    low, high = _side_levels(values, across, sigma_px)
    rise = np.clip(0.5 + across / (4.0 * max(sigma_px, 0.3)), 0.0, 1.0)
    return EdgeWindow(
        x=x[picked_cols],
        y=y[picked_rows, 0],
        values=values,
        centre_x_px=segment.x_px,
        centre_y_px=segment.y_px,
        normal_rad=segment.normal_rad,
        half_length_px=half_length,
        side_levels=(low, high),
        smooth_levels=low + (high - low) * rise,
        is_clipped=is_clipped,
    )


def _side_levels(values: Array, across: Array, sigma_px: float) -> tuple[float, float]:
    levels = []
    for side in (-across, across):
        far = values[side > 1.5 * sigma_px]
        if far.size == 0:
            far = values[side > 0]
        levels.append(float(np.mean(far)) if far.size else 0.0)
    return levels[0], levels[1]
