"""Tell frames of a new exposure from those that a camera still exposed as before."""

from typing import Literal

import numpy as np
from numpy.typing import NDArray

from acquisition.averaging import AveragedFrames
from acquisition.devices import FrameImage

BLOCKS_ACROSS = 32
LEAST_BLOCK_PX = 4
"""Frames are compared by the means of some thousand blocks, in which noise is small."""

FRESH_WITHIN = 0.3
"""Of the change that is expected: lamps and shutters differ by less, a stale frame by all of it."""

TOLD_WITHIN = 0.06
"""Standard error of a frame's share of the change from which on it tells: a fifth of the above."""

LIT_SHARE = 1e-3
"""Of the range, at least 1 DN: blocks that bright are lit; their noise is a sixth of it."""

Verdict = Literal["fresh", "stale", "dark"]

_Blocks = NDArray[np.float64]


class ExposureChange:
    """A change to a longer exposure of the same scene.

    The mean of the frames before it predicts what a frame shows after it, saturation included,
    and what a stale frame shows: the same as before. The projection of a frame on the difference
    is 1 for the one and 0 for the other.

    Parameters
    ----------
    before
        The average at the shorter exposure.
    ratio
        The longer exposure over the shorter one.
    black_level_dn, max_level_dn
        The range.
    """

    def __init__(
        self, before: AveragedFrames, ratio: float, *, black_level_dn: float, max_level_dn: float
    ) -> None:
        old_dn = before.mean_dn.astype(np.float64)
        new_dn = np.minimum(black_level_dn + (old_dn - black_level_dn) * ratio, max_level_dn)
        old = _block_means(old_dn)
        # Elsewhere there is nothing but noise and what the stated black level is off.
        self._is_lit = old - black_level_dn > _lit_dn(black_level_dn, max_level_dn)
        self._old_dn = old[self._is_lit]
        self._step_dn = _block_means(new_dn)[self._is_lit] - self._old_dn
        self._energy_dn2 = float(np.sum(self._step_dn**2))
        # Of the frame, whose shot noise grows by the ratio at most, and of what it is judged by.
        grown = ratio + ratio**2 / before.frames_used
        variance_dn2 = _block_means(before.variance_dn2)[self._is_lit]
        noise_dn2 = grown * variance_dn2 / _block_side(old_dn.shape) ** 2
        self._noise_dn2 = float(np.sum(noise_dn2))
        scatter_dn4 = float(np.sum(self._step_dn**2 * noise_dn2))
        self._is_told = 0 < scatter_dn4**0.5 < TOLD_WITHIN * self._energy_dn2

    def verdict(self, image_dn: FrameImage) -> Verdict:
        """What a frame is; ``dark`` where the scene has too little light to tell."""
        if not self._is_told:
            return "dark"
        change_dn = _block_means(image_dn)[self._is_lit] - self._old_dn
        share = float(np.vdot(change_dn, self._step_dn)) / self._energy_dn2
        rest_dn2 = float(np.sum((change_dn - self._step_dn) ** 2))
        is_near = rest_dn2 < FRESH_WITHIN**2 * self._energy_dn2 + 4 * self._noise_dn2
        return "fresh" if abs(share - 1) < FRESH_WITHIN and is_near else "stale"


class SteadyLight:
    """Whether frames have the exposure of the first of them, of a scene that nobody knows yet.

    Parameters
    ----------
    ratio
        By how much the exposure was changed before.
    black_level_dn, max_level_dn
        The range.
    """

    def __init__(self, ratio: float, *, black_level_dn: float, max_level_dn: float) -> None:
        self._limit = float(np.clip(np.sqrt(max(ratio, 1 / ratio)), 1.1, 1.4))
        self._black_level_dn = black_level_dn
        self._max_level_dn = max_level_dn
        self._lit_dn = _lit_dn(black_level_dn, max_level_dn)
        self._first: tuple[_Blocks, _Blocks] | None = None

    def is_broken_by(self, image_dn: FrameImage) -> bool:
        """Whether a frame has another exposure than the first."""
        light_dn = _block_means(image_dn) - self._black_level_dn
        saturated = _block_means(image_dn >= self._max_level_dn)
        if self._first is None:
            self._first = light_dn, saturated
            return False
        first_dn, first_saturated = self._first
        is_lit = np.maximum(light_dn, first_dn) > self._lit_dn
        is_lit &= (saturated == 0) & (first_saturated == 0)
        if not is_lit.any():
            return abs(float(saturated.mean() - first_saturated.mean())) > 0.01
        sums = (max(float(dn[is_lit].sum()), self._lit_dn) for dn in (light_dn, first_dn))
        change = float(np.log(next(sums)) - np.log(next(sums)))
        return abs(change) > float(np.log(self._limit))


def _lit_dn(black_level_dn: float, max_level_dn: float) -> float:
    return max(LIT_SHARE * (max_level_dn - black_level_dn), 1.0)


def _block_side(shape: tuple[int, ...]) -> int:
    shorter = min(shape)
    return min(max(LEAST_BLOCK_PX, shorter // BLOCKS_ACROSS), shorter)


def _block_means(image: NDArray[np.number] | NDArray[np.bool_]) -> _Blocks:
    """Means of square blocks; what is left at the right and below is not looked at."""
    side = _block_side(image.shape)
    rows, cols = (length // side for length in image.shape)
    blocks = image[: rows * side, : cols * side].reshape(rows, side, cols, side)
    return np.asarray(np.mean(blocks, axis=(1, 3), dtype=np.float64))
