"""Changes of colour against an ideal detector, and noise in colour against the stated rate.

Frames of noise about an even grey, three channels of unequal and correlated noise, one pose. Of
noise alone: the changed pixels a frame beside those that are stated. With spots painted in random
directions of colour: the amplitude at which half of them are found, over that of an ideal detector:
a matched filter that knows the noise, the width and the direction, at the same rate of false
pixels. 95 % intervals by frames drawn anew: false pixels come in clumps.

    OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 python -m benchmarks.studies.change_colour [--frames N]
        [--seed N]
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import pi
from typing import Annotated

import numpy as np
from scipy.optimize import minimize
from scipy.special import ndtri
from scipy.stats import norm

from acquisition.photographs import luma_plane
from analysis.changes import ChangeOptions, ChangeResult, PairColours, changes_between
from benchmarks.harness import Recorder, benchmark
from calibration.registration import DistortedPose
from simulation.arrays import FloatArray

FRAMES, QUICK_FRAMES = 300, 12
SIDE_PX = 320
SPOT_SIGMA_PX = 2.0
APART_PX = 40
FALSE_ALARMS = 0.5
LEVEL_DN, TEXTURE_DN = 120.0, 4.0
NOISES = {
    "independent": (np.array([3.0, 3.0, 3.0]), 0.0),
    "unequal": (np.array([2.0, 1.5, 4.0]), 0.0),
    "correlated": (np.array([3.0, 2.5, 3.5]), 0.6),
}
"""Standard deviations of red, green and blue in one photograph, and the correlation of any two."""

HEIGHTS = np.linspace(3.0, 9.0, 13)
"""Standard deviations of the painted spots behind the ideal filter."""

_DRAWS = 300


@dataclass(frozen=True, slots=True, kw_only=True)
class _Spots:
    """Painted spots of a frame: what an ideal filter sees of each, and whether it was found."""

    heights: FloatArray
    found: FloatArray


def _covariance(kind: str) -> FloatArray:
    """Of the channels' noise in one photograph."""
    sd, correlation = NOISES[kind]
    shape = np.full((3, 3), correlation)
    np.fill_diagonal(shape, 1.0)
    return np.asarray(shape * np.outer(sd, sd))


def _scene(rng: np.random.Generator) -> FloatArray:
    """A soft texture of all channels, as a background has one."""
    freq = np.hypot(np.fft.fftfreq(SIDE_PX)[:, None], np.fft.rfftfreq(SIDE_PX)[None])
    white = np.fft.rfft2(rng.normal(size=(SIDE_PX, SIDE_PX))) * np.exp(-((freq / 0.05) ** 2))
    texture = np.fft.irfft2(white, s=(SIDE_PX, SIDE_PX))
    levels = LEVEL_DN + TEXTURE_DN * texture / texture.std()
    return np.repeat(levels[..., None], 3, axis=2)


def _with_noise(levels: FloatArray, kind: str, rng: np.random.Generator) -> FloatArray:
    """Levels with noise of a kind, as floats: no step of a file adds to it."""
    root = np.linalg.cholesky(_covariance(kind))
    return np.asarray(levels + rng.normal(size=levels.shape) @ root.T)


def _compared(before: FloatArray, after: FloatArray) -> ChangeResult:
    """Compare two frames of one pose in colour."""
    shape = (SIDE_PX, SIDE_PX)
    pose = DistortedPose(matrix=np.eye(3), k1=0.0, reference_shape=shape, followup_shape=shape)
    colours = PairColours(reference_dn=before, followup_dn=after)
    options = ChangeOptions(pose=pose, colours=colours, false_alarms=FALSE_ALARMS)
    return changes_between(luma_plane(before), luma_plane(after), None, options)


def _false_px(kind: str, seed: int) -> int:
    """Changed pixels of a frame without change."""
    rng = np.random.default_rng((seed, 1))
    levels = _scene(rng)
    found = _compared(_with_noise(levels, kind, rng), _with_noise(levels, kind, rng)).summary
    return found.changed_px + found.moved_px


