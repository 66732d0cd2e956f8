"""The stated detection limit against the share of painted spots that is found.

Pairs of flat scenes in which nothing changed state a limit for spots of each size at each place.
Then spots of 0.5 to 2 times that limit are painted into the developed follow-up, before it is
rounded or compressed, and the pair is compared anew. ``predicted`` is the mean power that the
amplitude has at its place, ``found`` the share that is listed there with the right sign, by tenths
of the power and by kinds; ``on edges`` is the quarter of the places where the follow-up is
steepest.

    OMP_NUM_THREADS=1 python -m benchmarks.studies.change_limit [--quick] [--kind K] [--seed N]
"""

from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Annotated

import cv2
import numpy as np

from analysis.changes import (
    ChangeOptions,
    ChangeResult,
    changes_between,
    detection_power,
    height_for,
)
from benchmarks.harness import Recorder, benchmark
from benchmarks.truth.lenses import Camera, f_number, gaussian
from benchmarks.truth.pairs import Development, PairPose, pair_of, scene, spot_image
from simulation.arrays import FloatArray

FRAME = (290, 390)
POSES = (
    PairPose(zoom=1.0, turn_deg=2.0, shift=(0.02, -0.01)),
    PairPose(zoom=1.3, tilt_deg=4.0, bearing_deg=60.0),
    PairPose(zoom=1.5, tilt_deg=5.0, bearing_deg=30.0, turn_deg=4.0),
    PairPose(zoom=2.0, turn_deg=1.0, shift=(0.01, 0.01)),
    PairPose(zoom=0.75, tilt_deg=3.0, bearing_deg=200.0),
)
SCENES = {"texture": 25.0, "retina": 13.0, "lesion": 15.0, "mondrian": 45.0, "text": 40.0}
SIGMAS_PX = (1.0, 1.5, 2.0, 3.0, 4.0, 6.0)
FACTORS = (0.5, 2.0)
NOISE_DN = 1.2
ACROSS, DOWN, JITTER_PX = 4, 3, 10.0
MARGIN_PX = 45
REACH_PX = 4.0
DRAWS = 6
TENTHS = np.linspace(0, 1, 11)

PLAIN, LIT = Development(), Development(gain=1.03)
_ROUND = gaussian(0.9, has_pixel=False)


@dataclass(frozen=True, kw_only=True)
class _Kind:
    """What differs between reference and follow-up, and how both are stored."""

    name: str
    scenes: tuple[str, ...] = tuple(SCENES)
    cameras: tuple[Camera, Camera] = (_ROUND, _ROUND)
    before: Development = PLAIN
    after: Development = LIT


KINDS = (
    *(_Kind(name=name, scenes=(name,)) for name in SCENES),
    _Kind(name="other focus", cameras=(_ROUND, gaussian(1.2, has_pixel=False))),
    _Kind(
        name="JPEG 90",
        before=Development(jpeg_quality=90),
        after=Development(gain=1.03, jpeg_quality=90),
    ),
    _Kind(
        name="sRGB, 8 bits",
        before=Development(gamma=0.45, bits=8),
        after=Development(gain=1.03, gamma=0.45, bits=8),
    ),
    _Kind(name="shading", after=Development(gain=1.03, slope=0.25)),
    _Kind(name="f/5.6", cameras=(f_number(5.6), f_number(5.6)), scenes=("mondrian", "lesion")),
)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Judged:
    """A painted spot: the power that was predicted, whether it was found, and where it lay."""

    predicted: float
    found: bool
    sigma_px: float
    fitted_px: float | None
    steepness: float


def _developed(
    levels_dn: FloatArray, how: Development, seed: int, painted: FloatArray
) -> FloatArray:
    """Develop a photograph; ``painted`` is added before rounding and compression."""
    raw = replace(how, bits=None, jpeg_quality=None).of(levels_dn, seed) + painted
    return Development(bits=how.bits, jpeg_quality=how.jpeg_quality).of(raw, 0)


