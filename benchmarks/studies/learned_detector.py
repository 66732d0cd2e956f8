"""Whether it pays to train a change detector on pairs of the calibrated capture model.

The same network with the same seeds learns from the same photographs of scikit-image, once from
pairs of the calibrated model, once from pairs of plain bicubic resampling with the same noise and
changes. Both then look at the simulated bench, whose renderer shares nothing with ``simulation``:
prints of other photographs, upright, at ratios of distance from 1.1 to 2.5, with and without a spot
that is painted on the print, fainter where it is nearer. The AUC's interval is over prints (95 %);
so is that of the difference of the two, print by print, by Student's t. ``all`` pools the ratios,
so that it also judges whether scores at different ratios can be compared.

    OMP_NUM_THREADS=1 python -m benchmarks.studies.learned_detector [--quick]
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter
from typing import Any

import numpy as np
import skimage.data
from scipy.stats import t as student
from skimage.feature import peak_local_max

import standoff
from analysis.detectors import Detector
from analysis.detectors.built_in import absolute_difference
from analysis.detectors.learned import TrainingOptions, train_detector
from analysis.evaluation.roc import auc_interval
from benchmarks.harness import Recorder, benchmark
from benchmarks.studies.changes import bench_of
from hil_mocks.truth import PHOTOGRAPHS, BenchTruth
from simulation import Model
from simulation.arrays import Float32Array, FloatArray
from tests.analysis.changed_scenes import (
    NEAR_MM,
    BenchPair,
    bench_noise,
    bench_pair,
    bench_psf,
    far_pose,
    with_noise_of,
)

LEARNT_FROM = ("chelsea", "coffee", "page", "text", "moon", "clock_motion", "rocket", "retina")
"""Photographs of scikit-image's wheel that the bench does not print."""

ZOOMS = (1.1, 1.3, 1.6, 2.0, 2.5)
CROP_PX = 96
SIGMA_PX = 2.0
CONTRAST_SD = 1.2
"""Peak of a spot on the print, at ratio 1, over the noise of one frame at mid-range.

It grows with the square of the ratio, so that at none all spots are found, or none.
"""

PITCH_MM = 12.5
NOISE_OF_WHITE = (0.004, 0.016)
WHITE_DN = 255.0
MODELS: tuple[Model, ...] = ("lmmse", "bicubic")


@dataclass(frozen=True, kw_only=True, eq=False)
class _Shown:
    """A crop of a pair of the bench."""

    reference: Float32Array
    followup: Float32Array
    homography: FloatArray
    is_changed: bool
    print_number: int
    zoom: float


