"""The share of false ones among the changes that were found.

Y. Benjamini and Y. Hochberg, "Controlling the false discovery rate", J. R. Statist. Soc. B 57
(1995), 289-300, with the peaks of the frame as the hypotheses: their number times the probability
of a height is the number of peaks that chance lifts so high. A. Schwartzman, Y. Gavrilov and
R. J. Adler, "Multiple testing of local maxima for detection of peaks in 1D", Ann. Statist. 39
(2011), 3290-3319, show that this controls the share of false peaks.
"""

from collections.abc import Sequence

import numpy as np
from scipy.optimize import brentq

from analysis.changes.detection.chance import FilterWidth, expected_peaks
from analysis.changes.detection.levels import DetectionLevel
from analysis.changes.detection.linked_regions import link_levels
from simulation.arrays import FloatArray

_LOWEST_SD = 3.0
"""Below it, peaks run into one another and chance makes more than can be told apart."""

_HIGHEST_SD = 30.0


def q_values(significance: FloatArray, area_px: int, widths: Sequence[FilterWidth]) -> FloatArray:
    """Share of false ones expected among the peaks at least as significant as each.

    Parameters
    ----------
    significance
        Of all peaks beyond a threshold, falling, shape ``(n,)``.
    area_px
        Pixels that were compared.
    widths
        Of the filters that found them.
    """
    if not len(significance):
        return np.zeros(0)
    by_chance = expected_peaks(significance, area_px, widths)
    share = by_chance / np.arange(1, len(significance) + 1)
    return np.minimum(np.minimum.accumulate(share[::-1])[::-1], 1.0)


def discovery_threshold(levels: Sequence[DetectionLevel], rate: float) -> float:
    """Lowest threshold in standard deviations at which this share of the changes is false.

    Where nothing stands out, the threshold is that which chance exceeds in this share of frames.

    Parameters
    ----------
    levels
        The difference behind each width, the narrowest first.
    rate
        Share of false changes among those listed, above 0 and below 1.

    Raises
    ------
    ValueError
        If the rate is not between 0 and 1.
    """
    if not 0 < rate < 1:
        raise ValueError(f"false_discovery_rate must be between 0 and 1, got {rate}")
    area, widths = int(levels[0].valid.sum()), [level.filter_width for level in levels]
    found = link_levels(levels, _LOWEST_SD).regions
    heights = np.abs([region.significance for region in found])
    is_kept = q_values(heights, area, widths) <= rate
    allowed = rate * max(int(is_kept.sum()), 1)

    def excess(height: float) -> float:
        return float(np.log(expected_peaks(np.array(height), area, widths) / allowed))

    if excess(_LOWEST_SD) <= 0:
        return _LOWEST_SD
    return float(brentq(excess, _LOWEST_SD, _HIGHEST_SD))
