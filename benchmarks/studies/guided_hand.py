"""Approaches of a hand that only follows the arrows of ``standoff guide``, and wrong scenes.

The hand (`truth.hand_held`) sways, trembles, blurs the picture by its motion, reacts late and
clumsily, and knows nothing of the scene. Guidance comes ``--poses`` times a second and is
``--age`` old when it is seen. The photograph is taken ``SHUTTER_S`` after the first good verdict
that was confirmed by the next one, and counts if the camera then stands within 3 % of the distance,
2 degrees and 2 % of the picture. The camera has a narrower view than the program assumes. Wrong
scenes are the views of each approach with each of the other references.

    python -m benchmarks.studies.guided_hand [--seed 1] [--quick]
"""

import time
from collections import deque
from dataclasses import dataclass
from math import inf
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from benchmarks.harness import Recorder, benchmark
from benchmarks.truth.hand_held import (
    EXPOSURE_S,
    Hand,
    HandHabits,
    HeldPose,
    PoseErrors,
    Wall,
    exposure_poses,
    start_pose,
)
from benchmarks.truth.pictures import catalogue
from standoff.console.guide import GuideReference, Judge, LiveGuidance

SCENES = (
    "astronaut", "brick", "camera", "coffee", "grass", "gravel", "ihc", "moon", "retina", "rocket",
)  # fmt: skip
FRAME, REFERENCE = (640, 480), (1600, 1200)
FOCAL_PER_SIDE = 0.9
STEP_S = 0.005
SHUTTER_S = 0.3
LONGEST_S = 15.0
DISTANCE_PERCENT, AIM_PERCENT, ANGLE_DEG = 3.0, 2.0, 2.0
_JPEG = [cv2.IMWRITE_JPEG_QUALITY, 60]


@dataclass(frozen=True, slots=True, kw_only=True)
class Approach:
    """How an approach ended: after how long, and how far from the reference's pose."""

    took_s: float
    errors: PoseErrors
    start: PoseErrors
    frames: tuple[bytes, ...]

    @property
    def is_guided(self) -> bool:
        """Whether the photograph was taken in time and from within the limits."""
        return self.took_s <= LONGEST_S and self.errors.is_within(
            DISTANCE_PERCENT, AIM_PERCENT, ANGLE_DEG
        )


