"""Exposure brackets on the simulated bench: the light, its errors, and stale frames.

Run with ``python -m benchmarks.studies.bracket``. The scene is the step tablet of 10,000 : 1, the
camera's exposure takes effect up to six frames late, and the truth is the bench's own. The peer is
a merge with the same frames by the weights of Debevec and Malik (1997), a hat over the levels.
"""

from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from acquisition.averaging import AveragedFrames
from acquisition.bracket import merge_bracket
from acquisition.exposure_control import ExposedFrames, ExposureControl
from benchmarks.harness import Recorder, benchmark
from hil_mocks import SimulatedBench
from tests.acquisition.watched_camera import WatchedCamera
from tests.hil_mocks.benches import bench_config

SHORTEST_US = 9000.0
RATIOS = (1.0, 10.0, 100.0, 1000.0)
FRAMES = 10
CAPTURES = 256
"""Of 4 x 10 frames: 10,240."""

DELAYS = ((0, 0), (0, 2), (0, 6), (3, 12))
BLACK_DN, TOP_DN = 64.0, 4095.0

BENCH = bench_config(
    camera__exposure_us=SHORTEST_US,
    camera__frame_rate_hz=60.0,
    # A pixel so large that 96 of them see the whole tablet.
    optics__pixel_pitch_um=60.0,
    simulated__height_px=80,
)


@dataclass(kw_only=True)
class _Tally:
    """Sums over captures, by pixel."""

    light: NDArray[np.float64]
    captures: int = 0
    frames: int = 0
    stale: int = 0
    refused: int = 0
    inside: int = 0
    intervals: int = 0
    total: NDArray[np.float64] = field(default_factory=lambda: np.zeros(()))
    squares: NDArray[np.float64] = field(default_factory=lambda: np.zeros(()))
    variance: NDArray[np.float64] = field(default_factory=lambda: np.zeros(()))
    hat: NDArray[np.float64] = field(default_factory=lambda: np.zeros(()))

    def add(self, camera: WatchedCamera, taken: tuple[ExposedFrames, ...]) -> None:
        """Add a capture of the bracket."""
        for one in taken:
            self.frames += len(one.raw_frames)
            self.refused += one.averaged.stale_frames
            self.stale += sum(
                camera.true_us[image.tobytes()] != one.exposure_us for image in one.raw_frames
            )
        camera.true_us.clear()
        averages = [one.averaged for one in taken]
        merged = merge_bracket(
            [one.exposure_us for one in taken],
            averages,
            black_level_dn=BLACK_DN,
            max_level_dn=TOP_DN,
        )
        averaged = merged.averaged
        found = averaged.mean_dn.astype(np.float64) - BLACK_DN
        variance = averaged.variance_dn2.astype(np.float64) / averaged.frames_used
        pulls = (found - self.light) / np.sqrt(variance)
        valid = merged.exposures_used > 0
        self.inside += int(np.count_nonzero(np.abs(pulls[valid]) < 1.96))
        self.intervals += int(np.count_nonzero(valid))
        self.captures += 1
        self.total = self.total + found
        self.squares = self.squares + (found - self.light) ** 2
        self.variance = self.variance + variance
        self.hat = self.hat + _hat_merge(averages)


def _hat_merge(averages: list[AveragedFrames]) -> NDArray[np.float64]:
    """Light by the weights of Debevec and Malik, equation 4: largest at the middle of the range."""
    weights = [np.minimum(one.mean_dn, TOP_DN - one.mean_dn).astype(np.float64) for one in averages]
    light = [(one.mean_dn - BLACK_DN) / ratio for one, ratio in zip(averages, RATIOS, strict=True)]
    summed = sum(w * x for w, x in zip(weights, light, strict=True))
    return np.asarray(summed / np.maximum(sum(weights), 1e-9))


def _captured(delay: tuple[int, int], captures: int, seed: int) -> _Tally:
    """Capture the tablet by a camera whose exposure is late."""
    bench = SimulatedBench(BENCH)
    bench.stage.home(60)
    bench.stage.move_to(200.0, 60)
    bench.place("step tablet")
    camera = WatchedCamera(bench.camera, delay, seed)
    control = ExposureControl(camera, SHORTEST_US, lambda: bench.clock.now_s)
    exposures_us = [SHORTEST_US * ratio for ratio in RATIOS]
    level = bench.truth.expected_image_dn("step tablet", 0.0, bench.pose, exposure_us=SHORTEST_US)
    tally = _Tally(light=level - BLACK_DN)
    for _ in range(captures):
        tally.add(camera, control.bracket(FRAMES, exposures_us, keep_frames=True))
    return tally


def _compare(record: Recorder) -> None:
    """Print one line for each delay, and the accuracy over all decades for all of them."""
    captures = record.pick(CAPTURES, 4) // len(DELAYS) or 1
    tallies = []
    for number, delay in enumerate(DELAYS):
        tally = _captured(delay, captures, seed=number)
        record.say(
            f"exposure {delay[0]} to {delay[1]} frames late: {tally.frames} frames used, "
            f"{tally.stale} of them stale, {tally.refused} refused"
        )
        tallies.append(tally)
    light = tallies[0].light
    count = sum(one.captures for one in tallies)
    mean = np.sum([one.total for one in tallies], axis=0) / count
    hat = np.sum([one.hat for one in tallies], axis=0) / count
    squares = np.sum([one.squares for one in tallies], axis=0)
    stated = np.sum([one.variance for one in tallies], axis=0)
    worst = worst_hat = 0.0
    edges = np.geomspace(light.min() * 0.999, light.max() * 1.001, 14)
    for low, high in pairwise(edges):
        step = (light >= low) & (light < high)
        if not step.any():
            continue
        bias = float(mean[step].sum() / light[step].sum()) - 1
        err = float(np.sqrt(stated[step].sum()) / (count * light[step].sum()))
        bias_hat = float(hat[step].sum() / light[step].sum()) - 1
        worst, worst_hat = max(worst, abs(bias)), max(worst_hat, abs(bias_hat))
        scatter = float(np.sqrt(squares[step].sum() / stated[step].sum()))
        record.say(
            f"  {low:8.2f} to {high:8.2f} DN: {100 * bias:+.4f} +- {100 * err:.4f} % "
            f"(hat weights {100 * bias_hat:+.3f} %), scatter over stated error {scatter:.3f}"
        )
    inside, intervals = (sum(getattr(t, n) for t in tallies) for n in ("inside", "intervals"))
    record.say(f"95 % intervals that hold the truth: {inside} of {intervals}")
    record.figure("stale frames used", sum(t.stale for t in tallies), "frames")
    record.figure("frames used", sum(t.frames for t in tallies), "frames")
    record.figure("coverage of 95 % intervals", 100 * inside / intervals, "%")
    record.figure(
        "worst bias of any step of 10,000 : 1", 100 * worst, "%", "hat weights", 100 * worst_hat
    )


@benchmark("numpy")
def main(record: Recorder) -> None:
    _compare(record)
