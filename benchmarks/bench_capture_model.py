"""Any lens, any pose: the capture model beside the best that is linear, and beside its peers.

Opaque slanted rectangles as cameras with known optics see them, exactly. Every model simulates the
follow-up from the reference, with the PSF that ``calibrate`` measures on photographs of edges by
the same camera, or with the true one; what is judged is its mean squared error in the middle of the
frame, in DN^2, beside that of the best linear estimate with the true transfer function and
unlimited support ("ideal"). Exits with the bounds that are broken, if any.
"""

import argparse
import sys
from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from inspect import signature
from math import ceil, inf, sqrt
from typing import Any

import numpy as np
from scipy.stats import gmean

import standoff
from benchmarks.harness import Recorder, bench_parser
from benchmarks.ideal_lmmse import Ideal
from benchmarks.lens_optics import (
    ROUND,
    Camera,
    astigmatic,
    edge_photographs,
    f_number,
    further,
    gaussian,
)
from benchmarks.lens_poses import Pose, ideal_pose, pose_photograph
from benchmarks.lens_scenes import Scene, slanted_rectangles
from benchmarks.zoom_peers import HAS_PYBSM, opencv, pillow_scipy, pybsm
from calibration.psf import PsfCalibration
from simulation import (
    GaussianPsf,
    LensOtf,
    MeasuredPsf,
    Model,
    PoseOptions,
    Psf,
    SamplingGrid,
    simulate_pose,
    zoom_out,
)
from simulation.arrays import FloatArray, FloatImage
from simulation.choices import DEFAULT_MODEL, POSE_MODELS, PoseModel

BOUND_LENSES = (
    f_number(1.4),
    f_number(2.8),
    f_number(5.6),
    f_number(8),
    f_number(11),
    f_number(2.8, defocus_waves=1.0),
    f_number(5.6, defocus_waves=0.5),
)
OTHER_LENSES = (
    astigmatic(5.6, ratio=1.6, axis_deg=30),
    gaussian(0.5, has_pixel=False),
    gaussian(0.7, has_pixel=False),
    gaussian(1.2, has_pixel=False),
    gaussian(0.5, has_pixel=True),
)
POSE_LENSES = (f_number(2.8), f_number(5.6, defocus_waves=0.5), f_number(11))
ZOOMS = (1.5, 2.0, 3.0)
POSES = (
    {"zoom": 1.3, "tilt_deg": 10.0},
    {"zoom": 1.5, "tilt_deg": 25.0, "bearing_deg": 45.0, "turn_deg": 20.0},
    {"zoom": 2.0, "tilt_deg": 30.0, "bearing_deg": 30.0, "turn_deg": 15.0},
    {"zoom": 2.0, "tilt_deg": 20.0, "distortion_k1": -0.01},
    {"zoom": 1.5, "tilt_deg": 30.0, "bearing_deg": 90.0, "turn_deg": 45.0, "distortion_k1": 0.01},
)
NOISES_DN = (0.0, 0.5, 1.5)

SIDE_PX, QUICK_SIDE_PX = 288, 192
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
FLOOR_DN2 = 0.01
"""Added to the ideal: a millionth of the scene's variance matters to no one."""

ZOOM_MEAN_MOST, ZOOM_WORST_MOST, POSE_MOST = 1.5, 4.0, 2.0
LMMSE_MOST, LMMSE_SLACK_DN2 = 1.01, 0.001

COLUMNS = (
    "bicubic",
    "paper",
    "Pillow + scipy",
    "OpenCV",
    "pyBSM",
    "matched, Gaussian",
    "lmmse, Gaussian",
    "matched",
    "lmmse",
    "matched, true",
    "lmmse, true",
    "ideal",
)
"""A model's name alone is with the PSF as measured; with the Gaussian nearest to it, or the true
one, it says so."""

DEFAULT: Model = signature(zoom_out).parameters["model"].default


