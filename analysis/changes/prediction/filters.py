"""What a comparison's filters make of white noise and of a spot, before there is a pair."""

from dataclasses import dataclass
from math import pi, sqrt

import numpy as np

from analysis.changes.detection import FilterWidth, equally_strict, response, usual_widths
from analysis.changes.matching import Smoothing
from analysis.choices import FALSE_ALARMS
from simulation.arrays import FloatArray

_FRAME_PX = 100_000
"""Of the frame whose rate of false alarms and whose wide filters are meant: of 200,000 pixels a
spot of 6 px has a limit that is lower by 2 %, a narrower one by less."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedFilters:
    """The filters of a comparison on the follow-up's pixels.

    Parameters
    ----------
    zoom
        Reference pixels to one of the follow-up, along a line.
    smoothing
        Of the reference, the source, and of the follow-up, the target.
    """

    zoom: float
    smoothing: Smoothing

    @property
    def widths(self) -> tuple[FilterWidth, ...]:
        """The widths, with the allowances that a frame of usual size gives them."""
        plain = usual_widths(self.smoothing.target_px, _FRAME_PX)
        return equally_strict(plain, FALSE_ALARMS / _FRAME_PX)

    def noise_gain(self, width: FilterWidth) -> float:
        """Variance behind a filter for white noise of variance 1 in both photographs.

        A Gaussian of width w leaves 1 / (4 pi w^2) of it. The reference is behind another one, and
        has z^2 of its pixels to one of the follow-up.
        """
        source_px2 = self.smoothing.source_px**2 + width.width_px**2 - self.smoothing.target_px**2
        return (1 / width.width_px**2 + 1 / (self.zoom**2 * source_px2)) / (4 * pi)

    def response(self, width: FilterWidth, spot_sigma_px: float) -> float:
        """Peak behind a filter of a spot of peak 1 and this width, as the follow-up shows it."""
        return float(response(np.array(spot_sigma_px), width))

    def limit_per_height(self, spot_sigma_px: float, noise_dn: float) -> float:
        """Amplitude by which a spot stands out by one standard deviation of white noise.

        Parameters
        ----------
        spot_sigma_px
            Its width as the follow-up shows it.
        noise_dn
            Standard deviation of the noise of either photograph.
        """
        return min(
            noise_dn
            * sqrt(self.noise_gain(width))
            * width.allowance
            / self.response(width, spot_sigma_px)
            for width in self.widths
        )

    def averaging(self, width: FilterWidth, lags: int) -> FloatArray:
        """Weights of the autocovariance of the narrowest difference that a wider one adds up.

        Shape ``(2 lags + 1, 2 lags + 1)``, lag 0 in the middle; over all lags their sum is 1.
        """
        more_px2 = width.width_px**2 - self.smoothing.target_px**2
        lag = np.arange(-lags, lags + 1)
        line = np.exp(-(lag**2) / (4 * more_px2)) / sqrt(4 * pi * more_px2)
        return np.asarray(np.outer(line, line))
