"""What a comparison would have found: the amplitude that a spot needs at every place."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from analysis.changes.comparison import Comparison
from analysis.changes.detection.chance import FilterWidth
from analysis.changes.detection.levels import DetectionLevel
from analysis.changes.detection.power import POWER, height_for, response
from analysis.detection_limits import DetectionLimit, SpotLimit
from simulation.arrays import BoolArray, Float32Array

_SPOT_SIGMAS_PX = (1.0, 1.5, 3.0, 6.0)
"""Sizes for which the limit is stated, beside the one that is asked for."""

_SAMPLE_PX = 1_000_000


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LimitMaps:
    """Amplitudes at which spots are found as often as asked, on the comparison's grid.

    Parameters
    ----------
    threshold_sd
        Significance beyond which a place counts as changed.
    levels, widths
        In which it is looked for, and their filters as they act on the follow-up.
    valid
        Pixels that were compared.
    followup_px
        Follow-up pixels to one of the grid, along a line.
    change_rgb
        Change of colour of amplitude 1; None in grey.
    errors_dn
        Standard error of an amplitude at each level, allowance included.
    """

    threshold_sd: float
    levels: tuple[DetectionLevel, ...]
    widths: tuple[FilterWidth, ...]
    valid: BoolArray
    followup_px: float
    errors_dn: tuple[Float32Array, ...]
    change_rgb: tuple[float, float, float] | None = None

    @classmethod
    def of(
        cls,
        compared: Comparison,
        levels: Sequence[DetectionLevel],
        threshold_sd: float,
        followup_px: float,
        rgb: tuple[float, float, float] = (1.0, 1.0, 1.0),
    ) -> "LimitMaps":
        """Take what limits detection from a comparison and its levels; in colour, of one change."""
        return cls(
            threshold_sd=threshold_sd,
            levels=tuple(levels),
            widths=tuple(_on_followup(level.filter_width, compared) for level in levels),
            valid=compared.valid,
            followup_px=followup_px,
            errors_dn=tuple(level.error_along(rgb) for level in levels),
            change_rgb=None if levels[0].colours is None else rgb,
        )

    def height_for(self, power: float) -> float:
        """Significance that a spot must have by itself to be found so often."""
        return height_for(power, self.threshold_sd, self.widths[0].planes)

    def limit_dn(self, spot_sigma_px: float, power: float = POWER, every: int = 1) -> Float32Array:
        """Amplitude of a spot in the follow-up's levels; infinite where nothing was compared.

        Parameters
        ----------
        spot_sigma_px
            Its width as the follow-up shows it, in follow-up pixels.
        power
            How often it is found.
        every
            Every so many pixels of the grid, along both of its sides.
        """
        height = self.height_for(power)
        sigma = np.array(spot_sigma_px / self.followup_px)
        valid = self.valid[::every, ::every]
        least = np.full(valid.shape, np.inf, dtype=np.float32)
        levels = zip(self.levels, self.widths, self.errors_dn, strict=True)
        for level, width, error_dn in levels:
            factor = np.float32(height / float(response(sigma, width)))
            np.minimum(least, level.sd_on_grid(error_dn, valid.shape, every) * factor, out=least)
        least[~valid] = np.inf
        return least


def _on_followup(width: FilterWidth, compared: Comparison) -> FilterWidth:
    """The filter that acts on the follow-up, smoothed otherwise than the grid's own photograph."""
    wider = width.width_px**2 - compared.smoothing_px**2
    return FilterWidth(
        width_px=(compared.followup_smoothing_px**2 + wider) ** 0.5,
        step_px=width.step_px,
        planes=width.planes,
    )


def detection_limit(
    maps: LimitMaps, spot_sigma_px: float, contrast_dn: float | None
) -> DetectionLimit:
    """State the limits over the compared pixels.

    Parameters
    ----------
    maps
        Of the comparison.
    spot_sigma_px
        Width of the spots for which the limit is mapped; it is stated for others too.
    contrast_dn
        Amplitude for which the share of the pixels is told where the limit is lower.
    """
    # Limits vary as slowly as the filters are wide.
    every = max(round((maps.valid.size / _SAMPLE_PX) ** 0.5), 1)
    spots = []
    for sigma_px in sorted({*_SPOT_SIGMAS_PX, spot_sigma_px}):
        limit = maps.limit_dn(sigma_px, every=every)
        if not np.isfinite(limit).any():
            # Of drawings so little is compared that a sample may miss it.
            limit = maps.limit_dn(sigma_px)
        limit = limit[np.isfinite(limit)]
        reached = None
        if contrast_dn is not None:
            reached = float(np.mean(limit <= contrast_dn)) if len(limit) else 0.0
        median, high, worst = np.quantile(limit, [0.5, 0.95, 1.0]).tolist()
        spots.append(
            SpotLimit(
                spot_sigma_px=sigma_px,
                median_dn=median,
                p95_dn=high,
                worst_dn=worst,
                reached_fraction=reached,
            )
        )
    return DetectionLimit(
        power=POWER,
        spots=tuple(spots),
        contrast_dn=contrast_dn,
        map_spot_sigma_px=spot_sigma_px,
        change_rgb=maps.change_rgb,
    )
