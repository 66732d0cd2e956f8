"""Alignment of two photographs that nothing is known of, by kind of scene.

Pairs at zooms of 0.5 to 2.5, tilted by up to 15 degrees, turned by any angle, shifted by up to
30 %, with at least a third in common; contrasts of 5 to 60 DN, 8 and 12 bit, noise up to 3 DN. The
error is the rms over the overlap of reference positions, in px; ``bound`` is the Cramer-Rao bound
from the slopes of the noise-free follow-up, for a homography, gain and offset. The peer is
OpenCV's SIFT and MAGSAC alone. Then pairs tilted by 35 to 60 degrees, pairs of which one is 6.5
times nearer, either way, and such pairs of two scenes, none of which may be aligned.

    python -m benchmarks.studies.alignment [--pairs 120] [--width-px 780] [--seed 5000] [--hints 10]
"""

import sys
import time
from collections import Counter, defaultdict
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product
from math import exp, log
from typing import Annotated

import numpy as np

from benchmarks.harness import Recorder, benchmark
from benchmarks.peers.alignments import Matching, detector_of, magsac, matches_of
from benchmarks.peers.program import PeerError
from benchmarks.truth.lenses import f_number
from benchmarks.truth.pairs import (
    DEFAULT_CAMERA,
    SCENES,
    Development,
    Pair,
    PairPose,
    pair_of,
    scene,
)
from calibration.errors import RegistrationError
from calibration.registration import (
    FeatureMatches,
    RegistrationHints,
    register_images,
)
from simulation.arrays import BoolArray, FloatArray

PEER = "OpenCV's SIFT and MAGSAC"
FIRST_SEED = 5000
SHARED_LEAST = 1 / 3
ERROR_MAX_PX = 0.05
BOUND_FACTOR = 1.5
WORST_FACTOR = 4.0
LOOSE_PX = 2.0
BORDER_PX = 3
POINT_ERROR_PX = 1.5
STEEP_TILTS_DEG = (35.0, 45.0, 55.0, 60.0)
MATCHING = Matching(ratio=0.8, tolerance_px=3.0, least=4)
EXTREME_ZOOM = 6.5
EXTREME_FRAME = (400, 600)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Case:
    """Two photographs, what is known of them and the noise of both in 8-bit DN."""

    kind: str
    pair: Pair
    contrast_dn: float
    noise_dn: float
    bits: int
    reference: FloatArray
    followup: FloatArray

    @classmethod
    def of(
        cls,
        kind: str,
        pair: Pair,
        contrast_dn: float,
        developments: tuple[Development, Development],
        seed: int,
    ) -> "Case":
        """The photographs of a pair as they are developed."""
        reference, followup = pair.developed(*developments, seed)
        return cls(
            kind=kind,
            pair=pair,
            contrast_dn=contrast_dn,
            noise_dn=developments[0].noise_dn,
            bits=developments[0].bits or 0,
            reference=reference,
            followup=followup,
        )

    def bound_px(self) -> float:
        """Cramer-Rao bound of the rms error over the overlap, in reference px."""
        rows, cols = self.pair.frame
        y, x = np.mgrid[BORDER_PX : rows - BORDER_PX, BORDER_PX : cols - BORDER_PX].astype(float)
        inside = self.pair.pose.shown(x, y, self.pair.frame)
        inner = np.s_[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX]
        slope_y, slope_x = (
            np.gradient(self.pair.followup_dn, axis=axis)[inner][inside] for axis in (0, 1)
        )
        level = self.pair.followup_dn[inner][inside]
        half = max(rows, cols) / 2
        u, v = (x[inside] - (cols - 1) / 2) / half, (y[inside] - (rows - 1) / 2) / half
        one, nothing = np.ones_like(u), np.zeros_like(u)
        along_x = np.stack([one, nothing, u, v, nothing, nothing, u * u, u * v], axis=1)
        along_y = np.stack([nothing, one, nothing, nothing, u, v, u * v, v * v], axis=1)
        motions = slope_x[:, None] * along_x + slope_y[:, None] * along_y
        design = np.concatenate([motions, (level - level.mean())[:, None], one[:, None]], axis=1)
        rounding = 1 / 12 if self.bits == 8 else 0.0
        zoom = self.pair.pose.zoom
        # The reference has zoom^2 pixels, each with its noise, for one of the follow-up.
        variance = (self.noise_dn**2 + rounding) * (1 + 1 / zoom**2)
        covariance = np.linalg.inv(design.T @ design)[:8, :8] * variance
        total = sum(
            float(np.mean(np.sum((along @ covariance) * along, axis=1)))
            for along in (along_x, along_y)
        )
        return zoom * float(np.sqrt(total))

    def unshared(self) -> BoolArray:
        """Follow-up pixels that the reference does not show, as an operator would paint them."""
        rows, cols = self.pair.frame
        y, x = np.mgrid[:rows, :cols].astype(np.float64)
        return np.asarray(~self.pair.pose.shown(x, y, self.pair.frame))

    def points(self, rng: np.random.Generator) -> FeatureMatches:
        """Six points as an operator would click them."""
        rows, cols = self.pair.frame
        x, y = rng.uniform(0, cols, 4000), rng.uniform(0, rows, 4000)
        to_x, to_y = self.pair.pose.positions(x, y, self.pair.frame)
        inside = np.flatnonzero(self.pair.pose.shown(x, y, self.pair.frame))
        # Far apart: the outermost in six directions.
        turns = np.arange(6) * np.pi / 3
        about_x, about_y = x[inside] - x[inside].mean(), y[inside] - y[inside].mean()
        chosen = [inside[np.argmax(about_x * np.cos(t) + about_y * np.sin(t))] for t in turns]
        clicked = np.stack([to_x[chosen], to_y[chosen]], axis=1)
        return FeatureMatches(
            np.stack([x[chosen], y[chosen]], axis=1),
            clicked + rng.normal(0, POINT_ERROR_PX, clicked.shape),
        )


