"""How much one photograph without an edge target can tell of the lens: statistics of scenes.

A photograph is the scene's own detail behind the lens. Of two scenes, one the blurred copy of the
other, a soft and a sharp lens make the same photograph, so that what is known of a lens is known
by how alike scenes are in what their detail is like. That is measured here, whatever the method:
what a photograph shows, its spectrum and how steep its edges are behind Gaussians of several
widths, is regressed on the logarithm of the MTF50 (ridge, penalty by generalised cross-validation).

Photographs are those without an edge in the public benchmark's track ``psf``, of scenes of eleven
kinds through sixteen lenses, the nearer and the further one each by itself. Kinds that the
regression has not seen, and kinds that it has seen in other photographs; beside them the median
lens, for which no photograph is looked at, and the method ``single-image``.

``--photographs FOLDER`` adds a collection of photographs. Each is shrunk threefold behind Gaussians
and pixels, so that little of its own camera's blur is left; predicted are those of it that the
regression has not seen, and the benchmark's.

    OMP_NUM_THREADS=1 python -m benchmarks.studies.one_photograph [--photographs FOLDER]
        [--seeds N,N,...]
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import exp, log, pi, sqrt
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, Any

import cv2
import numpy as np

import standoff
from benchmarks.harness import Recorder, benchmark
from benchmarks.peers.program import Task, srgb_decoded
from hil_mocks.benchmark_set import benchmark_tasks
from simulation.arrays import BoolArray, Float32Array, FloatArray
from standoff.errors import REPORTED_ERRORS

SEEDS = (1, 2, 3, 4)
SHRUNK = 3
SIGMAS_PX, NOISES = (0.4, 1.5), (0.002, 0.02)
"""Of the collection's lenses, and of the noise over the standard deviation of the levels."""

DRAWS = 6
_BANDS_CY_PER_PX = np.geomspace(0.02, 0.5, 17)
_NOISE_CY_PER_PX = 0.55
_WIDTHS_PX = (0.6, 1.0, 1.4, 2.0, 2.8)
_RATIOS = ((0, 2), (0, 3), (1, 3), (1, 4))
_QUANTILES = (0.5, 0.75, 0.9, 0.95, 0.98, 0.995)
_STRONG = 0.9
_PENALTIES = np.geomspace(1e-2, 1e4, 25)
_LUMA_BGR = np.array([0.114, 0.587, 0.299], dtype=np.float32)
_FOLDS, _QUICK = 10, 6
_GOOD = 0.08


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Seen:
    """What a photograph shows, its group, and the logarithm of the true MTF50 in cy/px.

    ``error``: relative error of the MTF50 by the method ``single-image``, NaN where it has none.
    """

    shown: FloatArray
    group: str
    pair: str
    log_mtf50: float
    error: float = np.nan


def _shown(image: Float32Array) -> FloatArray:
    """Logarithms of the spectrum in bands, of the noise, and of how edges lose by smoothing."""
    window = np.outer(np.hanning(image.shape[0]), np.hanning(image.shape[1]))
    power = np.abs(np.fft.fft2((image - image.mean()) * window)) ** 2
    freq = np.hypot(
        np.fft.fftfreq(image.shape[0])[:, None], np.fft.fftfreq(image.shape[1])[None, :]
    )
    bands = [
        float(power[(freq >= low) & (freq < high)].mean())
        for low, high in pairwise(_BANDS_CY_PER_PX.tolist())
    ]
    bands.append(float(np.median(power[freq > _NOISE_CY_PER_PX])))
    slopes = []
    for width_px in _WIDTHS_PX:
        smooth = cv2.GaussianBlur(image, (0, 0), width_px)
        slopes.append(
            np.hypot(*(cv2.Sobel(smooth, cv2.CV_32F, *way, ksize=3) for way in ((1, 0), (0, 1))))
        )
    strong = slopes[1] > np.quantile(slopes[1], _STRONG)
    edges = [
        np.quantile(slopes[one][strong] / np.maximum(slopes[other][strong], 1e-9), _QUANTILES)
        for one, other in _RATIOS
    ]
    relative = np.array(bands) / bands[0]
    return np.asarray(np.log(np.maximum(np.concatenate([relative[1:], *edges]), 1e-9)))


def pairs_without_edge(seed: int, count: int | None) -> Iterator[tuple[Task, dict[str, Any]]]:
    """The benchmark's pairs without an edge, or the first of them, and the truth of each."""
    tasks = [
        task
        for task in benchmark_tasks("small", seed)
        if task.track == "psf" and task.name.startswith("photographs")
    ]
    with TemporaryDirectory() as folder:
        for task in tasks[:count]:
            made = task.rendered()
            for path, data in made.files.items():
                (Path(folder) / path).parent.mkdir(parents=True, exist_ok=True)
                (Path(folder) / path).write_bytes(data)
            yield Task(track="psf", data=Path(folder), facts=made.task), made.truth


def _of_benchmark(seed: int, count: int | None) -> Iterator[_Seen]:
    """The benchmark's photographs without an edge."""
    for task, truth in pairs_without_edge(seed, count):
        mtf50 = sqrt(truth["edges"]["x"]["mtf50"] * truth["edges"]["y"]["mtf50"])
        for key in ("file", "nearer_file"):
            yield _Seen(
                shown=_shown(task.linear(key).astype(np.float32)),
                group=truth["scene"].rsplit("-", 1)[0],
                pair=f"{seed} {task.name}",
                log_mtf50=log(mtf50),
                error=_single_image_error(task.path(key), mtf50),
            )


