"""The limit that is expected of comparisons at any zoom, from curves of d'."""

from dataclasses import dataclass

import numpy as np

_SLACK = 1.03
"""Registration and tilt move a zoom by so much from the one that was meant."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LimitCurve:
    """Expected limits of the change of a curve of d', by zoom.

    Parameters
    ----------
    zoom
        Rising, from 1.
    spot_sigma_px
        Width with which the follow-up shows the change, in its pixels.
    dn_per_height
        Amplitude, as the follow-up shows it, by which the change stands out by one standard
        deviation; infinite where it is not found.
    noise_dn
        Standard deviation of the noise that was assumed in either photograph.
    """

    zoom: tuple[float, ...]
    spot_sigma_px: tuple[float, ...]
    dn_per_height: tuple[float, ...]
    noise_dn: float

    def holds_at(self, zoom: float) -> bool:
        """Whether the curve says anything of a zoom."""
        return self.zoom[0] / _SLACK <= zoom <= self.zoom[-1] * _SLACK

    def spot_at(self, zoom: float) -> float:
        """Width with which a follow-up shows the change."""
        return float(np.interp(zoom, self.zoom, self.spot_sigma_px))

    def limit_at(self, zoom: float) -> float:
        """Amplitude by which it stands out by one standard deviation: 1/d' is linear in zoom."""
        return float(np.interp(zoom, self.zoom, self.dn_per_height))