def _case(number: int, frame: tuple[int, int], first_seed: int = FIRST_SEED) -> Case:
    """Pair ``number`` of those that begin at a seed."""
    seed = first_seed + number
    rng = np.random.default_rng(seed)
    kind = list(SCENES)[number % len(SCENES)]
    contrast = exp(rng.uniform(log(5.0), log(60.0 if kind != "text" else 45.0)))
    pose = _pose(rng, frame)
    lens = DEFAULT_CAMERA if number % 2 else f_number(5.6)
    made = pair_of(scene(kind, frame, seed, contrast_dn=contrast), frame, pose, (lens,) * 2)
    noise, bits = float(rng.uniform(0.3, 3.0)), int(rng.choice([8, 12]))
    after = Development(
        noise_dn=noise,
        bits=bits,
        gain=float(rng.uniform(0.8, 1.1)),
        slope=float(rng.uniform(-0.2, 0.2)),
    )
    before = Development(noise_dn=noise, bits=bits)
    return Case.of(kind, made, contrast, (before, after), number)


def _pose(rng: np.random.Generator, frame: tuple[int, int]) -> PairPose:
    """A pose that leaves a third of the smaller view in common."""
    while True:
        pose = PairPose(
            zoom=exp(rng.uniform(log(0.5), log(2.5))),
            tilt_deg=float(rng.uniform(0, 15)),
            bearing_deg=float(rng.uniform(0, 360)),
            turn_deg=float(rng.uniform(0, 360)),
            shift=(float(rng.uniform(-0.3, 0.3)), float(rng.uniform(-0.3, 0.3))),
        )
        matrix = pose.matrix(frame)
        inverse = np.asarray(np.linalg.inv(matrix), dtype=np.float64)
        shares = [_share(one, frame) for one in (matrix, inverse)]
        if max(shares) >= SHARED_LEAST:
            return pose


def _share(matrix: FloatArray, frame: tuple[int, int]) -> float:
    rows, cols = frame
    y, x = np.mgrid[:rows:8, :cols:8].astype(np.float64)
    u, v, w = np.tensordot(matrix, np.stack([x, y, np.ones_like(x)]), axes=1)
    inside = (w > 0) & (u >= 0) & (u <= (cols - 1) * w) & (v >= 0) & (v <= (rows - 1) * w)
    return float(np.mean(inside))