@dataclass(frozen=True, slots=True, eq=False)
class Taken:
    """One camera's PSFs: as measured, its Gaussian alone, and the true one."""

    camera: Camera
    measured: Any
    total: GaussianPsf
    true: Any

    @classmethod
    def of(cls, camera: Camera, snr: float) -> "Taken":
        """Calibrate on photographs of edges."""
        angles = EDGE_ANGLES_DEG if camera.stretch == ROUND else ASTIGMATIC_ANGLES_DEG
        calibration = standoff.calibrate_psf(
            edge_photographs(camera, angles, EDGE_SIDE_PX, snr, seed=1)
        )
        total = calibration.total_psf(camera.name)
        return cls(camera, _best_psf(calibration, camera.name), total, _true_psf(camera, total))

    def zoomed(self, reference: FloatArray, zoom: float) -> dict[str, FloatImage]:
        """Follow-up by every model and peer."""
        sigma_px = sqrt(self.total.sigma_x_px * self.total.sigma_y_px)
        made = {
            "bicubic": zoom_out(reference, zoom, None, "bicubic"),
            "paper": zoom_out(reference, zoom, self.total, "paper"),
            "Pillow + scipy": pillow_scipy(reference, zoom, sigma_px),
            "OpenCV": opencv(reference, zoom, sigma_px),
        }
        models: tuple[Model, ...] = ("matched", "lmmse")
        for suffix, psf in ((", Gaussian", self.total), ("", self.measured), (", true", self.true)):
            for model in models:
                made[model + suffix] = zoom_out(reference, zoom, psf, model)
        return made

    def posed(self, reference: FloatArray, pose: Pose) -> dict[str, FloatImage]:
        """Follow-up of a pose by every model that has poses."""
        return {
            f"{model}{suffix}": _pose_image(reference, pose, psf, model)
            for suffix, psf in (
                (", Gaussian", self.total),
                ("", self.measured),
                (", true", self.true),
            )
            for model in POSE_MODELS
        }


@dataclass(frozen=True, slots=True, eq=False)
class Results:
    """Mean squared errors in DN^2 by case and column; the column ``ideal`` is among them."""

    cases: list[str] = field(default_factory=list)
    errors: dict[str, list[float]] = field(default_factory=lambda: defaultdict(list))
    bound: list[bool] = field(default_factory=list)

    def add(self, case: str, errors: dict[str, float], *, is_bound: bool) -> None:
        """Append one case."""
        self.cases.append(case)
        self.bound.append(is_bound)
        for column, value in errors.items():
            self.errors[column].append(value)

    def ratios(self, column: str) -> FloatArray:
        """Error over the ideal's and the floor, of the cases that bounds count."""
        counted = np.array(self.bound)
        own, ideal = np.array(self.errors[column]), np.array(self.errors["ideal"])
        return np.asarray((own / (ideal + FLOOR_DN2))[counted])

    def table(self) -> str:
        """Markdown table of all cases, then mean and worst ratio of those that bounds count."""
        columns = [name for name in COLUMNS if name in self.errors]
        lines = [f"| case | {' | '.join(columns)} |", "|---|" + "---:|" * len(columns)]
        for index, case in enumerate(self.cases):
            values = " | ".join(_brief(self.errors[column][index]) for column in columns)
            lines.append(f"| {case} | {values} |")
        for name, summary in (("geometric mean of ratio", gmean), ("worst ratio", np.max)):
            values = " | ".join(_brief(float(summary(self.ratios(column)))) for column in columns)
            lines.append(f"| **{name}** | {values} |")
        return "\n".join(lines)


def judge_zooms(record: Recorder, cameras: Sequence[Taken]) -> dict[float, Results]:
    """Table lens and zoom by model, for every level of noise in the reference."""
    noises_dn = record.pick(NOISES_DN, NOISES_DN[:1])
    results = {noise_dn: Results() for noise_dn in noises_dn}
    scene = slanted_rectangles(record.pick(SIDE_PX, QUICK_SIDE_PX), ZOOM_SAMPLES, seed=0)
    for taken in cameras:
        reference = scene.reference(taken.camera)
        for zoom in record.pick(ZOOMS, ZOOMS[1:]):
            case = f"{taken.camera.name}, {zoom:g}"
            for noise_dn, errors in _zoom_errors(taken, scene, reference, zoom, noises_dn):
                results[noise_dn].add(case, errors, is_bound=taken.camera in BOUND_LENSES)
    return results


