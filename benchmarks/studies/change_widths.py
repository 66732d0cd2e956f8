"""Spots of many widths: found, listed once, with their size; and which are taken for light.

``_Found``: six spots a pair, of 1.5 times the amplitude that a filter matched to them would need to
find 95 % in the pair's own white noise, ``(t + 1.645) n / (sigma sqrt(pi))``; how many are listed,
how many of these by one entry within twice their width, and the share whose size is right to 30 %.
``Kept``: one spot in the middle, without further noise; what the comparison leaves of its peak,
behind its own smoothing, where light, tone and kernel are fitted along.

    OMP_NUM_THREADS=1 python -m benchmarks.studies.change_widths [--quick]
"""

from dataclasses import dataclass, field
from math import pi, sqrt

import numpy as np

from analysis.changes import ChangeOptions, ChangeResult, changes_between
from benchmarks.harness import Recorder, benchmark
from benchmarks.truth.pairs import Development, Pair, PairPose, pair_of, scene, spot_image
from simulation.arrays import FloatArray

FRAME = (290, 390)
SCENES = {"texture": 25.0, "retina": 13.0, "lesion": 15.0, "mondrian": 45.0, "text": 40.0}
POSES = (
    PairPose(zoom=1.0, turn_deg=2.0),
    PairPose(zoom=1.2, tilt_deg=4.0, bearing_deg=60.0),
    PairPose(zoom=0.8, tilt_deg=3.0, bearing_deg=200.0),
)
SIGMAS_PX = (1.0, 1.5, 3.0, 6.0, 10.0)
WIDE_PX = (6.0, 10.0, 15.0, 20.0, 30.0, 45.0, 60.0)
ABOVE_BOUND = 1.5
SIZE_ERR = 0.3
BEFORE, AFTER = Development(noise_dn=1.2), Development(noise_dn=1.2, gain=1.03)
ACROSS, DOWN = (0.25, 0.5, 0.75), (0.32, 0.68)


@dataclass(kw_only=True)
class _Found:
    """Spots of a width: how many entries each has, and the size of the first."""

    entries: list[int] = field(default_factory=list)
    sizes: list[float] = field(default_factory=list)


def _compared(pair: Pair, seed: int, painted: FloatArray | float = 0.0) -> ChangeResult:
    """Compare a pair, with something painted into the developed follow-up."""
    reference, followup = pair.developed(BEFORE, AFTER, seed)
    options = ChangeOptions(pose=pair.pose.known(FRAME))
    return changes_between(reference, followup + painted, None, options)


def _look(pair: Pair, seed: int, sigma_px: float, into: _Found) -> None:
    """Paint six spots of a width and look for them."""
    plain = _compared(pair, seed)
    rng = np.random.default_rng(seed)
    # Behind a smoothing of s px, white noise of n has the deviation n / (2 s sqrt pi).
    smoothing_px = plain.filter_widths[0].width_px / sqrt(2)
    sd_dn = float(np.sqrt(np.median(plain.variance_dn2[plain.valid])))
    noise_dn = sd_dn * 2 * sqrt(pi) * smoothing_px
    bound_dn = (plain.summary.threshold_sd + 1.645) * noise_dn / (sigma_px * sqrt(pi))
    places, painted = [], np.zeros(FRAME)
    for across in ACROSS:
        for down in DOWN:
            x_px, y_px = across * FRAME[1], down * FRAME[0]
            x_px, y_px = x_px + rng.uniform(-6, 6), y_px + rng.uniform(-6, 6)
            near = spot_image(FRAME, x_px, y_px, max(sigma_px, 4.0)) > np.exp(-2.0)
            if not plain.valid[near].all():
                continue
            sign = float(rng.choice([-1, 1]))
            painted += sign * ABOVE_BOUND * bound_dn * spot_image(FRAME, x_px, y_px, sigma_px)
            places.append((x_px, y_px, sign))
    changes = _compared(pair, seed, painted).summary.changes
    for x_px, y_px, sign in places:
        own = [
            one
            for one in changes
            if np.hypot(one.x_px - x_px, one.y_px - y_px) < max(2 * sigma_px, 4.0)
            and one.amplitude_dn * sign > 0
        ]
        into.entries.append(len(own))
        if own and own[0].spot_sigma_px is not None:
            into.sizes.append(own[0].spot_sigma_px)


def _kept_share(pair: Pair, seed: int, sigma_px: float) -> float:
    """What is left of a wide spot's peak, over what the comparison's smoothing leaves."""
    plain = _compared(pair, seed)
    x_px, y_px = (FRAME[1] - 1) / 2, (FRAME[0] - 1) / 2
    sd_dn = float(np.sqrt(np.median(plain.variance_dn2[plain.valid])))
    painted = 8 * sd_dn * spot_image(FRAME, x_px, y_px, sigma_px)
    left = _compared(pair, seed, painted).difference_dn - plain.difference_dn
    smoothing_px = plain.filter_widths[0].width_px / sqrt(2)
    expected = painted.max() * sigma_px**2 / (sigma_px**2 + smoothing_px**2)
    return float(left[round(y_px) - 2 : round(y_px) + 3, round(x_px) - 2 : round(x_px) + 3].mean()
                 / expected)  # fmt: skip


@benchmark("numpy", "scipy", "numba")
def main(record: Recorder, *, seed: int = 31) -> None:
    found = {sigma_px: _Found() for sigma_px in SIGMAS_PX}
    kept: dict[float, list[float]] = {sigma_px: [] for sigma_px in WIDE_PX}
    names = record.pick(tuple(SCENES), ("lesion",))
    for number, name in enumerate(names):
        for place, pose in enumerate(record.pick(POSES, POSES[:1])):
            draw_seed = 100 * seed + 10 * number + place
            made = pair_of(scene(name, FRAME, draw_seed, contrast_dn=SCENES[name]), FRAME, pose)
            for turn, sigma_px in enumerate(SIGMAS_PX):
                for draw in range(record.pick(3, 1)):
                    _look(made, 1000 * draw_seed + 10 * turn + draw, sigma_px, found[sigma_px])
            for sigma_px in WIDE_PX:
                kept[sigma_px].append(_kept_share(made, draw_seed, sigma_px))
    for sigma_px, one in found.items():
        entries, sizes = np.array(one.entries), np.array(one.sizes)
        share, once = float(np.mean(entries > 0)), float(np.mean(entries[entries > 0] == 1))
        right = float(np.mean(np.abs(sizes / sigma_px - 1) < SIZE_ERR))
        record.say(
            f"sigma {sigma_px:4.1f} px: {100 * share:5.1f} % of {len(entries)} found, "
            f"{100 * once:5.1f} % of these listed once, "
            f"size right to 30 %: {100 * right:5.1f} %"
        )
        record.figure(f"sigma {sigma_px:g} px: found at 1.5 times the bound", 100 * share, "%")
        record.figure(f"sigma {sigma_px:g} px: size right to 30 %", 100 * right, "%")
    for sigma_px, shares in kept.items():
        middle, worst = float(np.median(shares)), float(np.min(shares))
        record.say(
            f"sigma {sigma_px:4.1f} px, {sigma_px / min(FRAME):.2f} of the frame's height: "
            f"{100 * middle:.0f} % of the peak is left, {100 * worst:.0f} % at the least"
        )
        record.figure(f"sigma {sigma_px:g} px: left of the peak", 100 * middle, "%")