def _peer_error_px(one: Case) -> float:
    """Error of OpenCV's SIFT and MAGSAC; infinite where it finds none."""
    reference, followup = (
        np.clip(image / (1 if one.bits == 8 else 16), 0, 255).astype(np.uint8)
        for image in (one.reference, one.followup)
    )
    try:
        matrix = magsac(matches_of(reference, followup, detector_of("sift"), MATCHING), MATCHING)
    except PeerError:
        return float("inf")
    rows, cols = one.pair.frame
    y, x = np.mgrid[:rows, :cols].astype(np.float64)
    u, v, w = np.tensordot(matrix, np.stack([x, y, np.ones_like(x)]), axes=1)
    return one.pair.error_px(u / w, v / w)


def _judge_steep(record: Recorder, kinds: tuple[str, ...]) -> None:
    """Print what becomes of pairs whose follow-up is taken steeply from aside."""
    views = list(product((kind for kind in kinds if kind != "tiled"), STEEP_TILTS_DEG))
    missed, wrong, peer_missed = 0, 0, 0
    for number, (kind, tilt_deg) in enumerate(views):
        pose = PairPose(zoom=1.2, tilt_deg=tilt_deg, bearing_deg=40.0 * number, turn_deg=10.0)
        pair = pair_of(scene(kind, EXTREME_FRAME, number, contrast_dn=30.0), EXTREME_FRAME, pose)
        how = Development(noise_dn=1.5, bits=8)
        one = Case.of(kind, pair, 30.0, (how, how), number)
        bound = max(ERROR_MAX_PX, BOUND_FACTOR * one.bound_px())
        verdict, error_px = _verdict(one, None, bound)
        record.say(f"tilt {tilt_deg:g} degrees, {kind}: {verdict}, error {error_px:.3g} px")
        missed += verdict not in ("aligned", "coarse")
        wrong += verdict == "wrong"
        peer_missed += not _peer_error_px(one) <= WORST_FACTOR * bound
    name = f"tilted by 35 to 60 degrees: not aligned to 4 bounds, of {len(views)}"
    record.figure(name, missed, "", PEER, peer_missed)
    if wrong:
        sys.exit(f"{wrong} tilted pairs are silently wrong")


def _judge_extremes(record: Recorder, kinds: tuple[str, ...]) -> None:
    """Print what becomes of pairs that have a fortieth of one photograph in common, or nothing."""
    aligned, wrong = 0, 0
    kinds = tuple(kind for kind in kinds if kind != "tiled")
    for number, kind in enumerate(kinds):
        pose = PairPose(zoom=EXTREME_ZOOM, turn_deg=2.0, shift=(0.03, -0.02))
        one, other = (
            pair_of(scene(kind, EXTREME_FRAME, seed, contrast_dn=30.0), EXTREME_FRAME, pose)
            for seed in (number, 100 + number)
        )
        how = Development(noise_dn=1.5, bits=8)
        near, far = one.developed(how, how, number)
        for reference, followup, is_nearer_second in ((near, far, False), (far, near, True)):
            try:
                found = register_images(reference, followup)
            except RegistrationError:
                record.say(f"zoom {EXTREME_ZOOM:g}, {kind}: refused")
                continue
            turned = found.pose.inverse() if is_nearer_second else found.pose
            y, x = turned.followup_places_px()
            error_px = one.error_px(x, y) / EXTREME_ZOOM
            # The further photograph is wider than the scene is until it repeats.
            is_warned = any("repeats" in text for text in found.warnings)
            aligned += error_px < 0.5
            wrong += error_px >= 0.5 and not is_warned
            remark = ", warned that the scene repeats" if is_warned else ""
            record.say(f"zoom {EXTREME_ZOOM:g}, {kind}: {error_px:.3f} px of the further{remark}")
        try:
            register_images(near, other.developed(how, how, number)[1])
        except RegistrationError:
            continue
        wrong += 1
        record.say(f"zoom {EXTREME_ZOOM:g}, {kind}: another scene is aligned")
    name = f"pairs aligned at a zoom of {EXTREME_ZOOM:g}, of {2 * len(kinds)}"
    record.figure(f"{name} (most scenes repeat, which is warned of)", aligned, "")
    if wrong:
        sys.exit(f"{wrong} extreme pairs are silently wrong")


