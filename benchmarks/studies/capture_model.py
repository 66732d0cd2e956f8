"""Any lens, any pose: the capture model beside the best that is linear, and beside its peers.

Opaque slanted rectangles as cameras with known optics see them, exactly. Every model simulates the
follow-up from the reference, with the PSF that ``calibrate`` measures on photographs of edges by
the same camera, or with the true one; what is judged is its mean squared error in the middle of the
frame, in DN^2, beside that of the best linear estimate with the true transfer function and
unlimited support ("ideal"). Gaussian cameras stand beside the figures that the models had when
they could be told nothing but a Gaussian. Exits with the bounds that are broken, if any.
"""

import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from itertools import product
from math import ceil, inf, sqrt
from typing import Annotated, Any, Self

import numpy as np
from scipy.stats import gmean

import standoff
from benchmarks.harness import Recorder, benchmark
from benchmarks.peers.zoom_outs import HAS_PYBSM, opencv, pillow_scipy, pybsm
from benchmarks.truth.lens_scenes import (
    Ideal,
    Pose,
    Scene,
    ideal_pose,
    pose_photograph,
    slanted_rectangles,
)
from benchmarks.truth.lenses import (
    ROUND,
    Camera,
    astigmatic,
    edge_photographs,
    f_number,
    further,
    gaussian,
)
from simulation import (
    GaussianPsf,
    LensOtf,
    MeasuredPsf,
    PoseOptions,
    Psf,
    SamplingGrid,
    simulate_pose_of_image,
    zoom_out_image,
)
from simulation.arrays import FloatArray, FloatImage
from simulation.choices import DEFAULT_MODEL, POSE_MODELS

BOUND_LENSES = (
    f_number(1.4),
    f_number(2.8),
    f_number(5.6),
    f_number(8),
    f_number(11),
    f_number(2.8, defocus_waves=1.0),
    f_number(5.6, defocus_waves=0.5),
)
GAUSSIANS_BEFORE = {
    gaussian(0.5, has_pixel=False): ((0.06897, 0.07398), (0.005867, 0.02164), (3.349e-4, 0.0257)),
    gaussian(0.7, has_pixel=False): (
        (5.089e-4, 9.308e-4),
        (1.35e-5, 0.001217),
        (1.01e-5, 0.001914),
    ),
    gaussian(1.2, has_pixel=False): ((7.5e-7, 1.59e-5), (2.8e-7, 2.92e-5), (3.6e-7, 4.81e-5)),
    gaussian(0.4, has_pixel=True): ((0.05276, 0.05009), (0.007639, 0.008476), (0.01486, 0.01217)),
    gaussian(0.6, has_pixel=True): (
        (8.592e-4, 6.857e-4),
        (7.274e-4, 6.397e-4),
        (0.001275, 0.001298),
    ),
    gaussian(1.0, has_pixel=True): ((1.46e-5, 1.14e-5), (2.78e-5, 2.93e-5), (4.26e-5, 5.15e-5)),
}
"""MSE in DN^2 of ``matched`` and of ``lmmse`` at each zoom, with the Gaussian that was calibrated.

Measured at commit 98780cf, by this benchmark's scene, edges and margins (SNR 500, no noise).
"""

OTHER_LENSES = (astigmatic(5.6, ratio=1.6, axis_deg=30), *GAUSSIANS_BEFORE)
QUICK_LENSES = (BOUND_LENSES[1], BOUND_LENSES[6], *list(GAUSSIANS_BEFORE)[1:5:3])
POSE_LENSES = (f_number(2.8), f_number(5.6, defocus_waves=0.5), f_number(11))
ZOOMS = (1.5, 2.0, 3.0)
POSES: tuple[dict[str, Any], ...] = (
    {"zoom": 1.3, "tilt_deg": 10.0},
    {"zoom": 1.5, "tilt_deg": 25.0, "bearing_deg": 45.0, "turn_deg": 20.0},
    {"zoom": 2.0, "tilt_deg": 30.0, "bearing_deg": 30.0, "turn_deg": 15.0},
    {"zoom": 2.0, "tilt_deg": 20.0, "distortion_k1": -0.01},
    {"zoom": 1.5, "tilt_deg": 30.0, "bearing_deg": 90.0, "turn_deg": 45.0, "distortion_k1": 0.01},
)
NOISES_DN = (0.0, 0.5, 1.5)