def _judged(kind: _Kind, name: str, pose: PairPose, seed: int) -> tuple[list[_Judged], int]:
    """Paint spots of all sizes into a pair, and look for them; pixels flagged without any."""
    judged = list[_Judged]()
    rng = np.random.default_rng(seed)
    pair = pair_of(scene(name, FRAME, seed, contrast_dn=SCENES[name]), FRAME, pose, kind.cameras)
    before, after = (replace(how, noise_dn=NOISE_DN) for how in (kind.before, kind.after))
    nothing = np.zeros(FRAME)
    reference = _developed(pair.reference_dn, before, 2 * seed, nothing)
    known = pose.known(FRAME)

    def compared(painted: FloatArray, sigma_px: float) -> ChangeResult:
        followup = _developed(pair.followup_dn, after, 2 * seed + 1, painted)
        options = ChangeOptions(pose=known, spot_sigma_px=sigma_px)
        return changes_between(reference, followup, None, options)

    x, y = np.meshgrid(
        np.linspace(MARGIN_PX, FRAME[1] - MARGIN_PX, ACROSS),
        np.linspace(MARGIN_PX, FRAME[0] - MARGIN_PX, DOWN),
    )
    places = np.stack([x.ravel(), y.ravel()], axis=1)
    steep = cv2.GaussianBlur(pair.followup_dn, (0, 0), 1.0)
    steep = np.hypot(*np.gradient(steep))
    plain = {sigma_px: compared(nothing, sigma_px) for sigma_px in SIGMAS_PX}
    first = plain[SIGMAS_PX[0]].summary
    threshold, limit_height = first.threshold_sd, height_for(0.95, first.threshold_sd)
    for _ in range(DRAWS):
        at = places + rng.uniform(-JITTER_PX, JITTER_PX, places.shape)
        sizes = rng.permutation(np.resize(SIGMAS_PX, len(at)))
        spots = []
        painted = np.zeros(FRAME)
        for (x_px, y_px), sigma_px in zip(at.tolist(), sizes.tolist(), strict=True):
            limit = float(plain[sigma_px].limit_dn[round(y_px), round(x_px)])
            if not np.isfinite(limit):
                continue
            factor = float(np.exp(rng.uniform(*np.log(FACTORS)))) * float(rng.choice([-1, 1]))
            painted += factor * limit * spot_image(FRAME, x_px, y_px, sigma_px)
            spots.append((x_px, y_px, sigma_px, factor))
        found = compared(painted, SIGMAS_PX[0]).summary
        for x_px, y_px, sigma_px, factor in spots:
            near = [
                one
                for one in found.changes
                if np.hypot(one.x_px - x_px, one.y_px - y_px) < max(REACH_PX, 1.5 * sigma_px)
                and one.amplitude_dn * factor > 0
            ]
            height = limit_height * abs(factor)
            judged.append(
                _Judged(
                    predicted=float(detection_power(np.array(height), threshold)),
                    found=bool(near),
                    sigma_px=sigma_px,
                    fitted_px=near[0].spot_sigma_px if near else None,
                    steepness=float(steep[round(y_px), round(x_px)]),
                )
            )
    return judged, first.changed_px


def _shares(spots: list[_Judged]) -> tuple[float, float]:
    """Mean predicted power and share found."""
    return float(np.mean([s.predicted for s in spots])), float(np.mean([s.found for s in spots]))


def _worst_tenth(record: Recorder, name: str, spots: list[_Judged], least: int) -> float:
    """Say predicted and found by tenths of the power; return the largest difference."""
    worst, parts = 0.0, []
    for low, high in pairwise(TENTHS):
        inside = [s for s in spots if low <= s.predicted < high or s.predicted == high == 1]
        if len(inside) < least:
            continue
        predicted, found = _shares(inside)
        parts.append(f"{predicted:.2f}/{found:.2f} ({len(inside)})")
        worst = max(worst, abs(predicted - found))
    record.say(f"{name:14s} predicted/found (spots): {'  '.join(parts)}")
    return worst


@benchmark("numpy", "scipy", "numba")
def main(
    record: Recorder,
    *,
    kind: Annotated[str | None, "only kinds with this in their name"] = None,
    seed: int = 3,
    rounds: Annotated[int, "of all scenes and poses"] = 1,
) -> None:
    pooled: list[_Judged] = []
    for place, scenery in enumerate(KINDS):
        if kind is not None and kind not in scenery.name:
            continue
        spots, flagged = list[_Judged](), list[int]()
        turns = rounds * (3 if len(scenery.scenes) == 1 else 1)
        for turn in range(record.pick(turns, 1)):
            for number, name in enumerate(scenery.scenes):
                for view, pose in enumerate(record.pick(POSES, POSES[1:2])):
                    # Noise and spots of its own for each kind: else they would err alike.
                    draw = 1000 * (seed + 10 * turn + 50 * place) + 10 * number + view
                    judged, unchanged = _judged(scenery, name, pose, draw)
                    spots += judged
                    flagged.append(unchanged)
        predicted, found = _shares(spots)
        record.say(
            f"{scenery.name:14s} {len(spots)} spots: predicted {predicted:.3f}, found "
            f"{found:.3f}; {np.mean(flagged):.2f} px flagged a frame without change"
        )
        _worst_tenth(record, scenery.name, spots, 12)
        record.figure(f"{scenery.name}: predicted less found", predicted - found, "")
        pooled += spots
    worst = _worst_tenth(record, "pooled", pooled, 20)
    record.figure("largest difference in a tenth of the power", worst, "")
    order = sorted(pooled, key=lambda spot: spot.steepness)
    for name, part in (
        ("on edges", order[-len(order) // 4 :]),
        ("on plains", order[: len(order) // 4]),
        *((f"{s:g} px", [one for one in pooled if one.sigma_px == s]) for s in SIGMAS_PX),
    ):
        record.say(f"{name}: {len(part)} spots")
        _worst_tenth(record, name, part, 12)
        sizes = [s.fitted_px / s.sigma_px for s in part if s.fitted_px and s.predicted > 0.95]
        if sizes:
            right = float(np.mean(np.abs(np.array(sizes) - 1) < 0.3))
            record.say(f"    size right to 30 %: {100 * right:.0f} % of {len(sizes)}")