def _painted(kind: str, seed: int) -> _Spots:
    """Paint spots in random directions of colour, and say which are found."""
    rng = np.random.default_rng((seed, 2))
    inverse = np.linalg.inv(2 * _covariance(kind))
    along = np.arange(APART_PX, SIDE_PX - APART_PX // 2, APART_PX)
    places = np.stack(np.meshgrid(along, along, indexing="ij"), axis=-1).reshape(-1, 2)
    centres = places + rng.uniform(-0.5, 0.5, places.shape)
    heights = rng.choice(HEIGHTS, len(places))
    levels = _scene(rng)
    after = levels.copy()
    y, x = np.mgrid[:SIDE_PX, :SIDE_PX]
    for (row, col), height in zip(centres, heights, strict=True):
        unit = rng.normal(size=3)
        unit /= np.sqrt(unit @ inverse @ unit)
        # Of a Gaussian in white noise: amplitude times sqrt(pi) sigma over the noise.
        amplitude = height / (pi**0.5 * SPOT_SIGMA_PX)
        spot = np.exp(-((y - row) ** 2 + (x - col) ** 2) / (2 * SPOT_SIGMA_PX**2))
        after += amplitude * spot[..., None] * unit
    made = _compared(_with_noise(levels, kind, rng), _with_noise(after, kind, rng))
    is_change = made.is_change | made.is_moved
    near = [
        is_change[round(row) - 4 : round(row) + 5, round(col) - 4 : round(col) + 5].any()
        for row, col in centres
    ]
    return _Spots(heights=heights, found=np.array(near, dtype=np.float64))


def _half_found(spots: Sequence[_Spots]) -> float:
    """Height at which half are found, by a cumulative Gaussian."""
    height = np.concatenate([one.heights for one in spots])
    found = np.concatenate([one.found for one in spots])

    def cost(given: FloatArray) -> float:
        share = norm.cdf((height - given[0]) / np.exp(given[1])).clip(1e-6, 1 - 1e-6)
        return -float(np.sum(found * np.log(share) + (1 - found) * np.log(1 - share)))

    fitted: FloatArray = minimize(cost, [5.0, 0.0], method="Nelder-Mead").x
    return float(fitted[0])


def _ideal_height() -> float:
    """The same of a filter that knows the noise, the width and the direction.

    It looks at one place, and its threshold is exceeded by as many pixels of a frame.
    """
    return float(-ndtri(FALSE_ALARMS / SIDE_PX**2 / 2))


def _mean_interval(counts: Sequence[int]) -> tuple[float, float]:
    """95 % of the mean, by frames drawn anew: false pixels come in clumps."""
    rng = np.random.default_rng(0)
    drawn = np.array(counts)[rng.integers(len(counts), size=(_DRAWS, len(counts)))].mean(axis=1)
    low, high = np.percentile(drawn, [2.5, 97.5]).tolist()
    return low, high


@benchmark("numpy", "scipy", "numba")
def main(
    record: Recorder, *, frames: Annotated[int | None, f"{FRAMES} by default"] = None, seed: int = 1
) -> None:
    frames = frames or record.pick(FRAMES, QUICK_FRAMES)
    ideal = _ideal_height()
    record.say(
        f"{frames} frames of {SIDE_PX} x {SIDE_PX} px a kind; {FALSE_ALARMS:g} false px stated"
    )
    for kind in NOISES:
        counts = [_false_px(kind, seed + number) for number in range(frames)]
        low, high = _mean_interval(counts)
        mean = sum(counts) / frames
        record.say(f"{kind:12s} false px a frame {mean:.2f} [{low:.2f}, {high:.2f}]")
        record.figure(f"false pixels a frame, {kind}", mean, "px", "as stated", FALSE_ALARMS)
        spots = [_painted(kind, seed + number) for number in range(max(frames // 20, 3))]
        ratio = _half_found(spots) / ideal
        rng = np.random.default_rng(0)
        drawn = [
            _half_found([spots[i] for i in rng.integers(len(spots), size=len(spots))]) / ideal
            for _ in range(_DRAWS if not record.is_quick else 20)
        ]
        low, high = np.percentile(drawn, [2.5, 97.5]).tolist()
        record.say(f"{kind:12s} half are found at {ratio:.3f} [{low:.3f}, {high:.3f}] of the ideal")
        record.figure(f"amplitude at which half are found, {kind}", ratio, "of the ideal one's")