SIDE_PX = 288
"""Divisible by every zoom: the peers' pixels are then ours."""

ZOOM_SAMPLES, POSE_SAMPLES = 8, 6
"""Fine samples a pixel: every place of a zoom's pixels is one."""

POSE_SIDE_PX = 240
POSE_FOLLOWUP_PX = 120
MARGIN_PX = 48
"""Left away on every side: borders are judged elsewhere."""

EDGE_ANGLES_DEG = tuple(8.0 + 18.0 * k for k in range(10))
ASTIGMATIC_ANGLES_DEG = tuple(5.0 + 15.0 * k for k in range(12))
EDGE_SIDE_PX = 200

SNR = 500.0
"""Of the edges, for which the bounds are meant."""

OTHER_SNRS = (100.0, 30.0)

ZOOM_MEAN_MOST, ZOOM_WORST_MOST, POSE_MOST = 1.5, 4.0, 2.0
LMMSE_MOST, BEFORE_MOST, SLACK_DN2 = 1.01, 1.02, 0.001

MODELS = sorted(POSE_MODELS, key=lambda model: model != DEFAULT_MODEL)
"""Those that take any PSF, the default first."""

COLUMNS = (
    *MODELS,
    "ideal",
    *(f"{model}, {psf}" for psf in ("true", "Gaussian") for model in MODELS),
    "paper",
    "bicubic",
    "Pillow + scipy",
    "OpenCV",
    "pyBSM",
)
"""A model's name alone is with the PSF as measured; with the Gaussian nearest to it, or the true
one, it says so."""


FLOOR_DN2 = 0.01
"""Added to the ideal: a millionth of the scene's variance matters to no one."""


@dataclass(frozen=True, slots=True, eq=False)
class _ModelErrors:
    """Mean squared errors in DN^2 by case and column; the column ``ideal`` is among them."""

    cases: list[str] = field(default_factory=list)
    errors: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    counted: list[bool] = field(default_factory=list)

    def add(self, case: str, errors: dict[str, float], *, is_counted: bool) -> None:
        """Append one case; ``is_counted`` if means and worst cases are over it, too."""
        self.cases.append(case)
        self.counted.append(is_counted)
        for column, value in errors.items():
            self.errors[column].append(value)

    def at(self, index: int) -> dict[str, float]:
        """Errors of one case by column."""
        return {column: values[index] for column, values in self.errors.items()}

    def ratios(self, column: str) -> FloatArray:
        """Error over the ideal's and the floor, of the cases that are counted."""
        own, ideal = np.array(self.errors[column]), np.array(self.errors["ideal"])
        return np.asarray((own / (ideal + FLOOR_DN2))[np.array(self.counted)])

    def mean_ratio(self, column: str) -> float:
        """Geometric mean of the ratios."""
        return float(gmean(self.ratios(column)))

    def worst_ratio(self, column: str) -> float:
        """Largest of the ratios."""
        return float(self.ratios(column).max())

    def table(self, columns: Sequence[str]) -> str:
        """Markdown table of all cases, then the mean and the worst ratio."""
        columns = [name for name in columns if name in self.errors]
        lines = [f"| case | {' | '.join(columns)} |", "|---|" + "---:|" * len(columns)]
        for index, case in enumerate(self.cases):
            values = " | ".join(_brief(self.errors[column][index]) for column in columns)
            lines.append(f"| {case} | {values} |")
        if any(self.counted):
            for name, summary in (
                ("geometric mean of ratio", self.mean_ratio),
                ("worst ratio", self.worst_ratio),
            ):
                values = " | ".join(_brief(summary(column)) for column in columns)
                lines.append(f"| **{name}** | {values} |")
        return "\n".join(lines)


def _brief(value: float) -> str:
    """Three digits, without an exponent where it can be helped."""
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}" if value >= 1e-4 else f"{value:.0e}"