def _bench_crops(truth: BenchTruth, name: str, number: int, zoom: float) -> Iterator[_Shown]:
    """Crops of one print at one ratio: at every spot in the frame one with it and one without."""
    near_px_per_mm = truth.camera.scale_px_per_mm(NEAR_MM)
    noise = bench_noise(truth, 1)
    middle_dn = truth.black_level_dn + 1500.0
    noise_dn = float(np.sqrt(noise.variance_dn2(np.array(middle_dn))))
    white = _bench_pair_of(truth, "flat", zoom, 0.0, SIGMA_PX / near_px_per_mm)
    per_reflectance = float(white.reference.max()) - truth.black_level_dn
    sign = 1 if (number + ZOOMS.index(zoom)) % 2 else -1
    contrast = sign * CONTRAST_SD * zoom**2 * noise_dn / per_reflectance
    clean = _bench_pair_of(truth, name, zoom, contrast, SIGMA_PX / near_px_per_mm)
    plain = replace(clean, followup=clean.followup - clean.change)
    seed = 100 * number + ZOOMS.index(zoom)
    changed, unchanged = (
        with_noise_of(truth, one, seed=2 * seed + turn, frames_averaged=1)
        for turn, one in enumerate((clean, plain))
    )
    side = int(CROP_PX / zoom + 1e-9)
    find: Any = peak_local_max  # it states no types
    peaks = find(np.abs(clean.change), min_distance=4, threshold_rel=0.5, exclude_border=side // 2)
    rng = np.random.default_rng(seed)
    for y, x in peaks:
        top, left = (int(at - rng.integers(side // 4, side - side // 4)) for at in (y, x))
        for pair, is_changed in ((unchanged, False), (changed, True)):
            cut = _crop_of(pair, top, left, side)
            if cut is not None:
                yield _Shown(
                    reference=cut[0],
                    followup=cut[1],
                    homography=cut[2],
                    is_changed=is_changed,
                    print_number=number,
                    zoom=zoom,
                )


def _bench_pair_of(
    truth: BenchTruth, name: str, zoom: float, contrast: float, sigma_mm: float
) -> BenchPair:
    return bench_pair(
        truth,
        name,
        far_pose(truth, zoom),
        contrast=contrast,
        sigma_mm=sigma_mm,
        pitch_mm=PITCH_MM,
        seed=7,
        frames_averaged=None,
    )


def _crop_of(
    pair: BenchPair, top: int, left: int, side: int
) -> tuple[Float32Array, Float32Array, FloatArray] | None:
    """A square of the follow-up and the reference's around it; None at the frame's border."""
    middle = pair.matrix @ (left + (side - 1) / 2, top + (side - 1) / 2, 1.0)
    first_x, first_y = (round(at / middle[2] - (CROP_PX - 1) / 2) for at in middle[:2])
    followup = pair.followup[max(top, 0) : top + side, max(left, 0) : left + side]
    reference = pair.reference[
        max(first_y, 0) : first_y + CROP_PX, max(first_x, 0) : first_x + CROP_PX
    ]
    if followup.shape != (side, side) or reference.shape != (CROP_PX, CROP_PX):
        return None
    to_frame = np.array([[1.0, 0.0, left], [0.0, 1.0, top], [0.0, 0.0, 1.0]])
    to_crop = np.array([[1.0, 0.0, -first_x], [0.0, 1.0, -first_y], [0.0, 0.0, 1.0]])
    matrix = to_crop @ pair.matrix @ to_frame
    return (
        reference.astype(np.float32),
        followup.astype(np.float32),
        np.asarray(matrix / matrix[2, 2]),
    )


def _trained(
    record: Recorder, truth: BenchTruth, model: Model, folder: Path, pairs: int, seeds: range
) -> list[Detector]:
    """Networks that learnt from pairs of a model."""
    files = [
        next(Path(skimage.data.__file__).parent.glob(f"{name}.*g"))
        for name in record.pick(LEARNT_FROM, LEARNT_FROM[:2])
    ]
    started = perf_counter()
    made = standoff.change_pairs(
        files,
        folder / model,
        bench_psf(truth),
        standoff.ChangePairsTask(
            zooms=(1.0, 2.5),
            noises_dn=(NOISE_OF_WHITE[0] * WHITE_DN, NOISE_OF_WHITE[1] * WHITE_DN),
            contrasts_dn=(3.0, 25.0),
            sigmas_px=(1.5, 3.0),
            model=model,
            crop_px=CROP_PX,
            pairs=pairs,
            test_fraction=0.0,
        ),
    )
    known = list(made.dataset.pairs("train"))
    record.say(f"  {model}: {len(known)} pairs in {perf_counter() - started:.0f} s")
    detectors: list[Detector] = []
    for seed in seeds:
        started = perf_counter()
        options = TrainingOptions(epochs=record.pick(8, 1), seed=seed)
        detectors.append(train_detector(known, options))
        record.say(f"  {model}, seed {seed}: trained in {perf_counter() - started:.0f} s")
    return detectors


def _scores_of(detector: Detector, shown: list[_Shown]) -> FloatArray:
    return np.array(
        [float(np.max(detector(one.reference, one.followup, one.homography))) for one in shown]
    )


def _area(shown: list[_Shown], scores: FloatArray) -> tuple[float, float, float]:
    """AUC with its interval over prints."""
    is_changed = np.array([one.is_changed for one in shown])
    prints = np.array([one.print_number for one in shown])
    found = auc_interval(
        scores[~is_changed], scores[is_changed], prints[~is_changed], prints[is_changed]
    )
    return found.auc, found.low, found.high


def _gained(
    shown: list[_Shown], better: list[FloatArray], worse: list[FloatArray]
) -> tuple[float, float]:
    """Mean over prints of the gain of AUC, and half of its 95 % interval."""
    gains = []
    for number in sorted({one.print_number for one in shown}):
        own = [place for place, one in enumerate(shown) if one.print_number == number]
        part = [shown[place] for place in own]
        areas = [
            np.mean([_area(part, scores[own])[0] for scores in group]) for group in (better, worse)
        ]
        gains.append(areas[0] - areas[1])
    if len(gains) < 2:
        return float(np.mean(gains)), float("nan")
    quantile = float(student.ppf(0.975, len(gains) - 1))
    return float(np.mean(gains)), quantile * float(np.std(gains, ddof=1)) / len(gains) ** 0.5


def _report(record: Recorder, shown: list[_Shown], scores: dict[str, list[FloatArray]]) -> None:
    names = list(scores)
    record.say(f"\n  zoom  pairs  {'  '.join(f'{name:^20s}' for name in names)}  lmmse - bicubic")
    kinds: list[tuple[str, list[int]]] = [
        (f"{zoom:g}", [place for place, one in enumerate(shown) if one.zoom == zoom])
        for zoom in dict.fromkeys(one.zoom for one in shown)
    ]
    kinds.append(("all", list(range(len(shown)))))
    for title, own in kinds:
        part = [shown[place] for place in own]
        cells = []
        for name in names:
            of_seeds = [_area(part, one[own]) for one in scores[name]]
            auc, low, high = np.mean(of_seeds, axis=0)
            cells.append(f"{auc:.3f} ({low:.3f}-{high:.3f})")
        gain, half = _gained(
            part, [one[own] for one in scores["lmmse"]], [one[own] for one in scores["bicubic"]]
        )
        row = "  ".join(f"{cell:^20s}" for cell in cells)
        record.say(f"  {title:>4s}  {len(part):5d}  {row}  {gain:+.3f} +- {half:.3f}")
        record.figure(f"gain of AUC by the calibrated model, zoom {title}", gain, "")
    for name in names:
        apart = [_area(shown, one)[0] for one in scores[name]]
        record.say(f"  {name}: AUC of each seed {', '.join(f'{one:.3f}' for one in apart)}")


@benchmark("numpy", "torch")
def main(record: Recorder) -> None:
    with TemporaryDirectory() as folder:
        truth = bench_of(0.0)
        shown = [
            one
            for number, name in enumerate(record.pick(list(PHOTOGRAPHS), ["brick", "coins"]))
            for zoom in record.pick(ZOOMS, ZOOMS[1:2])
            for one in _bench_crops(truth, name, number, zoom)
        ]
        record.say(f"{len(shown)} crops of the bench; training:")
        scores: dict[str, list[FloatArray]] = {
            model: [
                _scores_of(one, shown)
                for one in _trained(
                    record,
                    truth,
                    model,
                    Path(folder),
                    record.pick(60, 4),
                    range(record.pick(3, 1)),
                )
            ]
            for model in MODELS
        }
        scores["absolute-difference"] = [_scores_of(absolute_difference, shown)]
        _report(record, shown, scores)
