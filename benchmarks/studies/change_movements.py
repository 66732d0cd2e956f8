"""Movements told from changes: parallax and things that moved, spots, and what appeared.

Rendered: scenes with relief, smooth or with hard steps, of up to 4 px; things of 6 to 20 px that
moved by 1 to 3 px, or by 6 to 15; patches that appeared or vanished; spots of widths 1 to 6 px and
1.3 to 6 times what is just detectable in unchanged scenes. Real photographs, of scenes that are
not flat, where ``STANDOFF_REAL_DATA`` names a folder that holds ``planar_pairs``: the pixels that
are left, and the same spots on the follow-up.

    OMP_NUM_THREADS=1 python -m benchmarks.studies.change_movements
    STANDOFF_REAL_DATA=/path/to/data python -m benchmarks.studies.change_movements
"""

from dataclasses import dataclass, replace
from math import hypot, log, pi

import cv2
import numpy as np

from analysis.changes import Change, ChangeOptions, ChangeResult, ChangeSummary, changes_between
from analysis.errors import AnalysisError
from benchmarks.harness import Recorder, benchmark, real_data
from benchmarks.studies.change_list import FRAME, KINDS, POSES
from benchmarks.truth.pairs import (
    DEFAULT_CAMERA as CAMERA,
    Bump,
    Development,
    FlatScene,
    Layer,
    PairPose,
    ReliefScene,
    photograph,
    relief_pair,
    scene,
)
from simulation.arrays import FloatArray

SHOT = Development(noise_dn=1.2)
CONTRAST_DN = 25.0
FRAMES, SPOT_FRAMES = 20, 60
SPOT_SIGMA_PX, SPOT_HEIGHT = (1.0, 6.0), (1.3, 6.0)
REAL = ("BruggeSquare", "adam", "Eiffel", "CapitalRegion", "Brussels", "boat", "LePoint1")

Pair = tuple[FloatArray, FloatArray]


@dataclass(frozen=True, slots=True, kw_only=True)
class _Spot:
    """A spot painted on a follow-up; height in what is just detectable there."""

    x_px: float
    y_px: float
    sigma_px: float
    height: float


def _developed(pair: Pair, seed: int) -> Pair:
    """Both with noise of their own."""
    return SHOT.of(pair[0], 2 * seed), SHOT.of(pair[1], 2 * seed + 1)


def _apart(
    rng: np.random.Generator, count: int, margin_px: float, apart_px: float
) -> list[tuple[float, float]]:
    """At most so many places (x, y) in a frame, far from one another."""
    rows, cols = FRAME
    chosen: list[tuple[float, float]] = []
    for _ in range(3000):
        x = rng.uniform(margin_px, cols - margin_px)
        y = rng.uniform(margin_px, rows - margin_px)
        if all(hypot(x - a, y - b) > apart_px for a, b in chosen):
            chosen.append((x, y))
            if len(chosen) == count:
                break
    return chosen


