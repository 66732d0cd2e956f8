"""Changes on the simulated bench: false positives at equal true positives, and false alarms.

Targets of the bench are photographed at 180 mm and, 1.5 times as far from the lens, once more with
twenty-odd faint spots that are really in the scene (rendered with it, not painted into the image).
``ROC``: pixels of spots found against pixels elsewhere flagged, for the plain difference (the
reference merely resampled) in the same light fit and smoothing, and for the filter.
``False alarms``: pixels flagged where only the pose and the noise changed, beside the stated rate.
Both aligned as the command does. Then the same without a change through a lens with 1 % of barrel,
beside the homography that knows nothing of it.

    OMP_NUM_THREADS=1 python -m benchmarks.studies.changes [--plot FIGURE.png]
"""

from pathlib import Path
from typing import Annotated

import numpy as np
from scipy.stats import norm

from acquisition.bench import load_bench
from analysis.changes import (
    ChangeOptions,
    ChangeResult,
    changes_between,
    significance_threshold,
)
from analysis.reports import png_bytes
from benchmarks.harness import Recorder, benchmark
from benchmarks.scoring import PixelScores, Roc, changed_and_clear, plot_change_roc, roc_of
from calibration.registration import DistortedPose, register_images
from hil_mocks.truth import BenchTruth
from standoff.shipped_configs import shipped_config
from tests.analysis.changed_scenes import (
    BenchPair,
    bench_noise,
    bench_pair,
    bench_psf,
    far_pose,
    with_noise_of,
)
from tests.analysis.random_poses import bench_truth

TARGETS = ("gravel", "coins", "lesion", "brick")
SPOTS = {"contrast": 0.003, "sigma_mm": 0.8, "pitch_mm": 12.5}
STATED = (0.05, 1.0, 10.0)
NOISE_DRAWS = 12
FRAMES_AVERAGED = 50
POSES: tuple[dict[str, float], ...] = ({}, {"tilt_x_deg": 4.0, "roll_deg": 3.0, "offset_x_mm": 3.0})
TPR = (0.5, 0.8, 0.9)
LENS_K1 = -0.01


def _pair(
    truth: BenchTruth,
    target: str,
    pose: dict[str, float],
    seed: int,
    *,
    has_spots: bool = True,
    frames: int | None = FRAMES_AVERAGED,
) -> BenchPair:
    spots = SPOTS if has_spots else SPOTS | {"contrast": 0.0}
    followup = far_pose(truth, 1.5, **pose)
    return bench_pair(truth, target, followup, seed=seed, frames_averaged=frames, **spots)


def _found(truth: BenchTruth, pair: BenchPair) -> ChangeResult:
    options = ChangeOptions(noise=bench_noise(truth, FRAMES_AVERAGED))
    return changes_between(pair.reference, pair.followup, bench_psf(truth), options)


def _curves(record: Recorder, truth: BenchTruth, targets: tuple[str, ...]) -> dict[str, Roc]:
    scores = {"plain difference": PixelScores(), "this filter": PixelScores()}
    for number, target in enumerate(targets):
        for pose in POSES:
            pair = _pair(truth, target, pose, number)
            result = _found(truth, pair)
            core, clear = changed_and_clear(pair.change, result.valid)
            own = []
            maps = (result.plain_difference_dn, result.significance)
            for total, score in zip(scores.values(), maps, strict=True):
                total.add(np.abs(score), core, clear)
                own.append(roc_of(total.inside[-1], total.outside[-1]))
            counts = "   ".join(
                f"{100 * rate:.0f} %: {own[0].false_at(rate):6d} {own[1].false_at(rate):5d}"
                for rate in TPR
            )
            record.say(f"  {target:8s} {'tilted' if pose else 'upright':8s} {counts}")
    return {name: total.roc() for name, total in scores.items()}