def _zoom_errors(
    taken: Taken,
    scene: Scene,
    reference: FloatArray,
    zoom: float,
    noises_dn: Sequence[float],
) -> Iterator[tuple[float, dict[str, float]]]:
    """Yield errors by column, for one level of noise after another."""
    margin = ceil(MARGIN_PX / zoom)
    middle = np.s_[margin:-margin, margin:-margin]
    places = np.array(SamplingGrid.centred(reference.shape, zoom).cols_px)[middle[0]]
    x, y = places[None, :], places[:, None]
    truth = scene.seen(further(taken.camera, zoom), x, y)
    for noise_dn in noises_dn:
        taken_image = _noisy(reference, noise_dn)
        images = {name: image[middle] for name, image in taken.zoomed(taken_image, zoom).items()}
        if HAS_PYBSM and noise_dn == 0:
            images["pyBSM"] = pybsm(taken_image, zoom, taken.camera)[middle]
        ideal = Ideal.of(scene, taken.camera, noise_dn)
        images["ideal"] = ideal.seen(taken_image, further(taken.camera, zoom), x, y)
        yield (
            noise_dn,
            {name: float(np.mean((image - truth) ** 2)) for name, image in images.items()},
        )


def judge_poses(record: Recorder, cameras: Sequence[Taken]) -> Results:
    """Table lens x pose x model, where the follow-up is the coarser one."""
    results = Results()
    scene = slanted_rectangles(POSE_SIDE_PX, POSE_SAMPLES, seed=7)
    for taken in cameras:
        for given in record.pick(POSES, POSES[2:3]):
            pose = Pose(**given, reference_side=POSE_SIDE_PX, followup_side=POSE_FOLLOWUP_PX)
            reference = scene.reference(taken.camera)
            truth = pose_photograph(scene, taken.camera, pose)
            best = ideal_pose(Ideal.of(scene, taken.camera, 0.0), taken.camera, reference, pose)
            judged = pose.judged(MARGIN_PX)
            images = taken.posed(reference, pose) | {"ideal": best}
            errors = {
                name: float(np.mean((image - truth)[judged] ** 2)) for name, image in images.items()
            }
            results.add(f"{taken.camera.name}, {pose.name}", errors, is_bound=True)
    return results


def broken_bounds(zooms: Results, poses: Results) -> list[str]:
    """Sentences about the bounds that do not hold, default options and noise-free."""
    broken = []
    ratios = zooms.ratios(DEFAULT)
    if not gmean(ratios) <= ZOOM_MEAN_MOST:
        broken.append(f"zooms: the mean ratio is {gmean(ratios):.2f}, not {ZOOM_MEAN_MOST}")
    if not ratios.max() <= ZOOM_WORST_MOST:
        broken.append(f"zooms: the worst ratio is {ratios.max():.2f}, not {ZOOM_WORST_MOST}")
    for index, case in enumerate(zooms.cases):
        at = {column: values[index] for column, values in zooms.errors.items()}
        if zooms.bound[index] and at[DEFAULT] > at["bicubic"]:
            broken.append(f"{case}: worse than bicubic")
        most = max(at["matched"] * LMMSE_MOST, at["matched"] + LMMSE_SLACK_DN2)
        if at["lmmse"] > most:
            broken.append(
                f"{case}: lmmse leaves {_brief(at['lmmse'])}, matched {_brief(at['matched'])}"
            )
    worst = poses.ratios(DEFAULT_MODEL).max()
    if not worst <= POSE_MOST:
        broken.append(f"poses: the worst ratio is {worst:.2f}, not {POSE_MOST}")
    return broken


