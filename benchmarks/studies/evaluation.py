"""Whether an evaluation predicts what captures give: AUC on simulated and on captured pairs.

The simulated bench photographs prints from the reference's pose and from others, without and with
spots that are really on the print (rendered with it, by code that shares nothing with
``simulation``). Around each spot a pair is cut from the captures; the same pair is simulated from
the reference's captures (means of 50 frames) by the calibrated PSF, by bicubic resampling and,
where it is installed and the camera only moved back, by pyBSM with the true optics. All have the
same noise. Reported for every built-in detector and pose: the AUC on captures, and how far those on
simulated pairs are from it.

    OMP_NUM_THREADS=1 python -m benchmarks.studies.evaluation [--quick]
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product

import cv2
import numpy as np

from analysis.detectors import DetectorSpec, open_detector
from analysis.evaluation.roc import auc_interval
from benchmarks.harness import Recorder, benchmark
from benchmarks.peers.zoom_outs import HAS_PYBSM, pybsm
from benchmarks.studies.changes import bench_of
from benchmarks.truth.lenses import gaussian
from hil_mocks.truth import BenchTruth, CameraPose
from hil_mocks.truth.scenes import Placed, SumOfScenes, ZonePlate
from hil_mocks.truth.targets import scene_of
from simulation import PoseOptions, simulate_pose_of_image
from simulation.arrays import Float32Array, FloatArray
from tests.analysis.changed_scenes import EXPOSURE_US, NEAR_MM, bench_noise, bench_psf, far_pose

TARGETS = ("gravel", "coins", "brick", "grass", "lesion")
ZOOMS = (1.1, 1.5, 2.0, 2.5)
TILTS_DEG = (0.0, 7.0, 15.0)
CROP_PX, PITCH_MM, SPOT_MM = 96, 16.0, 0.9
CONTRASTS = {
    "absolute-difference": 0.06,
    "ncc": 0.15,
    "ssim": 0.06,
    "ir-mad": 0.08,
    "changes": 0.006,
}
SHARES = {1.1: 0.15, 1.5: 0.5, 2.0: 1.0, 2.5: 1.6}
"""Reflectance that a spot adds, by detector at zoom 2, and at other zooms over that: such that AUC
lie between 1/2 and 1."""

SLOW_ZOOMS = (1.5, 2.0)
"""Of detector ``changes``, which takes a second a pair."""

SOURCE_FRAMES, FRAMES = 50, 10
MODELS = ("lmmse", "matched", "bicubic", "pyBSM")
MIDDLES_PX = {1.1: 286, 1.5: 288, 2.0: 288, 2.5: 290}
"""Of a reference of 290 rows, the largest even middles that leave an even follow-up."""


@dataclass(frozen=True, kw_only=True, eq=False)
class _Views:
    """Levels without noise of one print from one pose, without and with spots."""

    reference: FloatArray
    changed_reference: FloatArray
    followup: tuple[FloatArray, FloatArray]
    matrix: FloatArray
    places_px: FloatArray


def _views(truth: BenchTruth, target: str, pose: CameraPose, contrast: float, seed: int) -> _Views:
    """Photograph a print from both poses; ``places_px`` are the spots in the reference, (n, 2)."""
    rng = np.random.default_rng(seed)
    scene, near = Placed(scene=scene_of(target)), CameraPose(height_mm=NEAR_MM)
    spot = ZonePlate(amplitude=contrast, window_mm=SPOT_MM, freq_cy_per_mm=0.0)
    places = np.arange(-48.0, 48.1, PITCH_MM)
    at_mm = [np.array([x, y]) + rng.uniform(-3, 3, 2) for y, x in product(places[1:-1], places)]
    with_spots = SumOfScenes(
        scene, [(Placed(scene=spot, x_mm=x, y_mm=y), 5 * SPOT_MM) for x, y in at_mm]
    )
    plain, changed = (
        [
            truth.sensor.expected_dn(
                truth.renderer.irradiance(shown, where), EXPOSURE_US, 0.0, "Mono12"
            )
            for where in (near, pose)
        ]
        for shown in (scene, with_spots)
    )
    added = changed[0] - plain[0]
    return _Views(
        reference=plain[0],
        changed_reference=changed[0],
        followup=(plain[1], changed[1]),
        matrix=truth.homography_far_to_near(near, pose),
        places_px=_peaks(added, len(at_mm)),
    )


def _peaks(added: FloatArray, count: int) -> FloatArray:
    """Where the reference shows the spots: its highest places, well apart."""
    left, found = added.copy(), []
    for _ in range(count):
        y, x = np.unravel_index(int(left.argmax()), left.shape)
        if left[y, x] < 0.5 * added.max():
            break
        found.append((float(x), float(y)))
        left[max(y - 20, 0) : y + 21, max(x - 20, 0) : x + 21] = 0.0
    return np.array(found)


def _noisy(truth: BenchTruth, levels: FloatArray, frames: int, *seed: int) -> FloatArray:
    """The mean of so many frames."""
    rng = np.random.default_rng(seed)
    sd = np.sqrt(bench_noise(truth, frames).variance_dn2(np.maximum(levels, 0.0)))
    return np.asarray(levels + sd * rng.standard_normal(levels.shape))


def _simulated(
    model: str, truth: BenchTruth, source: FloatArray, seen: _Views
) -> FloatArray | None:
    """The follow-up that a model makes of a capture; None where it cannot."""
    height, width = seen.followup[0].shape
    if model == "bicubic":
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        made = cv2.warpPerspective(
            source, seen.matrix, (width, height), flags=flags, borderMode=cv2.BORDER_REFLECT_101
        )
        return np.asarray(made, np.float64)
    if model == "pyBSM":
        return _zoomed_by_pybsm(truth, source, seen) if HAS_PYBSM else None
    options = PoseOptions(model="lmmse" if model == "lmmse" else "matched")
    made = simulate_pose_of_image(
        source, seen.matrix, (width, height), bench_psf(truth), options
    ).image
    return np.asarray(made, np.float64)


def _zoomed_by_pybsm(truth: BenchTruth, source: FloatArray, seen: _Views) -> FloatArray | None:
    """Zoom the middle of the reference out; None of a pose that is more than that."""
    zoom = round(float(seen.matrix[0, 0]), 6)
    side = MIDDLES_PX.get(zoom)
    if side is None or abs(seen.matrix[2, :2]).max() > 1e-9:
        return None
    sigma_px = float(np.sqrt(np.mean(np.diag(truth.total_covariance_px2(NEAR_MM)))))
    rows, cols = source.shape
    middle = np.s_[(rows - side) // 2 : (rows + side) // 2, (cols - side) // 2 : (cols + side) // 2]
    made = pybsm(source[middle], zoom, gaussian(sigma_px, has_pixel=False))
    left = round(side / zoom)
    assert made.shape == (left, left)
    whole = np.array(seen.followup[0])
    whole[(rows - left) // 2 : (rows + left) // 2, (cols - left) // 2 : (cols + left) // 2] = made
    return whole


def _crops(
    seen: _Views, reference: FloatArray, followup: FloatArray, seed: int
) -> Iterator[tuple[Float32Array, Float32Array, FloatArray]]:
    """Cut the pairs around the spots, each a little off its spot."""
    rng = np.random.default_rng([seed, 77])
    inverse = np.linalg.inv(seen.matrix)
    for x, y in seen.places_px:
        x0, y0 = (np.array([x, y]) - CROP_PX / 2 + rng.uniform(-20, 20, 2)).round().astype(int)
        corners = inverse @ np.array(
            [[x0, x0 + CROP_PX - 1, x0, x0 + CROP_PX - 1],
             [y0, y0, y0 + CROP_PX - 1, y0 + CROP_PX - 1], [1, 1, 1, 1]]
        )  # fmt: skip
        u, v = corners[:2] / corners[2]
        u0, v0 = int(np.ceil(u.min())), int(np.ceil(v.min()))
        u1, v1 = int(u.max()) + 1, int(v.max()) + 1
        rows, cols = followup.shape
        height, width = reference.shape
        if min(x0, y0, u0, v0) < 0 or x0 + CROP_PX > width or y0 + CROP_PX > height:
            continue
        if abs(x0 + CROP_PX / 2 - width / 2) > height / 2 - CROP_PX / 2 - 15:
            continue  # pyBSM sees a square
        if u1 > cols or v1 > rows:
            continue
        to_crop = np.array([[1, 0, -x0], [0, 1, -y0], [0, 0, 1.0]])
        from_crop = np.array([[1, 0, u0], [0, 1, v0], [0, 0, 1.0]])
        matrix = to_crop @ seen.matrix @ from_crop
        yield (
            reference[y0 : y0 + CROP_PX, x0 : x0 + CROP_PX].astype(np.float32),
            followup[v0:v1, u0:u1].astype(np.float32),
            np.asarray(matrix / matrix[2, 2]),
        )


def _areas(
    truth: BenchTruth, detector: str, zoom: float, tilt_deg: float, targets: tuple[str, ...]
) -> dict[str, float]:
    """AUC on captures, and on pairs simulated by each model."""
    scores: dict[str, tuple[list[float], list[float]]] = {}
    groups: dict[str, tuple[list[int], list[int]]] = {}
    with open_detector(DetectorSpec.parse(detector)) as judge:
        for number, target in enumerate(targets):
            seed = 1000 * number + round(100 * zoom) + round(tilt_deg)
            pose = far_pose(truth, zoom, **({"tilt_x_deg": tilt_deg} if tilt_deg else {}))
            seen = _views(truth, target, pose, CONTRASTS[detector] * SHARES[zoom], seed)
            reference = _noisy(truth, seen.reference, FRAMES, seed, 1)
            for is_changed, near in enumerate((seen.reference, seen.changed_reference)):
                source = _noisy(truth, near, SOURCE_FRAMES, seed, 2 + is_changed)
                made = {
                    "captured": seen.followup[is_changed],
                    **{model: _simulated(model, truth, source, seen) for model in MODELS},
                }
                for name, followup in made.items():
                    if followup is None:
                        continue
                    shown = _noisy(truth, followup, FRAMES, seed, 4 + is_changed)
                    for pair in _crops(seen, reference, shown, seed):
                        scores.setdefault(name, ([], []))[is_changed].append(judge(*pair).score)
                        groups.setdefault(name, ([], []))[is_changed].append(number)
    return {
        name: auc_interval(
            np.array(pair[0]),
            np.array(pair[1]),
            np.array(groups[name][0]),
            np.array(groups[name][1]),
        ).auc_all_pairs
        for name, pair in scores.items()
    }


@benchmark("numpy", "scipy")
def main(record: Recorder) -> None:
    truth = bench_of(0.0)
    off: dict[str, list[float]] = {}
    for detector in record.pick(tuple(CONTRASTS), ("ssim", "ncc")):
        is_slow = detector == "changes"
        targets = TARGETS * 2
        for zoom, tilt in product(record.pick(ZOOMS, (1.5,)), record.pick(TILTS_DEG, (0.0,))):
            if is_slow and (zoom not in SLOW_ZOOMS or tilt == TILTS_DEG[1]):
                continue
            found = _areas(truth, detector, zoom, tilt, targets)
            captured = found.pop("captured")
            told = ", ".join(f"{name} {value - captured:+.3f}" for name, value in found.items())
            record.say(
                f"{detector}, zoom {zoom:g}, tilt {tilt:g}: AUC {captured:.3f} on captures; {told}"
            )
            for name, value in found.items():
                off.setdefault(name, []).append(abs(value - captured))
    for name, values in off.items():
        record.say(
            f"{name}: AUC off by {np.median(values):.4f} in the median, at most {max(values):.4f}"
        )
        record.figure(f"AUC off in the median, {name}", float(np.median(values)), "")
        record.figure(f"AUC off at most, {name}", max(values), "")