@dataclass(frozen=True, slots=True, eq=False)
class _Calibrated:
    """One camera's PSFs: as measured, its Gaussian alone, and the true one."""

    camera: Camera
    measured: Psf
    total: GaussianPsf
    true: Psf

    @classmethod
    def of(cls, camera: Camera, snr: float) -> Self:
        """Calibrate on photographs of edges."""
        angles = EDGE_ANGLES_DEG if camera.stretch == ROUND else ASTIGMATIC_ANGLES_DEG
        calibration = standoff.calibrate_psf(
            edge_photographs(camera, angles, EDGE_SIDE_PX, snr, seed=1)
        )
        total = calibration.total_psf(camera.name)
        return cls(camera, calibration.best_psf(camera.name), total, true_psf(camera, total))

    @property
    def psfs(self) -> tuple[tuple[str, Psf], ...]:
        """PSFs, by what they add to a column's name."""
        return (("", self.measured), (", true", self.true), (", Gaussian", self.total))

    def zoomed(self, reference: FloatArray, zoom: float) -> dict[str, FloatImage]:
        """Follow-up by every model and peer but pyBSM."""
        return (
            self.zoomed_by_default(reference, zoom)
            | {
                model + suffix: zoom_out_image(reference, zoom, psf, model)
                for (suffix, psf), model in product(self.psfs, MODELS)
            }
            | {
                "paper": zoom_out_image(reference, zoom, self.total, "paper"),
                "bicubic": zoom_out_image(reference, zoom, None, "bicubic"),
                "Pillow + scipy": pillow_scipy(reference, zoom, self._round_sigma_px),
            }
        )

    def zoomed_by_default(self, reference: FloatArray, zoom: float) -> dict[str, FloatImage]:
        """Follow-up by the default model and the fastest peer."""
        return {
            DEFAULT_MODEL: zoom_out_image(reference, zoom, self.measured),
            "OpenCV": opencv(reference, zoom, self._round_sigma_px),
        }

    def posed(self, reference: FloatArray, pose: Pose) -> dict[str, FloatImage]:
        """Follow-up of a pose by every model that has poses."""
        size, k1 = (pose.followup_side, pose.followup_side), pose.distortion_k1
        return {
            model + suffix: simulate_pose_of_image(
                reference, pose.homography, size, psf, PoseOptions(model=model, distortion_k1=k1)
            ).image
            for (suffix, psf), model in product(self.psfs, MODELS)
        }

    @property
    def _round_sigma_px(self) -> float:
        return sqrt(self.total.sigma_x_px * self.total.sigma_y_px)


@dataclass(frozen=True, slots=True, kw_only=True)
class _ZoomRuns:
    """Which zoom-outs are judged: zooms, noises of the reference, and by all models or one."""

    zooms: Sequence[float]
    noises_dn: Sequence[float] = (0.0,)
    is_default_only: bool = False


def _judge_zooms(
    scene: Scene, cameras: Sequence[_Calibrated], runs: _ZoomRuns
) -> dict[float, _ModelErrors]:
    """Errors by lens and zoom, for every level of noise in the reference."""
    results = {noise_dn: _ModelErrors() for noise_dn in runs.noises_dn}
    for calibrated in cameras:
        camera = calibrated.camera
        reference = scene.reference(camera)
        for zoom in runs.zooms:
            for noise_dn, errors in _zoom_errors(calibrated, scene, reference, zoom, runs):
                case = f"{camera.name}, {zoom:g}"
                results[noise_dn].add(case, errors, is_counted=camera in BOUND_LENSES)
    return results


def _zoom_errors(
    calibrated: _Calibrated,
    scene: Scene,
    reference: FloatArray,
    zoom: float,
    runs: _ZoomRuns,
) -> Iterator[tuple[float, dict[str, float]]]:
    """Yield errors by column, for one level of noise after another."""
    camera = calibrated.camera
    margin = ceil(MARGIN_PX / zoom)
    middle = np.s_[margin:-margin, margin:-margin]
    positions = np.array(SamplingGrid.centred(reference.shape, zoom).cols_px)[middle[0]]
    x, y = positions[None, :], positions[:, None]
    truth = scene.seen(further(camera, zoom), x, y)
    make = calibrated.zoomed_by_default if runs.is_default_only else calibrated.zoomed
    for noise_dn in runs.noises_dn:
        noisy = reference + np.random.default_rng(3).normal(0.0, noise_dn, reference.shape)
        images = {name: image[middle] for name, image in make(noisy, zoom).items()}
        if HAS_PYBSM and noise_dn == 0 and not runs.is_default_only:
            images["pyBSM"] = pybsm(noisy, zoom, camera)[middle]
        ideal = Ideal.of(scene, camera, noise_dn)
        images["ideal"] = ideal.seen(noisy, further(camera, zoom), x, y)
        yield (
            noise_dn,
            {name: float(np.mean((image - truth) ** 2)) for name, image in images.items()},
        )