def _single_image_error(path: Path, mtf50: float) -> float:
    try:
        psf = standoff.calibrate_psf(path, method="single-image")
    except REPORTED_ERRORS:
        return np.nan
    covariance_px2 = psf.total_psf(path.name).covariance_px2
    sigma_px = float(np.linalg.det(covariance_px2)) ** 0.25
    return float(sqrt(log(2) / 2) / (pi * sigma_px) / mtf50 - 1)


def _of_collection(folder: Path) -> Iterator[_Seen]:
    """Photographs of a folder, shrunk behind lenses of several widths."""
    rng = np.random.default_rng(5)
    for path in sorted(folder.iterdir()):
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if image is None:
            continue
        fine = srgb_decoded(image.astype(np.float64) / 255).astype(np.float32) @ _LUMA_BGR
        for _ in range(DRAWS):
            sigma_px = exp(rng.uniform(*np.log(SIGMAS_PX)))
            soft = cv2.GaussianBlur(fine, (0, 0), sigma_px * SHRUNK)
            rows, cols = (side // SHRUNK * SHRUNK for side in soft.shape)
            whole = soft[:rows, :cols].reshape(rows // SHRUNK, SHRUNK, cols // SHRUNK, SHRUNK)
            seen = whole.mean(axis=(1, 3))
            noise = exp(rng.uniform(*np.log(NOISES))) * float(seen.std())
            seen = seen + rng.normal(0.0, noise, seen.shape).astype(np.float32)
            width_px = sqrt(sigma_px**2 + 1 / 12)
            yield _Seen(
                shown=_shown(np.asarray(seen, dtype=np.float32)),
                group=path.name,
                pair=path.name,
                log_mtf50=log(sqrt(log(2) / 2) / (pi * width_px)),
            )


def _predicted(known: Sequence[_Seen], others: Sequence[_Seen]) -> FloatArray:
    """Logarithms of the MTF50 of other photographs, shape ``(n,)``."""
    shown = np.stack([one.shown for one in known])
    middle, spread = shown.mean(axis=0), shown.std(axis=0) + 1e-9
    design = (shown - middle) / spread
    truth = np.array([one.log_mtf50 for one in known])
    left, sizes, right = np.linalg.svd(design, full_matrices=False)
    onto = left.T @ (truth - truth.mean())
    best, weights = np.inf, np.zeros(design.shape[1])
    for penalty in _PENALTIES:
        share = sizes**2 / (sizes**2 + penalty)
        residual = truth - truth.mean() - left @ (share * onto)
        score = float(residual @ residual) / (len(truth) - 1 - share.sum()) ** 2
        if score < best:
            best, weights = score, right.T @ (share / sizes * onto)
    seen = (np.stack([one.shown for one in others]) - middle) / spread
    return np.asarray(seen @ weights + truth.mean())


def _errors(seen: Sequence[_Seen], folds: Sequence[str]) -> FloatArray:
    """Relative errors of each by those of other folds, shape ``(n,)``."""
    errors = np.zeros(len(seen))
    labels = np.array(folds)
    for label in sorted(set(folds)):
        is_out: BoolArray = labels == label
        known = [one for one, out in zip(seen, is_out, strict=True) if not out]
        out = [one for one, left in zip(seen, is_out, strict=True) if left]
        truth = np.array([one.log_mtf50 for one in out])
        errors[is_out] = np.expm1(_predicted(known, out) - truth)
    return errors


def _say(record: Recorder, name: str, errors: FloatArray) -> None:
    """Keep the median of the errors, and say how many are small."""
    given = np.abs(errors[np.isfinite(errors)])
    record.figure(f"one photograph: median error of MTF50, {name}", 100 * np.median(given), "%")
    record.say(
        f"  {name:52} of {len(errors)}, {len(given)} answered: 80 % within "
        f"{100 * np.quantile(given, 0.8):.0f} %, {100 * np.mean(given <= _GOOD):.0f} % within "
        f"{100 * _GOOD:.0f} %, bias {100 * np.median(errors[np.isfinite(errors)]):+.1f} %"
    )


@benchmark("numpy", "scipy", "opencv-contrib-python-headless")
def main(
    record: Recorder,
    *,
    photographs: Annotated[Path | None, "folder of photographs of a thousand pixels"] = None,
    seeds: Annotated[str, "of the benchmark, with commas"] = ",".join(map(str, SEEDS)),
) -> None:
    numbers = record.pick([int(seed) for seed in seeds.split(",")], [1, 2, 3])
    seen = [one for seed in numbers for one in _of_benchmark(seed, record.pick(None, _QUICK))]
    truth = np.array([one.log_mtf50 for one in seen])
    _say(record, "none looked at", np.expm1(np.median(truth) - truth))
    _say(record, "method single-image", np.array([one.error for one in seen]))
    _say(record, "scenes of unseen kinds", _errors(seen, [one.group for one in seen]))
    pairs = sorted({one.pair for one in seen})
    fold_of = {pair: str(number % _FOLDS) for number, pair in enumerate(pairs)}
    _say(record, "scenes of known kinds", _errors(seen, [fold_of[one.pair] for one in seen]))
    if photographs is None:
        record.say("a collection of photographs: skipped, no --photographs")
        return
    collection = list(_of_collection(photographs))
    names = sorted({one.pair for one in collection})
    fold_of = {name: str(number % _FOLDS) for number, name in enumerate(names)}
    _say(
        record,
        f"a collection of {len(names)}, others of it known",
        _errors(collection, [fold_of[one.pair] for one in collection]),
    )
    away = np.expm1(_predicted(collection, seen) - truth)
    _say(record, "the benchmark's, by that collection", away)
