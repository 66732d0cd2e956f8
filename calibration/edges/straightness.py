"""Whether a border is the straight edge between two even levels that the fit takes it for.

Along a photographed edge nothing changes but noise, which differs from pixel to pixel. Texture
went through the lens, and does not: neighbouring pixels deviate together from the mean profile
across the edge. And no lens bends a straight edge as much as the rim of a small round thing.
``benchmarks/bench_no_edge.py`` has how often either is right.
"""

from math import sqrt
from typing import NamedTuple

import numpy as np

from calibration.edge_fit import EdgeFit, EdgeShape, shape_slopes
from calibration.edges.samples import EdgeSamples
from simulation.arrays import FloatArray
from simulation.compiled import compiled

UNEVEN_LEAST, UNEVEN_LEAST_JPEG = 0.02, 0.04
"""Of the contrast. Of the sides of photographed chessboards in JPEG files, one of a hundred reaches
0.034; what is false has 0.06 in the median."""

CURVED_LEAST_PER_PX = 6e-3
"""A radius of 167 px. Lenses with 28 % of distortion leave 99 of 100 sides of chessboards below it;
1 % at the corner of 640 x 480 px makes a radius of 39,000 px."""

_UNEVEN_SIGMAS = 2.5
_CURVED_SIGMAS = 4.0
_BIN_PX = 0.5
_REACH_SIGMAS, _REACH_EXTRA_PX = 4.0, 2.0  # farther out, other things reach into the band
_SINGLE_SIGMAS, _SINGLE_LEAST = 4.0, 0.03  # larger ones are dust, or something beside the edge
_FEWEST_PAIRS = 20


class Deviations(NamedTuple):
    """How the pixels along an edge deviate from their mean profile across it, of the contrast.

    ``shared`` is the covariance of neighbours, ``variance`` that of single pixels, of ``pairs``
    neighbours. ``slope2`` is the sum of the squared slopes of the profile, px^-2.
    """

    shared: float
    variance: float
    pairs: int
    slope2: float

    @property
    def uneven(self) -> float:
        """RMS of what neighbours share, of the contrast."""
        return sqrt(max(self.shared, 0.0))

    @property
    def uneven_sigmas(self) -> float:
        """The shared part in standard deviations of what independent noise would give."""
        if not self.variance > 0:
            return 0.0
        return self.shared / self.variance * sqrt(self.pairs)

    @property
    def sagitta_err_px(self) -> float:
        """Standard error of the rise of an arc over its chord, from these deviations."""
        # Of (t^2 - 1/3) over t from -1 to 1, the mean square is 4/45.
        return sqrt(self.variance / (self.slope2 * 4 / 45)) if self.slope2 > 0 else np.inf


def border_flags(samples: EdgeSamples, fit: EdgeFit, *, is_jpeg: bool) -> tuple[str, ...]:
    """Flags ``uneven`` and ``curved`` of what is no straight edge between two even levels.

    Parameters
    ----------
    samples
        The pixels about the edge, slopes of the levels taken off.
    fit
        The fit in the same pixels.
    is_jpeg
        Whether the levels were compressed with loss, which leaves marks of its own.
    """
    found = deviations(samples, fit)
    flags = []
    is_beyond_noise = found.pairs >= _FEWEST_PAIRS and found.uneven_sigmas > _UNEVEN_SIGMAS
    if is_beyond_noise and found.uneven > (UNEVEN_LEAST_JPEG if is_jpeg else UNEVEN_LEAST):
        flags.append("uneven")
    sagitta_px = 0.5 * abs(fit.curvature_per_px) * samples.half_length_px**2
    is_bent = abs(fit.curvature_per_px) > CURVED_LEAST_PER_PX
    if is_bent and sagitta_px > _CURVED_SIGMAS * found.sagitta_err_px:
        flags.append("curved")
    return tuple(flags)


def deviations(samples: EdgeSamples, fit: EdgeFit) -> Deviations:
    """Compare neighbouring pixels near an edge."""
    contrast_dn = samples.high_dn - samples.low_dn
    noise = fit.noise_dn / contrast_dn
    found = _deviations(
        samples.distance_px,
        samples.along_px,
        samples.unit_levels,
        fit.sigma_px,
        float(np.sin(samples.normal_rad)),
        max(_SINGLE_SIGMAS * noise, _SINGLE_LEAST),
    )
    return Deviations(*found)


@compiled()
def _deviations(
    distance: FloatArray,
    along: FloatArray,
    unit_levels: FloatArray,
    sigma_px: float,
    sine: float,
    largest: float,
) -> tuple[float, float, int, float]:
    reach = _REACH_SIGMAS * sigma_px + _REACH_EXTRA_PX
    n = distance.size
    bins = int(2 * reach / _BIN_PX) + 2
    count, total = np.zeros(bins), np.zeros(bins)
    residuals, index = np.empty(n), np.empty(n, np.int64)
    shape = EdgeShape(sigma_px, 0.0, 0.0, False)
    slope2 = 0.0
    for i in range(n):
        index[i] = -1
        if abs(distance[i]) > reach:
            continue
        value, slope, _ = shape_slopes(shape, distance[i])
        slope2 += slope * slope
        residuals[i] = unit_levels[i] - value
        index[i] = int((distance[i] + reach) / _BIN_PX)
        count[index[i]] += 1
        total[index[i]] += residuals[i]
    squares = shared = 0.0
    kept = pairs = 0
    before = np.inf
    for i in range(n):
        here = np.inf
        if index[i] >= 0:
            here = residuals[i] - total[index[i]] / count[index[i]]
        if abs(here) <= largest:
            kept += 1
            squares += here * here
            # In a row the pixels follow each other; along the edge they are then so far apart.
            if abs(before) <= largest and abs(along[i] - along[i - 1] + sine) < 1e-6:
                pairs += 1
                shared += here * before
        before = here
    return shared / max(pairs, 1), squares / max(kept, 1), pairs, slope2