def _judge(record: Recorder, cases: Iterable[Case], hinted_each: int) -> None:
    """Print what became of the pairs of every kind.

    The operator's hints are given to each ``hinted_each``-th pair and to those that fail without.
    """
    found: dict[str, Counter[str]] = defaultdict(Counter)
    ratios: dict[str, list[float]] = defaultdict(list)
    seconds: dict[str, list[float]] = defaultdict(list)
    for number, one in enumerate(cases):
        bound = max(ERROR_MAX_PX, BOUND_FACTOR * one.bound_px())
        start = time.process_time()
        verdict, error = _verdict(one, None, bound)
        seconds["ours"].append(time.process_time() - start)
        found[one.kind][verdict] += 1
        found[one.kind]["loose"] += error <= LOOSE_PX
        if verdict in ("aligned", "coarse"):
            ratios[one.kind].append(error / one.bound_px())
        else:
            record.say(f"pair {number} ({one.kind}): {verdict}, error {error:.3g} px")
        if number % hinted_each == 0 or verdict not in ("aligned", "coarse"):
            for name, hints in _hints(one).items():
                rescued, error = _verdict(one, hints, bound)
                found[one.kind][f"{name} {rescued}"] += 1
                if rescued not in ("aligned", "coarse"):
                    record.say(f"pair {number} ({one.kind}), {name}: {rescued}, {error:.3g} px")
        start = time.process_time()
        peer = _peer_error_px(one)
        seconds["peer"].append(time.process_time() - start)
        found[one.kind]["peer within 4 bounds"] += peer <= WORST_FACTOR * bound
        found[one.kind]["peer loose"] += peer <= LOOSE_PX
    for kind, counts in found.items():
        text = ", ".join(f"{name} {count}" for name, count in sorted(counts.items()))
        middle = float(np.median(ratios[kind])) if ratios[kind] else float("nan")
        record.say(f"{kind:<9} {text}; error over the Cramer-Rao bound {middle:.2f}")
    total = sum(found.values(), Counter[str]())
    count = len(seconds["ours"])
    for limit, ours, theirs in (
        ("4 bounds", total["aligned"] + total["coarse"], total["peer within 4 bounds"]),
        (f"{LOOSE_PX:g} px", total["loose"], total["peer loose"]),
    ):
        name = f"pairs not aligned to {limit}, of {count}"
        record.figure(name, count - ours, "", PEER, count - theirs)
    ours_s, peer_s = (float(np.median(seconds[who])) for who in ("ours", "peer"))
    record.figure("processor time of a pair", ours_s, "s", PEER, peer_s)
    if total["wrong"]:
        sys.exit(f"{total['wrong']} pairs are silently wrong")


def _hints(one: Case) -> dict[str, RegistrationHints]:
    rng = np.random.default_rng(1)
    zoom = one.pair.pose.zoom
    shifted = one.pair.matrix.copy()
    shifted[:2, 2] += 3.0
    return {
        "zoom": RegistrationHints(zoom=zoom * 1.07),
        "matrix": RegistrationHints(matrix=shifted),
        "points": RegistrationHints(points=one.points(rng)),
        "mask": RegistrationHints(left_out=one.unshared()),
    }


def _verdict(one: Case, hints: RegistrationHints | None, bound: float) -> tuple[str, float]:
    """What became of a pair: aligned, coarse (within 4 bounds), warned, refused or wrong."""
    try:
        registration = register_images(one.reference, one.followup, None, hints)
    except RegistrationError:
        return "refused", float("inf")
    y, x = registration.pose.followup_places_px()
    error = one.pair.error_px(x, y)
    if error <= bound:
        return "aligned", error
    if error <= WORST_FACTOR * bound:
        return "coarse", error
    return ("warned" if registration.warnings else "wrong"), error


@benchmark(
    "numpy", "scipy", "opencv-contrib-python-headless", note="{pairs} pairs, {width_px} px wide"
)
def main(
    record: Recorder,
    *,
    pairs: int = 120,
    width_px: int = 780,
    seed: Annotated[int, "of the first pair"] = FIRST_SEED,
    hints: Annotated[int, "give the operator's hints to every so many-th pair"] = 10,
) -> None:
    if hints < 1:
        sys.exit("--hints must be at least 1")
    pairs = record.pick(pairs, 6)
    frame = (round(width_px * 580 / 780), width_px)
    cases = (_case(number, frame, seed) for number in range(pairs))
    _judge(record, cases, hints)
    _judge_steep(record, record.pick(tuple(SCENES), ("text",)))
    _judge_extremes(record, record.pick(tuple(SCENES), ("text",)))
