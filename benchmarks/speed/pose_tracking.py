"""Live pose: frames a second beside a full registration of each, and how often it is right.

A camera of 780 x 580 px moves on the simulated bench. First along a smooth path, as a hand moves
it, for the speed; the peer is ``register_images`` on every frame. Then at random poses that have
nothing to do with each other, for the verdicts: each is held against the one from the bench's own
homography; those within 5 % of the threshold do not count.

    OMP_NUM_THREADS=1 python -m benchmarks.speed.pose_tracking [--poses 200]
"""

import time
from math import cos, sin
from typing import Annotated

import cv2
import numpy as np
from numpy.typing import NDArray

from acquisition.bench import load_bench
from analysis.detectability import DetectabilityCurve
from analysis.pose import PoseTracker, pose_quality
from benchmarks.harness import Recorder, benchmark
from calibration.registration import register_images
from hil_mocks.truth import BenchTruth, CameraPose
from standoff.shipped_configs import shipped_config
from tests.analysis.random_poses import NEAR_MM, bench_truth, posed_frames, reference_frame, shot

TARGETS = ("coins", "gravel", "lesion")
PATH_FRAMES, FULL_FRAMES = 60, 4
MIN_D_PRIME, NEAR_THRESHOLD = 2.5, 0.05
# Shape of d' against zoom on the textures of docs/theory-detectability.md.
ZOOM = [1.0, 1.25, 1.5, 1.75, 2.0, 2.5, 3.0]
D_PRIME = [4.6, 3.5, 2.7, 2.1, 1.6, 1.05, 0.75]
CURVE = DetectabilityCurve(
    model="matched",
    observer="hotelling",
    noise_dn=2.0,
    contrast_dn=12.0,
    signal_sigma_px=2.0,
    zoom=ZOOM,
    dprime=D_PRIME,
    dprime_low=D_PRIME,
    dprime_high=D_PRIME,
    auc=[0.9] * len(ZOOM),
)

Image = NDArray[np.uint16]


def _path(truth: BenchTruth) -> list[Image]:
    """A hand that carries the camera up and back, and sways."""
    rng = np.random.default_rng(2)
    poses = [
        CameraPose(
            height_mm=NEAR_MM + 20 + 40 * sin(k / 12) ** 2,
            offset_x_mm=4 * sin(k / 9),
            offset_y_mm=3 * cos(k / 11),
            roll_deg=3 * sin(k / 10),
            tilt_x_deg=5 * cos(k / 8),
            tilt_y_deg=5 * sin(k / 7),
        )
        for k in range(PATH_FRAMES)
    ]
    return [shot(truth, "coins", pose, rng) for pose in poses]


def _speed(record: Recorder, truth: BenchTruth) -> None:
    reference, frames = reference_frame(truth, "coins", 0), _path(truth)
    tracker = PoseTracker(reference, CURVE, MIN_D_PRIME)
    took_s: list[float] = []
    anchor_s: list[float] = []
    for frame in frames:
        start = time.perf_counter()
        verdict = tracker.update(frame)
        (anchor_s if verdict.anchored else took_s).append(time.perf_counter() - start)
    full_s = []
    for frame in frames[:: PATH_FRAMES // FULL_FRAMES]:
        start = time.perf_counter()
        register_images(reference, frame)
        full_s.append(time.perf_counter() - start)
    followed, full = float(np.median(took_s)), float(np.median(full_s))
    record.say(f"{len(frames)} frames of a path: searched as a whole {tracker.anchors}")
    record.time("pose of a followed frame", followed, "full registration", full)
    record.say(f"slowest {1e3 * max(took_s):.0f} ms; an anchor {1e3 * max(anchor_s):.0f} ms")


def _verdicts(record: Recorder, truth: BenchTruth, count: int) -> None:
    decided = right = unknown = anchors = 0
    errors = []
    for number, target in enumerate(TARGETS):
        share = count // len(TARGETS) + (number < count % len(TARGETS))
        tracker = PoseTracker(reference_frame(truth, target, number), CURVE, MIN_D_PRIME)
        for frame in posed_frames(truth, target, share, number):
            found = tracker.update(frame.image_dn)
            size = frame.image_dn.shape[1], frame.image_dn.shape[0]
            true = pose_quality(frame.matrix, size, size, CURVE, MIN_D_PRIME)
            unknown += found.dprime is None
            if found.dprime is not None:
                errors.append(found.dprime / max(true.decisive_d_prime, 1e-9) - 1)
            if abs(true.decisive_d_prime / MIN_D_PRIME - 1) > NEAR_THRESHOLD:
                decided += 1
                right += found.accepted == true.is_accepted
        anchors += tracker.anchors
    record.say(f"{count} random poses: {anchors} searched as a whole, {unknown} not recognised")
    record.figure("random poses judged right", 100 * right / decided, "%")
    worst = np.percentile(np.abs(errors), [50, 95, 100])
    record.say("error of d': median {:.2%}, 95 % {:.2%}, largest {:.2%}".format(*worst))


@benchmark("numpy", "numba", "opencv-contrib-python-headless", note="OpenCV with one thread")
def main(
    record: Recorder,
    *,
    poses: Annotated[int | None, "number of random poses, 200 by default"] = None,
) -> None:
    cv2.setNumThreads(1)
    truth = bench_truth(load_bench(shipped_config("demo_bench.toml")), 780, 580)
    _speed(record, truth)
    _verdicts(record, truth, poses or record.pick(200, 30))
