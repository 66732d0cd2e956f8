"""Fixed pattern of a sensor: its rows, columns and pixels apart, and its spectra.

References
----------
EMVA Standard 1288, release 4.0 linear, 2021, section 8: nonuniformity as the sum of the variances
of rows, columns and pixels, and its spectrograms along both axes.
"""

from dataclasses import dataclass, field
from math import ceil, sqrt

import numpy as np

from simulation.arrays import BoolArray, FloatArray
from simulation.by_value import ByValue


@dataclass(frozen=True, slots=True, kw_only=True)
class PatternParts:
    """Standard deviations of a fixed pattern: all of it, and what rows, columns and pixels add.

    ``err`` is the standard error of ``total`` as that of the population that the pixels are from.
    """

    total: float
    rows: float
    columns: float
    pixels: float
    err: float = 0.0

    def scaled(self, factor: float) -> "PatternParts":
        """Return the parts in another unit."""
        return PatternParts(
            total=factor * self.total,
            rows=factor * self.rows,
            columns=factor * self.columns,
            pixels=factor * self.pixels,
            err=factor * self.err,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PatternSpectra(ByValue):
    """Amplitude spectra of a fixed pattern along rows and along columns, shape ``(n,)`` each.

    White noise of the standard deviation s has the amplitude s at every frequency;
    ``temporal`` is that of the temporal noise that the averaging has left.
    """

    freq_x_cy_per_px: FloatArray = field(repr=False)
    along_x: FloatArray = field(repr=False)
    freq_y_cy_per_px: FloatArray = field(repr=False)
    along_y: FloatArray = field(repr=False)
    temporal: float


def pattern_parts(
    deviation: FloatArray, sound: BoolArray, temporal_variance: float, passed: float = 1.0
) -> PatternParts:
    """Split the variance of a pattern into that of rows, of columns and of single pixels.

    Parameters
    ----------
    deviation
        Difference of each pixel from its surroundings, shape ``(rows, cols)``.
    sound
        Pixels without a defect; the others do not count.
    temporal_variance
        What temporal noise adds to each pixel; it is subtracted.
    passed
        Share of the variance of rows and of columns that a high-pass has left, see
        `share_passed`; what it took is added again.

    Notes
    -----
    The means of rows of N pixels have the variance ``s_rows^2 + s_pixels^2 / N``, those of the
    columns likewise; with the whole variance these are three equations.
    """
    rows, cols = deviation.shape
    whole = max(float(np.var(deviation[sound])), 0.0)
    by_row, by_column = (_variance_of_means(deviation, sound, axis) for axis in (1, 0))
    free = 1 - 1 / rows - 1 / cols
    single = max(whole - by_row - by_column, 0.0) / free
    parts = (
        max(by_row - single / cols, 0.0) / passed,
        max(by_column - single / rows, 0.0) / passed,
        max(single - temporal_variance, 0.0),
    )
    in_rows, in_columns, in_pixels = (sqrt(variance) for variance in parts)
    total = sqrt(sum(parts))
    spread = parts[0] ** 2 / rows + parts[1] ** 2 / cols + single**2 / deviation.size
    return PatternParts(
        total=total,
        rows=in_rows,
        columns=in_columns,
        pixels=in_pixels,
        err=sqrt(2 * spread) / (2 * total) if total > 0 else 0.0,
    )


def share_passed(sigma_px: float) -> float:
    """Share of white noise along one axis that is left without its mean by a Gaussian window."""
    reach = np.arange(-ceil(6 * sigma_px), ceil(6 * sigma_px) + 1)
    weight = np.exp(-0.5 * (reach / sigma_px) ** 2)
    weight /= weight.sum()
    return float(1 - 2 * weight.max() + np.sum(weight**2))


def _variance_of_means(deviation: FloatArray, sound: BoolArray, axis: int) -> float:
    count = np.maximum(sound.sum(axis=axis), 1)
    return float(np.var(np.where(sound, deviation, 0.0).sum(axis=axis) / count))


def pattern_spectra(
    deviation: FloatArray, sound: BoolArray, temporal_variance: float
) -> PatternSpectra:
    """Return the spectra of a pattern; defects count as pixels without a deviation.

    Parameters: see `pattern_parts`.
    """
    filled = np.where(sound, deviation, 0.0)
    filled = filled - filled.mean()
    rows, cols = filled.shape
    along_x = np.sqrt(np.mean(np.abs(np.fft.rfft(filled, axis=1)) ** 2, axis=0) / cols)
    along_y = np.sqrt(np.mean(np.abs(np.fft.rfft(filled, axis=0)) ** 2, axis=1) / rows)
    return PatternSpectra(
        freq_x_cy_per_px=np.arange(cols // 2 + 1) / cols,
        along_x=along_x,
        freq_y_cy_per_px=np.arange(rows // 2 + 1) / rows,
        along_y=along_y,
        temporal=sqrt(max(temporal_variance, 0.0)),
    )