def _judge_poses(cameras: Sequence[_Calibrated], poses: Sequence[dict[str, Any]]) -> _ModelErrors:
    """Errors by lens and pose, where the follow-up is the coarser one."""
    results = _ModelErrors()
    scene = slanted_rectangles(POSE_SIDE_PX, POSE_SAMPLES, seed=7)
    for calibrated in cameras:
        camera = calibrated.camera
        reference = scene.reference(camera)
        for given in poses:
            pose = Pose(**given, reference_side=POSE_SIDE_PX, followup_side=POSE_FOLLOWUP_PX)
            truth = pose_photograph(scene, camera, pose)
            best = ideal_pose(Ideal.of(scene, camera, 0.0), camera, reference, pose)
            judged = pose.judged(MARGIN_PX)
            images = calibrated.posed(reference, pose) | {"ideal": best}
            errors = {
                name: float(np.mean((image - truth)[judged] ** 2)) for name, image in images.items()
            }
            results.add(f"{camera.name}, {pose.name}", errors, is_counted=True)
    return results


def _broken_zoom_bounds(zooms: _ModelErrors) -> Iterator[str]:
    """Yield what does not hold of zoom-outs without noise."""
    mean, worst = zooms.mean_ratio(DEFAULT_MODEL), zooms.worst_ratio(DEFAULT_MODEL)
    if not mean <= ZOOM_MEAN_MOST:
        yield f"zooms: the mean ratio is {mean:.2f}, not {ZOOM_MEAN_MOST}"
    if not worst <= ZOOM_WORST_MOST:
        yield f"zooms: the worst ratio is {worst:.2f}, not {ZOOM_WORST_MOST}"
    for index, case in enumerate(zooms.cases):
        at = zooms.at(index)
        if zooms.counted[index] and not at[DEFAULT_MODEL] <= at["bicubic"]:
            yield f"{case}: worse than bicubic"


def _broken_choice_bounds(by_noise: dict[float, _ModelErrors]) -> Iterator[str]:
    """Yield where ``lmmse`` is worse than ``matched``, with noise in the reference too."""
    for noise_dn, results in by_noise.items():
        for index, case in enumerate(results.cases):
            own, other = (results.at(index)[model] for model in ("lmmse", "matched"))
            if not own <= max(other * LMMSE_MOST, other + SLACK_DN2):
                noise = f"noise {noise_dn:g} DN"
                yield f"{case}, {noise}: lmmse leaves {_brief(own)}, matched {_brief(other)}"


def _broken_gaussian_bounds(zooms: _ModelErrors) -> Iterator[str]:
    """Yield where a model is worse for Gaussian cameras than it was."""
    for camera, zoom in product(GAUSSIANS_BEFORE, ZOOMS):
        case = f"{camera.name}, {zoom:g}"
        if case not in zooms.cases:
            continue
        figure = GAUSSIANS_BEFORE[camera][ZOOMS.index(zoom)]
        at = zooms.at(zooms.cases.index(case))
        for model, before in zip(("matched", "lmmse"), figure, strict=True):
            if not at[model] <= max(before * BEFORE_MOST, before + SLACK_DN2):
                yield f"{case}: {model} leaves {_brief(at[model])}, before {_brief(before)}"


def _broken_pose_bounds(poses: _ModelErrors) -> Iterator[str]:
    """Yield what does not hold of other poses."""
    worst = poses.worst_ratio(DEFAULT_MODEL)
    if not worst <= POSE_MOST:
        yield f"poses: the worst ratio is {worst:.2f}, not {POSE_MOST}"


def true_psf(camera: Camera, total: GaussianPsf) -> Psf:
    """The camera's optics as the capture model's own object."""
    variance = camera.sigma_px**2
    if not camera.has_pixel:
        return GaussianPsf(sigma_x_px=camera.sigma_px, sigma_y_px=camera.sigma_px)
    (xx, xy), (_, yy) = (np.array(camera.stretch) / camera.cut_off_cy_per_px).tolist()
    lens = LensOtf(
        cut_off_period_px=(0.0, 0.0, 0.0) if camera.cut_off_cy_per_px == inf else (xx, xy, yy),
        defocus_waves2=(camera.defocus_waves**2, 0.0, camera.defocus_waves**2),
        gaussian_px2=(variance, 0.0, variance),
    )
    return MeasuredPsf(lens=lens, gaussian=total)