def _best_psf(calibration: PsfCalibration, source: str) -> Any:  # noqa: ANN401
    return getattr(calibration, "best_psf", calibration.total_psf)(source)


def _true_psf(camera: Camera, total: GaussianPsf) -> Psf:
    """The camera's optics as the capture model's own object."""
    variance = camera.sigma_px**2
    if not camera.has_pixel:
        return GaussianPsf(sigma_x_px=camera.sigma_px, sigma_y_px=camera.sigma_px)
    (xx, xy), (_, yy) = (np.array(camera.stretch) / camera.cut_off_cy_per_px).tolist()
    lens = LensOtf(
        cut_off_period_px=(0.0, 0.0, 0.0) if camera.cut_off_cy_per_px == inf else (xx, xy, yy),
        defocus_waves=camera.defocus_waves,
        gaussian_px2=(variance, 0.0, variance),
    )
    return MeasuredPsf(lens=lens, gaussian=total)


def _pose_image(reference: FloatArray, pose: Pose, psf: Psf, model: PoseModel) -> FloatImage:
    size = (pose.followup_side, pose.followup_side)
    options = PoseOptions(model=model, distortion_k1=pose.distortion_k1)
    return simulate_pose(reference, pose.homography, size, psf, options).image


def _noisy(image: FloatArray, noise_dn: float) -> FloatArray:
    return image + np.random.default_rng(3).normal(0.0, noise_dn, image.shape)


def _brief(value: float) -> str:
    """Three digits, without an exponent where it can be helped."""
    return f"{value:.0f}" if value >= 100 else f"{value:.3g}" if value >= 1e-4 else f"{value:.0e}"


def _parser() -> argparse.ArgumentParser:
    parser = bench_parser(__doc__)
    parser.add_argument("--snr", type=float, default=500.0, help="of the edges, 500 by default")
    parser.add_argument("--lens", help="only lenses whose name contains this text")
    return parser


def main() -> None:
    given = _parser().parse_args()
    packages = ("numpy", "scipy", "pillow", "opencv-contrib-python-headless")
    note = f"MSE in DN^2, edges at SNR {given.snr:g}; default model {DEFAULT}"
    with Recorder.of(given, "capture_model", packages=packages, note=note) as record:
        if not HAS_PYBSM:
            record.say("without pyBSM: pip install --no-deps pybsm")
        lenses = [
            lens
            for lens in (*BOUND_LENSES, *record.pick(OTHER_LENSES, OTHER_LENSES[:2]))
            if given.lens is None or given.lens in lens.name
        ]
        cameras = [Taken.of(lens, given.snr) for lens in lenses]
        by_noise = judge_zooms(record, cameras)
        for noise_dn, results in by_noise.items():
            record.say(f"\nlens and zoom, {noise_dn:g} DN of noise in the reference")
            record.say(results.table())
        posed = [taken for taken in cameras if taken.camera in POSE_LENSES]
        poses = judge_poses(record, posed)
        record.say("\nposes")
        record.say(poses.table())
        record_figures(record, by_noise, poses)
        broken = broken_bounds(by_noise[0.0], poses)
    if broken:
        sys.exit("\n".join(broken))


def record_figures(record: Recorder, by_noise: dict[float, Results], poses: Results) -> None:
    """Keep the mean and the worst ratio of the default model, beside OpenCV's."""
    for noise_dn, results in by_noise.items():
        for name, summary in (("mean", gmean), ("worst", np.max)):
            record.figure(
                f"{name} MSE over the ideal's, zooms, noise {noise_dn:g} DN, {DEFAULT}",
                float(summary(results.ratios(DEFAULT))),
                "",
                peer="OpenCV's blur and resize",
                peer_value=float(summary(results.ratios("OpenCV"))),
            )
    record.figure(
        f"worst MSE over the ideal's, poses, {DEFAULT_MODEL}",
        float(poses.ratios(DEFAULT_MODEL).max()),
        "",
    )


if __name__ == "__main__":
    main()