def scene_levels(name: str) -> NDArray[np.float64]:
    """Grey levels of a picture of scikit-image, a landscape of 4 to 3."""
    (picture,) = catalogue().named([f"skimage/{name}"])
    levels = np.asarray(picture.levels(), dtype=np.float64)
    grey = levels if levels.ndim == 2 else levels.mean(axis=2)
    rows, cols = grey.shape
    high = min(rows, cols * 3 // 4)
    return grey[(rows - high) // 2 : (rows + high) // 2]


def reference_of(wall: Wall, path: Path, rng: np.random.Generator) -> GuideReference:
    """Take the reference, and read it as the program does."""
    levels = wall.resized(REFERENCE).seen([HeldPose()], rng)
    Image.fromarray(levels).save(path, quality=92)
    return GuideReference.read(path)


def frame_of(levels: NDArray[np.uint8]) -> bytes:
    """A frame as the phone sends it."""
    return cv2.imencode(".jpg", levels, _JPEG)[1].tobytes()


def approach(
    wall: Wall,
    reference: GuideReference,
    rng: np.random.Generator,
    *,
    period_s: float,
    age_s: float,
    habits: HandHabits | None = None,
) -> Approach:
    """Let a hand follow the arrows until the photograph is taken, or for the longest time."""
    start = start_pose(rng)
    hand = Hand(start, rng, max(FRAME) / wall.focal_px, habits)
    now_s = 0.0
    live = LiveGuidance(Judge(reference), clock=lambda: now_s)
    history = deque([start], maxlen=max(round(EXPOSURE_S / STEP_S), 2))
    pending: deque[tuple[float, list[tuple[str, float]], bool]] = deque()
    frames: list[bytes] = []
    shutter_s, was_good = inf, False
    for step in range(round((LONGEST_S + 1) / STEP_S)):
        now_s = step * STEP_S
        pose = hand.move(STEP_S)
        history.append(pose)
        if now_s >= shutter_s:
            break
        if step % round(period_s / STEP_S) == 0:
            frames.append(frame_of(wall.seen(exposure_poses(list(history)), rng)))
            found = live.look(frames[-1])
            arrows = [(arrow.name, arrow.amount) for arrow in found.arrows]
            pending.append((now_s + age_s, arrows, found.verdict == "go"))
        while pending and pending[0][0] <= now_s:
            _, arrows, is_good = pending.popleft()
            hand.show([] if is_good else arrows)
            if is_good and was_good and shutter_s == inf:
                shutter_s = now_s + SHUTTER_S
            was_good = is_good
    took_s = shutter_s if now_s >= shutter_s else inf
    return Approach(
        took_s=took_s,
        errors=wall.errors(pose),
        start=wall.errors(start),
        frames=tuple(frames),
    )


def pairs_of(frames: tuple[bytes, ...], stride: int) -> list[bytes]:
    """Every so many-th frame with the one after it: alone, none is good, as motion is not known."""
    return [frame for at in range(0, len(frames) - 1, stride) for frame in frames[at : at + 2]]


def greens(reference: GuideReference, pairs: list[bytes], period_s: float) -> int:
    """How many frames of another scene are called good, taken ``period_s`` apart."""
    now_s = 0.0
    live = LiveGuidance(Judge(reference), clock=lambda: now_s)
    found = 0
    for frame in pairs:
        now_s += period_s
        found += live.look(frame).verdict == "go"
    return found


def search_s(reference: GuideReference, frame: bytes) -> float:
    """Seconds of processor time in which a scene is found that was hidden before; inf if not."""
    live = LiveGuidance(Judge(reference))
    live.look(frame)
    live.look(frame_of(np.full(FRAME[::-1], 20, np.uint8)))
    begin_s = time.process_time()
    is_found = live.look(frame).deviation is not None
    return time.process_time() - begin_s if is_found else inf


def through_lens(levels: NDArray[np.uint8], k1: float, zoom: float) -> NDArray[np.uint8]:
    """A frame of another lens: radii grow by ``1 + k1 r**2`` (r = 1 in the corners) times zoom."""
    rows, cols = levels.shape
    y, x = np.mgrid[:rows, :cols].astype(np.float32)
    centre_x, centre_y = (cols - 1) / 2, (rows - 1) / 2
    x, y = (x - centre_x) / zoom, (y - centre_y) / zoom
    stretch = 1 - k1 * (x**2 + y**2) / np.float32(centre_x**2 + centre_y**2)  # to first order in k1
    made = cv2.remap(
        levels,
        (centre_x + stretch * x).astype(np.float32),
        (centre_y + stretch * y).astype(np.float32),
        cv2.INTER_CUBIC,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return np.asarray(made, np.uint8)


def misled(reference: GuideReference, frame: NDArray[np.uint8]) -> dict[str, float]:
    """What is said of a frame that was taken from the reference's own pose by another lens.

    It is the second of its kind: the first one tells the lens.
    """
    live = LiveGuidance(Judge(reference))
    live.look(frame_of(frame), taken_s=0.0)
    found = live.look(frame_of(frame), taken_s=0.2).deviation
    if found is None:
        return dict.fromkeys(("distance", "aim", "tilt", "turn"), inf)
    return {str(name): cost for name, cost in found.costs.items()}


def _text(errors: PoseErrors) -> str:
    return (
        f"{errors.distance_percent:5.1f} {errors.aim_percent:5.1f} {errors.tilt_deg:5.1f} "
        f"{errors.turn_deg:5.1f}"
    )


LENSES = {"k1": (0.01, 0.02, 0.05, 0.1), "breathing, %": (1.0, 2.0, 3.0, 5.0)}


def _lenses(
    record: Recorder, walls: dict[str, Wall], references: dict[str, GuideReference]
) -> None:
    """What a lens does to the verdict that is not the reference's, or focuses elsewhere."""
    record.say("\n  at the reference's pose: cost in tolerances, median of the scenes and largest")
    rng = np.random.default_rng(1)
    for kind, values in LENSES.items():
        for value in values:
            k1, zoom = (value, 1.0) if kind == "k1" else (0.0, 1 + value / 100)
            costs = [
                max(
                    misled(
                        references[name], through_lens(wall.seen([HeldPose()], rng), k1, zoom)
                    ).values()
                )
                for name, wall in walls.items()
            ]
            record.say(f"  {kind:14} {value:5g} {np.median(costs):8.2f} {max(costs):8.2f}")
            record.figure(f"{kind} {value:g}: largest cost", max(costs), "tolerances")


@benchmark("numpy", "scipy", "opencv-contrib-python-headless")
def main(
    record: Recorder,
    *,
    seed: Annotated[int, "of hands and noise"] = 1,
    poses: Annotated[float, "verdicts a second"] = 5.0,
    age: Annotated[float, "of the guidance when it is seen, in s"] = 0.25,
) -> None:
    """Guide a hand before ten pictures, and show it the wrong ones."""
    names = SCENES[: record.pick(len(SCENES), 3)]
    runs: dict[str, Approach] = {}
    walls: dict[str, Wall] = {}
    references: dict[str, GuideReference] = {}
    record.say(f"  {'scene':10} start: %, aim, tilt, turn    took s   left: %, aim, tilt, turn")
    with TemporaryDirectory() as folder:
        for number, name in enumerate(names):
            rng = np.random.default_rng([seed, number])
            wall = walls[name] = Wall.of(scene_levels(name), FRAME, FOCAL_PER_SIDE)
            references[name] = reference_of(wall, Path(folder) / f"{name}.jpg", rng)
            run = approach(wall, references[name], rng, period_s=1 / poses, age_s=age)
            runs[name] = run
            record.say(f"  {name:10} {_text(run.start)} {run.took_s:8.2f}   {_text(run.errors)}")
    guided = sum(run.is_guided for run in runs.values())
    shown = {name: pairs_of(runs[name].frames, record.pick(10, 20)) for name in names}
    wrong = sum(
        greens(references[one], shown[other], 1 / poses)
        for one in names
        for other in names
        if one != other
    )
    count = (len(names) - 1) * sum(map(len, shown.values()))
    again = [search_s(references[name], runs[name].frames[0]) for name in names]
    record.say(
        f"\n{guided} of {len(names)} guided; {wrong} good verdicts on {count} frames of wrong "
        "scenes"
    )
    _lenses(record, walls, references)
    record.figure("guided", guided, f"of {len(names)}")
    record.figure("longest approach", max(run.took_s for run in runs.values()), "s")
    record.figure("good verdicts on wrong scenes", wrong, "frames")
    record.figure("search, processor time, median", 1e3 * float(np.median(again)), "ms")
    record.figure("search, processor time, slowest", 1e3 * max(again), "ms")