def _ground_of(number: int, first_seed: int) -> tuple[FlatScene, PairPose]:
    """Scene and pose of a frame."""
    kind, pose = KINDS[number % len(KINDS)], POSES[number // len(KINDS) % len(POSES)]
    return scene(kind, FRAME, first_seed + number, contrast_dn=CONTRAST_DN), pose


def _relief(number: int, *, is_hard: bool) -> tuple[float, float]:
    """Pixels listed as changes: with depth and movements followed, and on one plane without.

    Of a scene whose bumps, or layers, are displaced by 1 to 4 px along one direction.
    """
    rng = np.random.default_rng(4000 + number + (500 if is_hard else 0))
    ground, pose = _ground_of(number, 700)
    angle, bumps, layers = rng.uniform(0, 2 * pi), list[Bump](), list[Layer]()
    front = scene(
        KINDS[(number + 2) % 5], FRAME, 1700 + number, contrast_dn=CONTRAST_DN, mean_dn=120.0
    )
    for place in _apart(rng, 5 if is_hard else 4, 45.0, 70.0):
        way = rng.uniform(1, 4)
        shift = (way * np.cos(angle), way * np.sin(angle))
        if is_hard:
            half, turn, is_round = rng.uniform(10, 28, 2), rng.uniform(0, 90), rng.uniform() < 0.3
            layers.append(_layer(front, place, (half[0], half[1]), turn, shift, is_round=is_round))
        else:
            bumps.append(Bump(centre_px=place, width_px=rng.uniform(12, 30), shift_px=shift))
    made = ReliefScene(ground=ground, bumps=tuple(bumps), layers=tuple(layers))
    pair = _developed(relief_pair(made, FRAME, pose), number)
    follows = ChangeOptions(pose=pose.known(FRAME))
    left, plain = (
        sum(one.area_px for one in changes_between(*pair, options=options).summary.changes)
        for options in (follows, replace(follows, flat=True, count_moved=True))
    )
    return left, plain


def _layer(
    front: FlatScene,
    centre_px: tuple[float, float],
    half_px: tuple[float, float],
    angle_deg: float,
    shift_px: tuple[float, float],
    *,
    is_round: bool,
) -> Layer:
    """A layer; round ones have one radius."""
    return Layer(
        scene=front,
        centre_px=centre_px,
        half_px=(half_px[0], half_px[0]) if is_round else half_px,
        angle_deg=angle_deg,
        is_round=is_round,
        shift_px=shift_px,
    )


def _things(
    number: int, ways_px: tuple[float, float], first_seed: int
) -> tuple[ReliefScene, PairPose]:
    """Things that move over a ground, 6 to 20 px wide, all in px of the coarser photograph."""
    rng = np.random.default_rng(first_seed + number)
    ground, pose = _ground_of(number, 2700)
    coarse = max(1.0, pose.zoom)
    level = 110 + rng.choice([-1, 1]) * rng.uniform(20, 50)
    front = scene("texture", FRAME, 3700 + number, contrast_dn=20.0, mean_dn=level)
    layers = []
    for place in _apart(rng, 6, 45.0, 75.0):
        way, angle = rng.uniform(*ways_px) * coarse, rng.uniform(0, 2 * pi)
        half, turn, is_round = (
            coarse * rng.uniform(3, 10, 2),
            rng.uniform(0, 90),
            rng.uniform() < 0.5,
        )
        shift = (way * np.cos(angle), way * np.sin(angle))
        layers.append(_layer(front, place, (half[0], half[1]), turn, shift, is_round=is_round))
    return ReliefScene(ground=ground, layers=tuple(layers)), pose


def _reliefs(record: Recorder, frames: int) -> None:
    """Pixels that parallax leaves among the changes."""
    for is_hard, name in ((False, "smooth relief"), (True, "relief with hard steps")):
        for half, which in ((0, "first half"), (1, "second half, kept back")):
            numbers = range(half, frames, 2)
            each = np.array([_relief(number, is_hard=is_hard) for number in numbers])
            left, plain = each.mean(axis=0)
            record.figure(f"pixels left a frame, {name}, {which}", left, "px", "one plane", plain)


def _moved_things(record: Recorder, frames: int) -> None:
    """Entries and shifts of things that moved."""
    for ways, name in (((1.0, 3.0), "1 to 3 px"), ((6.0, 15.0), "6 to 15 px")):
        listed = once = 0
        errors = list[float]()
        for number in range(frames):
            made, pose = _things(number, ways, 9000 if ways[0] < 5 else 9500)
            pair = _developed(relief_pair(made, FRAME, pose), number)
            true_pose = pose.known(FRAME)
            found = changes_between(*pair, options=ChangeOptions(pose=true_pose)).summary
            for one in made.layers:
                x, y = np.array([one.centre_px, np.add(one.centre_px, one.shift_px)]).T
                rows, cols = true_pose.to_followup_px(y, x)
                reach = 1.3 * max(one.half_px) / pose.zoom + 4.0
                near = [
                    entry
                    for entry in (*found.changes, *found.moved)
                    if min(np.hypot(entry.x_px - cols, entry.y_px - rows)) < reach
                ]
                listed += bool(near)
                once += len(near) == 1 and near[0].is_moved
                shifts = [entry for entry in near if entry.displacement_px is not None]
                if shifts:
                    largest = max(shifts, key=lambda entry: entry.area_px)
                    dx, dy = largest.displacement_px or (0.0, 0.0)
                    coarser = min(1.0, pose.zoom)
                    off = hypot(dx - (cols[1] - cols[0]), dy - (rows[1] - rows[0]))
                    errors.append(off * coarser)
        right = 100 * float(np.mean(np.array(errors) < 0.3))
        record.say(
            f"things that moved by {name}: {listed} listed, {once} as one movement alone; "
            f"{len(errors)} with a shift, {right:.1f} % right to 0.3 px of the coarser photograph, "
            f"median error {np.median(errors):.3f} px"
        )
        record.figure(f"things moved by {name} listed once", 100 * once / listed, "%")
        record.figure(f"shifts of {name} right to 0.3 px", right, "%")


def _appeared(record: Recorder, frames: int) -> None:
    """Patches that are in one photograph alone: none of them moved."""
    total = taken = 0.0
    for number in range(frames):
        made, pose = _things(number, (0.0, 0.0), 12000)
        bare = ReliefScene(ground=made.ground)
        first, second = (bare, made) if number % 2 else (made, bare)
        pair = (
            photograph(first, FRAME, PairPose(), CAMERA),
            photograph(second, FRAME, pose, CAMERA),
        )
        options = ChangeOptions(pose=pose.known(FRAME))
        found = changes_between(*_developed(pair, number), options=options).summary
        taken += sum(one.area_px for one in found.moved)
        total += sum(one.area_px for one in (*found.changes, *found.moved))
    share = 100 * taken / total
    record.say(f"patches that appeared or vanished: {taken:.0f} of {total:.0f} px as moved")
    record.figure("pixels of what appeared or vanished taken for movements", share, "%")


def _painted(
    rng: np.random.Generator, result: ChangeResult, followup: FloatArray, count: int
) -> tuple[FloatArray, list[_Spot]]:
    """The follow-up with spots, half of them on edges, away from what is listed already."""
    changed, valid = (image.astype(np.uint8) for image in (~result.is_change, result.valid))
    far = cv2.distanceTransform(changed, cv2.DIST_L2, 5)
    inner = cv2.distanceTransform(valid, cv2.DIST_L2, 5)
    sd, coarse = np.sqrt(result.variance_dn2), max(1.0, 1 / result.pose.zoom)
    image, spots = np.array(followup, dtype=np.float64), list[_Spot]()
    soft = cv2.GaussianBlur(image, (0, 0), 1.0)
    slope = np.hypot(*np.gradient(soft))
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    candidates = np.argwhere(inner > 14)
    for _ in range(3000):
        row, col = candidates[rng.integers(len(candidates))]
        if len(spots) % 2:
            near = slope[row - 6 : row + 7, col - 6 : col + 7]
            down, along = np.unravel_index(int(near.argmax()), near.shape)
            row, col = row - 6 + down, col - 6 + along
        sigma = coarse * float(np.exp(rng.uniform(log(SPOT_SIGMA_PX[0]), log(SPOT_SIGMA_PX[1]))))
        is_near = any(hypot(col - one.x_px, row - one.y_px) < 36 for one in spots)
        if is_near or inner[row, col] < 8 or far[row, col] < 3 * hypot(sigma, coarse) + 4:
            continue
        height = rng.uniform(*SPOT_HEIGHT) * rng.choice([-1, 1])
        detectable = result.summary.threshold_sd * sd[row, col] * (sigma**2 + coarse**2) / sigma**2
        square = (x - col) ** 2 + (y - row) ** 2
        image += height * detectable * np.exp(-square / (2 * sigma**2))
        spots.append(_Spot(x_px=float(col), y_px=float(row), sigma_px=sigma, height=height))
        if len(spots) == count:
            break
    return image, spots


def _judged(spots: list[_Spot], found: ChangeSummary) -> tuple[int, int]:
    """Spots that are listed, and those that are listed as moved."""

    def is_at(spot: _Spot, change: Change) -> bool:
        reach = 1.2 * hypot(spot.sigma_px, 1.0) + 1.5
        return hypot(change.x_px - spot.x_px, change.y_px - spot.y_px) < reach

    taken = sum(any(is_at(spot, change) for change in found.moved) for spot in spots)
    both = (*found.changes, *found.moved)
    return sum(any(is_at(spot, change) for change in both) for spot in spots), taken


def _rendered_spots(record: Recorder, frames: int) -> None:
    """Spots on unchanged scenes."""
    total = taken = 0
    for number in range(frames):
        ground, pose = _ground_of(number, 900)
        made = relief_pair(ReliefScene(ground=ground), FRAME, pose)
        reference, followup = _developed(made, number)
        options = ChangeOptions(pose=pose.known(FRAME))
        rng = np.random.default_rng(7000 + number)
        clean = changes_between(reference, followup, options=options)
        image, spots = _painted(rng, clean, followup, 14)
        found = changes_between(reference, image, options=options).summary
        listed, moved = _judged(spots, found)
        total, taken = total + listed, taken + moved
    record.say(f"spots on unchanged scenes: {total} listed, {taken} as moved")
    record.figure("spots on unchanged scenes taken for movements", 100 * taken / total, "%")


def _real_pairs(record: Recorder, repeats: int) -> None:
    """Pixels left of real pairs, time, and spots on their follow-ups."""
    folder = real_data("planar_pairs")
    if folder is None:
        record.say("STANDOFF_REAL_DATA does not name a folder of real photographs: none compared")
        return
    total = taken = 0
    for name in REAL:
        images = [cv2.imread(str(next(folder.glob(f"{name}{side}.*"))), 0) for side in "AB"]
        reference, followup = (np.asarray(image, dtype=np.float64) for image in images)
        try:
            result = changes_between(reference, followup)
        except AnalysisError as error:
            record.say(f"{name}: {error}")
            continue
        found = result.summary
        left, moved = (
            sum(one.area_px for one in entries) for entries in (found.changes, found.moved)
        )
        record.say(
            f"{name}: {len(found.changes)} changes of {left:.0f} px left, "
            f"{len(found.moved)} movements of {moved:.0f} px"
        )
        if left + moved > 0:
            record.figure(f"pixels left, {name}", 100 * left / (left + moved), "%")
        options = ChangeOptions(pose=result.pose)
        for repeat in range(repeats):
            rng = np.random.default_rng(50 + repeat)
            image, spots = _painted(rng, result, followup, 25)
            listed, as_moved = _judged(
                spots, changes_between(reference, image, options=options).summary
            )
            total, taken = total + listed, taken + as_moved
    record.say(f"spots on real follow-ups: {total} listed, {taken} as moved")
    record.figure("spots on real follow-ups taken for movements", 100 * taken / total, "%")


@benchmark("numpy", "scipy", "numba")
def main(record: Recorder) -> None:
    _reliefs(record, record.pick(FRAMES, 4))
    _moved_things(record, record.pick(FRAMES, 3))
    _appeared(record, record.pick(FRAMES, 3))
    _rendered_spots(record, record.pick(SPOT_FRAMES, 4))
    _real_pairs(record, record.pick(3, 1))
