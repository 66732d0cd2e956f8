"""Time and memory of ``find_changes``, registration included, beside one warp and one blur.

Two grey photographs of a texture from two poses, 8 bits, without a PSF, compared whole: the
alignment, the fit and the list. The peer is one ``cv2.warpPerspective`` (cubic, float32) by the
pair's homography and one ``cv2.GaussianBlur`` (1 px) of the same frame in the same process. All are
seconds of the processor on one thread, after a first small pair that compiles and loads everything.
The peak resident memory is that of a process that does nothing but this. With the follow-up
nearer, the comparison is on the reference's pixels and its maps are brought to the follow-up's.

    python -m benchmarks.bench_change_time
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from dataclasses import dataclass
from statistics import median

import cv2
import numpy as np

from benchmarks.harness import Recorder, bench_parser
from benchmarks.pair_photographs import PairPose
from simulation.arrays import AnyArray, Float32Array, FloatArray

FRAMES = ((580, 780), (3000, 4000))
ZOOMS = (1.2, 0.8)
NOISE_DN, CONTRAST_DN, MEAN_DN = 1.2, 30.0, 110.0
BLUR_PX = 0.8
FINER = 1.6
"""Pixels of the drawn scene to one of the reference: a timing asks for no truer photograph."""

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True, slots=True, kw_only=True)
class Cost:
    """Processor seconds of a comparison and of the peer, and peak resident memory in GB."""

    find_s: float
    peer_s: float
    peak_gb: float
    changes: int


def scene(frame: tuple[int, int], seed: int) -> Float32Array:
    """Noise of all scales, drawn ``FINER`` times as fine as the frame."""
    rng = np.random.default_rng(seed)
    rows, cols = (int(n * FINER) for n in frame)
    drawn = np.zeros((rows, cols), dtype=np.float32)
    step = 2
    while step < cols // 5:
        coarse = rng.standard_normal((rows // step + 3, cols // step + 3), dtype=np.float32)
        drawn += cv2.resize(coarse, (cols, rows), interpolation=cv2.INTER_CUBIC) * step**0.35
        step *= 2
    drawn = (drawn - drawn.mean()) * (CONTRAST_DN / drawn.std()) + MEAN_DN
    return np.asarray(cv2.GaussianBlur(drawn, (0, 0), BLUR_PX * FINER), dtype=np.float32)


def photographs(frame: tuple[int, int], zoom: float) -> tuple[AnyArray, AnyArray, FloatArray]:
    """Reference, follow-up, and the homography from the follow-up to the reference."""
    pose = PairPose(zoom=zoom, tilt_deg=4.0, bearing_deg=30.0, turn_deg=3.0, shift=(0.03, -0.02))
    drawn, matrix = scene(frame, 1), pose.matrix(frame)
    finer = np.diag([FINER, FINER, 1.0])
    made = []
    for seed, towards in enumerate((np.eye(3), matrix)):
        seen = cv2.warpPerspective(
            drawn,
            finer @ towards,
            frame[::-1],
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_REFLECT,
        )
        noise = np.random.default_rng(seed).standard_normal(frame, dtype=np.float32)
        made.append(np.clip(np.rint(seen + NOISE_DN * noise), 0, 255).astype(np.uint8))
    return made[0], made[1], matrix


def cost(frame: tuple[int, int], zoom: float, rounds: int) -> Cost:
    """Measure in this process, which must be a fresh one on one thread."""
    # So that start-up is not timed.
    from analysis.changes import find_changes

    cv2.setNumThreads(1)
    small = photographs(FRAMES[0], zoom)
    find_changes(small[0], small[1])
    reference, followup, matrix = photographs(frame, zoom)
    levels = reference.astype(np.float32)
    find_s, peer_s, changes = [], [], 0
    for _ in range(rounds):
        for _ in range(3):
            start_s = time.process_time()
            seen = cv2.warpPerspective(
                levels, matrix, frame[::-1], flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
            )
            cv2.GaussianBlur(seen, (0, 0), 1.0)
            peer_s.append(time.process_time() - start_s)
        start_s = time.process_time()
        changes = len(find_changes(reference, followup).summary.changes)
        find_s.append(time.process_time() - start_s)
    peak_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return Cost(
        find_s=median(find_s), peer_s=median(peer_s), peak_gb=peak_kib / 2**20, changes=changes
    )


def measured_apart(frame: tuple[int, int], zoom: float, rounds: int) -> Cost:
    """The same in a process of its own."""
    given = json.dumps({"frame": frame, "zoom": zoom, "rounds": rounds})
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.bench_change_time", "--worker", given],
        env={**os.environ, **dict.fromkeys(_THREADS, "1")},
        stdout=subprocess.PIPE,
        check=True,
        text=True,
    )
    return Cost(**json.loads(done.stdout))


def work(given: str) -> None:
    """Measure as asked, and print the cost."""
    asked = json.loads(given)
    found = cost(tuple(asked["frame"]), asked["zoom"], asked["rounds"])
    print(json.dumps({name: getattr(found, name) for name in Cost.__slots__}))


def compare(record: Recorder) -> None:
    """A line for each frame and direction."""
    for frame in FRAMES:
        for zoom in ZOOMS:
            is_large = frame != FRAMES[0]
            found = measured_apart(frame, zoom, record.pick(3, 1))
            name = f"{frame[1]}x{frame[0]}, zoom {zoom:g}"
            record.say(
                f"{name}: {found.find_s:.2f} s, {found.find_s / found.peer_s:.0f} times a warp and "
                f"a blur ({1e3 * found.peer_s:.1f} ms); peak {found.peak_gb:.2f} GB; "
                f"{found.changes} changes"
            )
            record.figure(
                f"changes, {name}",
                found.find_s,
                "s",
                peer="warp and blur",
                peer_value=found.peer_s,
            )
            if is_large:
                record.figure(f"peak resident memory, {name}", found.peak_gb, "GB")


def main() -> None:
    parser = bench_parser(__doc__)
    parser.add_argument("--worker", metavar="JSON", help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.worker is not None:
        work(given.worker)
        return
    note = "one thread, seconds of the processor"
    with Recorder.of(
        given,
        "change_time",
        packages=("numpy", "opencv-contrib-python-headless", "numba"),
        note=note,
    ) as record:
        compare(record)


if __name__ == "__main__":
    main()
