"""The transfer of any lens from photographs at two distances: a candidate beside what is in use.

``benchmarks/lens_between`` fits a lens of the prior, 400 drawn pupils, where ``two-distance`` fits
a Gaussian. Both measure the pairs without an edge of the public benchmark's track ``psf``. Printed
are errors of the MTF50 along x and y, and how many of the 95 % intervals hold the truth; then a
smooth scene, blobs behind a Gaussian, whose near photograph has noise and whose far one has none.

    OMP_NUM_THREADS=1 python -m benchmarks.studies.two_distance_lens [--seeds N,N,...]
"""

from collections.abc import Iterator
from dataclasses import dataclass
from io import BytesIO
from math import log, pi, sqrt
from typing import Annotated

import numpy as np
from PIL import Image

import standoff
from benchmarks.harness import Recorder, benchmark
from benchmarks.lens_between.lens_estimate import LensEstimate
from benchmarks.lens_between.pairs import NearAndFar, lens_between
from benchmarks.peers.ours import noise_of
from benchmarks.peers.program import LINEAR_MAX_DN, Task, srgb_decoded
from benchmarks.studies.one_photograph import pairs_without_edge
from calibration.edges import JpegCompression
from calibration.registration import register_images
from simulation.arrays import FloatArray
from standoff.errors import REPORTED_ERRORS
from tests.calibration.blob_scene import blob_photograph

SEEDS = (7103, 7104)
_QUICK = 4
_ZOOM, _SHAPE = 2.0, (240, 320)
_NOISES_DN = (0.0, 5.0, 20.0)
_WIDTHS_PX2 = (0.45, 0.33)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Found:
    """Relative errors of the MTF50 along both axes, those stated, and of whom."""

    program: str
    condition: str
    errors: tuple[float, ...]
    stated: tuple[float, ...]


def _pairs(seed: int, count: int | None) -> Iterator[_Found]:
    """What both find on the pairs of a seed."""
    for task, truth in pairs_without_edge(seed, count):
        mtf50_true = np.array([truth["edges"][way]["mtf50"] for way in ("x", "y")])
        for program, find in (("candidate", _candidate), ("two-distance", _in_use)):
            try:
                mtf50, stated = find(task)
            except REPORTED_ERRORS:
                continue
            yield _Found(
                program=program,
                condition=truth["condition"],
                errors=tuple((mtf50 / mtf50_true - 1).tolist()),
                stated=tuple((stated / mtf50_true).tolist()),
            )


def _candidate(task: Task) -> tuple[FloatArray, FloatArray]:
    near, far = task.linear("nearer_file"), task.linear("file")
    pair = NearAndFar(
        near_dn=near,
        far_dn=far,
        near_noise_dn2=_noise_dn2(task, near),
        near_codes=_codes(task, "nearer_file"),
        far_codes=_codes(task, "file"),
    )
    return _along_axes(lens_between(pair, register_images(near, far).pose.nearest_homography()))


def _along_axes(lens: LensEstimate) -> tuple[FloatArray, FloatArray]:
    """MTF50 along x and y, and its standard errors, in cy/px."""
    gaussian = lens.nearest_gaussian()
    px2 = gaussian.px2[[0, 2]]
    err_px2 = np.sqrt(np.diag(gaussian.covariance))[[0, 2]]
    mtf50 = np.sqrt(log(2) / 2 / px2) / pi
    return mtf50, mtf50 * err_px2 / px2 / 2


def _in_use(task: Task) -> tuple[FloatArray, FloatArray]:
    files = [task.path("nearer_file"), task.path("file")]
    psf = standoff.calibrate_psf(files, method="two-distance", noise=noise_of(task))
    sigma = np.array([psf.sigma_x_px, psf.sigma_y_px])
    err = np.array([psf.sigma_x_err_px, psf.sigma_y_err_px])
    mtf50 = sqrt(log(2) / 2) / pi / sigma
    return mtf50, mtf50 * err / sigma


def _noise_dn2(task: Task, near_dn: FloatArray) -> float | None:
    """Of linear pictures; that of encoded ones is told by the pair."""
    noise = task.facts["noise"]
    if not task.is_linear:
        return None
    level = float(near_dn.mean()) - float(task.facts["black_level"])
    return float(noise["variance_at_black_dn2"]) + float(noise["variance_per_dn"]) * level


def _codes(task: Task, key: str) -> JpegCompression | None:
    """How a picture was compressed, and the levels of its codes."""
    path = task.path(key)
    if path.suffix != ".jpg":
        return None
    with Image.open(BytesIO(path.read_bytes())) as opened:
        steps = np.array(opened.quantization[0], dtype=np.float64).reshape(8, 8)  # type: ignore[attr-defined]  # JPEG's own
    levels = LINEAR_MAX_DN * srgb_decoded(np.arange(256.0) / 255)
    return JpegCompression(steps=steps, code_levels_dn=levels)


def _say_pairs(record: Recorder, found: list[_Found]) -> None:
    for program in ("candidate", "two-distance"):
        for condition in ("", *sorted({one.condition for one in found})):
            own = [one for one in found if one.program == program]
            own = [one for one in own if condition in ("", one.condition)]
            if not own:
                continue
            errors = np.array([error for one in own for error in one.errors])
            stated = np.array([error for one in own for error in one.stated])
            held = 100 * float(np.mean(np.abs(errors) <= 1.96 * stated))
            median = 100 * float(np.median(np.abs(errors)))
            record.say(
                f"  {program:14} {condition or 'all':14} {len(own):3d} pairs, median {median:.2f} "
                f"%, {held:.0f} % of intervals hold, {100 * np.abs(errors).max():.1f} % at most"
            )
            if not condition:
                record.figure(f"two distances: median error of MTF50, {program}", median, "%")
                record.figure(f"two distances: 95 % intervals that hold, {program}", held, "%")


def _say_blobs(record: Recorder, noise_dn: float) -> None:
    """A smooth scene, of which only the near photograph has noise."""
    near, far = (blob_photograph(zoom, np.diag(_WIDTHS_PX2), shape=_SHAPE) for zoom in (1.0, _ZOOM))
    noisy = near + np.random.default_rng(5).normal(0, noise_dn, near.shape)
    down, right = ((side - 1) / 2 * (1 - _ZOOM) for side in _SHAPE)
    to_near = np.array([[_ZOOM, 0, right], [0, _ZOOM, down], [0, 0, 1]])
    pair = NearAndFar(near_dn=noisy, far_dn=far, near_noise_dn2=noise_dn**2)
    gaussian = lens_between(pair, to_near).nearest_gaussian()
    sigma = np.sqrt(gaussian.px2[[0, 2]])
    err = np.sqrt(np.diag(gaussian.covariance))[[0, 2]] / sigma / 2
    off = sigma / np.sqrt(_WIDTHS_PX2) - 1
    record.figure(f"blobs, noise of {noise_dn:g} DN: width off at most", 100 * abs(off).max(), "%")
    record.say(
        "  stated " + ", ".join(f"{100 * e / s:.1f} %" for e, s in zip(err, sigma, strict=True))
    )


@benchmark("numpy", "scipy", "Pillow")
def main(
    record: Recorder,
    *,
    seeds: Annotated[str, "of the benchmark, with commas"] = ",".join(map(str, SEEDS)),
) -> None:
    numbers = record.pick([int(seed) for seed in seeds.split(",")], [1])
    _say_pairs(
        record,
        [one for seed in numbers for one in _pairs(seed, record.pick(None, _QUICK))],
    )
    for noise_dn in _NOISES_DN:
        _say_blobs(record, noise_dn)
