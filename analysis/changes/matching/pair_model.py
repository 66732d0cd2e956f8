"""What takes one smoothed photograph to the other: light, and a kernel about the mean of both.

With ``L`` the source in the target's light and ``M = s L + t T`` the mean of both, weighted so that
its noise is not correlated with that of their difference, ``T - L`` is explained as a kernel on M.
The noise of the source then pulls neither the kernel towards nothing, nor the gain below what it
is; and before against after is minus after against before.
"""

from dataclasses import dataclass, field

import numpy as np

from analysis.changes.matching.matching_kernel import (
    CENTRE_TAP,
    NO_KERNEL,
    MatchingKernel,
    WhiteNoiseGain,
    white_noise_gain,
)
from analysis.changes.matching.relative_blur import Smoothing
from simulation.arrays import Float32Array, FloatArray, IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PairModel:
    """Light and kernel between a source and a target.

    Parameters
    ----------
    gain, offset_dn
        Of the light, before the kernel.
    target_share
        Weight of the target in the mean of both.
    kernel
        What it adds.
    """

    gain: float
    offset_dn: float
    target_share: float = 0.5
    kernel: MatchingKernel = field(default=NO_KERNEL, repr=False)

    def brought(self, source: Float32Array) -> Float32Array:
        """The source in the target's light."""
        return np.asarray(source * np.float32(self.gain) + np.float32(self.offset_dn))

    def middle(self, source: Float32Array, target: Float32Array) -> Float32Array:
        """Mean of both."""
        share = np.float32(self.target_share)
        own = self.brought(source)
        own *= 1 - share
        own += share * target
        return own

    def difference(self, source: Float32Array, target: Float32Array) -> Float32Array:
        """Target less what the source and the model make of it."""
        apart = target - self.brought(source)
        apart -= self.kernel.of(self.middle(source, target))
        # A level that only the target has is partly in the kernel's mean.
        grown, _ = self.kernel.light((target.shape[0], target.shape[1]))
        apart /= 1 - np.float32(self.target_share) * grown
        return np.asarray(apart)

    def difference_at(
        self,
        source: Float32Array,
        target: Float32Array,
        middle: Float32Array,
        rows: IntArray,
        cols: IntArray,
    ) -> FloatArray:
        """The same, up to the share of the target in the mean, at pixels away from the border."""
        own = target[rows, cols].astype(np.float64)
        apart = own - (self.gain * source[rows, cols] + self.offset_dn)
        return apart - self.kernel.at(middle, rows, cols)

    def light(self, shape: tuple[int, int]) -> tuple[Float32Array, Float32Array]:
        """Gain and offset that take the source to the target, at every pixel."""
        grown, added = self.kernel.light(shape)
        added -= grown * np.float32(self.kernel.level_dn)
        more = 1 + np.float32(1 - self.target_share) * grown
        added += np.float32(self.offset_dn) * more
        less = 1 - np.float32(self.target_share) * grown
        return np.float32(self.gain) * more / less, added / less

    def noise_gain(self, smoothing: Smoothing, zoom: float) -> WhiteNoiseGain:
        """What smoothing and model leave of white noise of variance 1 in either photograph."""
        taps = self.kernel.taps
        none = np.zeros_like(taps)
        none.flat[CENTRE_TAP] = 1.0
        left = 1 - self.target_share * float(taps.sum())
        source = self.gain * (none + (1 - self.target_share) * taps) / left
        target = (none - self.target_share * taps) / left
        return white_noise_gain(source, smoothing, zoom, target)