def _false_alarms(
    record: Recorder, truth: BenchTruth, targets: tuple[str, ...], draws: int
) -> None:
    flagged, normal = np.zeros((2, len(STATED), len(targets) * len(POSES) * draws))
    frames = 0
    for number, target in enumerate(targets):
        for turn, pose in enumerate(POSES):
            clean = _pair(truth, target, pose, number, has_spots=False, frames=None)
            for draw in range(draws):
                pair = with_noise_of(
                    truth,
                    clean,
                    # Noise of its own for every frame: shared noise would flag the same pixels.
                    seed=10000 + 1000 * number + 100 * turn + draw,
                    frames_averaged=FRAMES_AVERAGED,
                )
                result = _found(truth, pair)
                significance = np.abs(result.significance[result.valid])
                for place, rate in enumerate(STATED):
                    share = rate / significance.size
                    over = significance > significance_threshold(share, result.filter_widths)
                    flagged[place, frames] = np.count_nonzero(over)
                    normal[place, frames] = np.count_nonzero(significance > norm.isf(share / 2))
                frames += 1
    record.say(
        f"{frames} frames without a change, pixels flagged a frame with their standard error:"
    )
    for rate, counts, plain in zip(STATED, flagged, normal, strict=True):
        shown = "   ".join(
            f"{name} {of.mean():.2f} +- {of.std(ddof=1) / np.sqrt(frames):.2f}"
            for name, of in (("found", counts), ("by a normal tail", plain))
        )
        record.figure(
            f"false alarms a frame, stated {rate:g}",
            float(counts.mean()),
            "px",
            "by a normal tail",
            float(plain.mean()),
        )
        record.say(f"  stated {rate:6.2f}   {shown}   frames with any: {np.count_nonzero(counts)}")


def _through_a_lens(record: Recorder, truth: BenchTruth, targets: tuple[str, ...]) -> None:
    """Flagged pixels a frame at the command's own rate, where only the pose changed."""
    psf, noise = bench_psf(truth), bench_noise(truth, FRAMES_AVERAGED)
    flagged, by_homography, frames = 0, 0, 0
    for number, target in enumerate(targets):
        for tilt in POSES:
            pair = _pair(truth, target, tilt, 20000 + number, has_spots=False)
            flagged += int(_found(truth, pair).is_change.sum())
            matrix = register_images(pair.reference, pair.followup, psf).matrix
            pose = DistortedPose(
                matrix=matrix,
                k1=0.0,
                reference_shape=(pair.reference.shape[0], pair.reference.shape[1]),
                followup_shape=(pair.followup.shape[0], pair.followup.shape[1]),
            )
            options = ChangeOptions(pose=pose, noise=noise)
            plain = changes_between(pair.reference, pair.followup, psf, options)
            by_homography += int(plain.is_change.sum())
            frames += 1
    record.figure(
        f"false alarms a frame, stated 0.05, {100 * LENS_K1:g} % of distortion",
        flagged / frames,
        "px",
        "a homography",
        by_homography / frames,
    )
    record.say(
        f"{frames} frames through a lens with k1 {LENS_K1}, pixels flagged a frame: "
        f"{flagged / frames:.2f}, with a homography {by_homography / frames:.2f}"
    )


def bench_of(k1: float) -> BenchTruth:
    config = load_bench(shipped_config("demo_bench.toml"))
    assert config.simulated is not None
    simulated = config.simulated.model_copy(update={"k1": k1})
    return bench_truth(config.model_copy(update={"simulated": simulated}), 390, 290)


@benchmark("numpy", "scipy", "numba")
def main(record: Recorder, *, plot: Annotated[Path | None, "draw the ROC as PNG"] = None) -> None:
    truth = bench_of(k1=0.0)
    targets = record.pick(TARGETS, TARGETS[:1])
    record.say("false pixels, plain difference and this filter, at true positives of")
    rocs = _curves(record, truth, targets)
    plain, own = rocs.values()
    for rate in TPR:
        false_plain, false_own = plain.false_at(rate), own.false_at(rate)
        record.figure(
            f"false pixels at {100 * rate:.0f} % true positives, of {plain.negatives}",
            false_own,
            "px",
            "the plain difference",
            false_plain,
        )
        record.say(
            f"all, {100 * rate:.0f} %: {false_plain} and {false_own} of "
            f"{plain.negatives}, {false_plain / max(false_own, 1):.0f} times fewer"
        )
    if plot is not None:
        plot.write_bytes(png_bytes(plot_change_roc(rocs)))
    _false_alarms(record, truth, targets, record.pick(NOISE_DRAWS, 2))
    _through_a_lens(record, bench_of(LENS_K1), targets)
