"""Time and memory of ``changes_between``, registration included, beside one warp and one blur.

Two grey photographs of a texture from two poses, 8 bits, without a PSF, compared whole: the
alignment, the fit and the list. The peer is one ``cv2.warpPerspective`` (cubic, float32) by the
pair's homography and one ``cv2.GaussianBlur`` (1 px) of the same frame in the same process. All are
seconds of the processor on one thread, after a first small pair that compiles and loads everything.
The peak resident memory is that of a process that does nothing but this. With the follow-up
nearer, the comparison is on the reference's pixels and its maps are brought to the follow-up's.

    python -m benchmarks.speed.change_time
"""

import resource
import time
from dataclasses import dataclass
from itertools import product
from statistics import median

import cv2
import numpy as np

from benchmarks.harness import Recorder, apart, benchmark
from benchmarks.truth.pairs import PairPose
from simulation.arrays import AnyArray, Float32Array, FloatArray

FRAMES = ((580, 780), (3000, 4000))
ZOOMS = (1.2, 0.8)
NOISE_DN, CONTRAST_DN, MEAN_DN = 1.2, 30.0, 110.0
BLUR_PX = 0.8
FINER = 1.6
"""Pixels of the drawn scene to one of the reference: a timing asks for no truer photograph."""

_THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True, slots=True, kw_only=True)
class _Cost:
    """Processor seconds of a comparison and of the peer, and peak resident memory in GB."""

    find_s: float
    peer_s: float
    peak_gb: float


def _scene(frame: tuple[int, int], seed: int) -> Float32Array:
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


def _photographs(frame: tuple[int, int], zoom: float) -> tuple[AnyArray, AnyArray, FloatArray]:
    """Reference, follow-up, and the homography from the follow-up to the reference."""
    pose = PairPose(zoom=zoom, tilt_deg=4.0, bearing_deg=30.0, turn_deg=3.0, shift=(0.03, -0.02))
    drawn, matrix = _scene(frame, 1), pose.matrix(frame)
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


def _cost(frame: tuple[int, int], zoom: float, rounds: int) -> _Cost:
    """Measure in this process, which must be a fresh one on one thread."""
    # So that start-up is not timed.
    from analysis.changes import changes_between

    cv2.setNumThreads(1)
    small = _photographs(FRAMES[0], zoom)
    changes_between(small[0], small[1])
    reference, followup, matrix = _photographs(frame, zoom)
    levels = reference.astype(np.float32)
    find_s, peer_s = [], []
    for _ in range(rounds):
        for _ in range(3):
            start_s = time.process_time()
            seen = cv2.warpPerspective(
                levels, matrix, frame[::-1], flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
            )
            cv2.GaussianBlur(seen, (0, 0), 1.0)
            peer_s.append(time.process_time() - start_s)
        start_s = time.process_time()
        changes_between(reference, followup)
        find_s.append(time.process_time() - start_s)
    peak_kib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return _Cost(find_s=median(find_s), peer_s=median(peer_s), peak_gb=peak_kib / 2**20)


@benchmark(
    "numpy", "opencv-contrib-python-headless", "numba", note="one thread, seconds of the processor"
)
def main(record: Recorder) -> None:
    for frame, zoom in product(FRAMES, ZOOMS):
        found = apart(_cost, frame, zoom, record.pick(3, 1), **dict.fromkeys(_THREADS, "1"))
        name = f"{frame[1]}x{frame[0]}, zoom {zoom:g}"
        record.figure(f"changes, {name}", found.find_s, "s", "warp and blur", found.peer_s)
        if frame != FRAMES[0]:
            record.figure(f"peak resident memory, {name}", found.peak_gb, "GB")