def _judge(record: Recorder, cameras: Sequence[_Calibrated]) -> Iterator[str]:
    """Print and record all tables; yield the bounds that are broken."""
    scene = slanted_rectangles(SIDE_PX, ZOOM_SAMPLES, seed=0)
    runs = record.pick(_ZoomRuns(zooms=ZOOMS, noises_dn=NOISES_DN), _ZoomRuns(zooms=ZOOMS[1:]))
    by_noise = _judge_zooms(scene, cameras, runs)
    for noise_dn, results in by_noise.items():
        record.say(f"\nlens and zoom, {noise_dn:g} DN of noise in the reference")
        record.say(results.table(COLUMNS))
        if any(results.counted):
            what = f"zooms, noise {noise_dn:g} DN"
            _record_ratios(record, what, results, "OpenCV")
            if "pyBSM" in results.errors:
                _record_ratios(record, what, results, "pyBSM")
    noise_free = by_noise[0.0]
    if any(noise_free.counted):
        yield from _broken_zoom_bounds(noise_free)
    yield from _broken_choice_bounds(by_noise)
    yield from _broken_gaussian_bounds(noise_free)
    posed = [calibrated for calibrated in cameras if calibrated.camera in POSE_LENSES]
    if posed:
        poses = _judge_poses(posed, record.pick(POSES, POSES[2:3]))
        record.say("\nposes")
        record.say(poses.table(COLUMNS))
        _record_ratios(record, "poses", poses, f"{DEFAULT_MODEL} with a Gaussian PSF")
        yield from _broken_pose_bounds(poses)


def _judge_noisier_edges(record: Recorder, lenses: Sequence[Camera]) -> None:
    """Record how near the default model comes with edges of a lower SNR."""
    scene = slanted_rectangles(SIDE_PX, ZOOM_SAMPLES, seed=0)
    counted = [lens for lens in lenses if lens in BOUND_LENSES]
    for snr in record.pick(OTHER_SNRS, OTHER_SNRS[1:]) if counted else ():
        cameras = [_Calibrated.of(lens, snr) for lens in counted]
        runs = _ZoomRuns(zooms=record.pick(ZOOMS, ZOOMS[2:]), is_default_only=True)
        results = _judge_zooms(scene, cameras, runs)[0.0]
        record.say(f"\nlens and zoom, edges at SNR {snr:g}")
        record.say(results.table(COLUMNS))
        _record_ratios(record, f"zooms, edges at SNR {snr:g}", results, "OpenCV")


def _record_ratios(record: Recorder, what: str, results: _ModelErrors, peer: str) -> None:
    """Keep the mean and the worst ratio of the default model, beside a peer's."""
    column = peer.replace(" with a Gaussian PSF", ", Gaussian")
    name = "OpenCV's blur and resize" if peer == "OpenCV" else peer
    for which, ratio in (("mean", results.mean_ratio), ("worst", results.worst_ratio)):
        record.figure(
            f"{which} MSE over the ideal's, {what}, {DEFAULT_MODEL}",
            ratio(DEFAULT_MODEL),
            "",
            name,
            ratio(column),
        )


@benchmark(
    "numpy",
    "scipy",
    "Pillow",
    "opencv-contrib-python-headless",
    note=f"MSE in DN^2, edges at SNR {{snr:g}}; default model {DEFAULT_MODEL}",
)
def main(
    record: Recorder,
    *,
    snr: Annotated[float, f"of the edges, {SNR:g} by default"] = SNR,
    lens: Annotated[str, "only lenses whose name contains this text"] = "",
) -> None:
    if not HAS_PYBSM:
        record.say("without pyBSM: pip install --no-deps pybsm")
    lenses = record.pick((*BOUND_LENSES, *OTHER_LENSES), QUICK_LENSES)
    lenses = tuple(one for one in lenses if lens in one.name)
    cameras = [_Calibrated.of(one, snr) for one in lenses]
    broken = [*_judge(record, cameras)]
    if snr == SNR:
        _judge_noisier_edges(record, lenses)
    if broken and snr == SNR:
        sys.exit("\n".join(broken))
