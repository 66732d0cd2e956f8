"""Speed of the general pose beside OpenCV's Gaussian blur and cubic warp.

One thread, float32, kernels cached; the first call, which makes them, is a figure of its own. The
peer blurs by one Gaussian for the whole image and then interpolates by cubics: the least that any
simulation of a follow-up does. The plane's tilt leads along the columns, or at 45 degrees to them.
Memory is what either takes at most beyond the reference, the result included.

A PSF that varies over the frame, its sigma by 30 % from the middle to the corners, is timed at
plain zooms: with such a PSF they are made as a pose is.
"""

import os
import time
from functools import partial
from math import sqrt

import cv2
import numpy as np

from benchmarks.harness import Recorder, Work, benchmark
from benchmarks.truth.pairs import PairPose
from benchmarks.truth.sweep_scenes import memory_bytes
from simulation import (
    GaussianPsf,
    LensOtf,
    MeasuredPsf,
    PoseOptions,
    Psf,
    PsfField,
    SamplingGrid,
    simulate_pose_of_image,
)
from simulation.arrays import Float32Array, FloatArray
from simulation.choices import POSE_MODELS

SIGMA_PX = 0.7
GAUSSIAN = GaussianPsf(sigma_x_px=SIGMA_PX, sigma_y_px=SIGMA_PX)
CUT_OFF_PERIOD_PX = 0.55 * 5.6 / 8.3  # 550 nm, f/5.6, pixels of 8.3 um
LENSES: tuple[tuple[str, Psf], ...] = (
    ("Gaussian 0.7 px", GAUSSIAN),
    (
        "f/5.6 + 0.3 wave",
        MeasuredPsf(
            lens=LensOtf(
                cut_off_period_px=(CUT_OFF_PERIOD_PX, 0.0, CUT_OFF_PERIOD_PX),
                defocus_waves2=(0.09, 0.0, 0.09),
            ),
            gaussian=GAUSSIAN,
        ),
    ),
)
FIELD_ZOOMS = (1.3, 2.0, 3.0)
SHAPES = ((580, 780), (3000, 4000))
POSES = ((0.0, 0.0, 1.5), (10.0, 0.0, 1.3), (20.0, 0.0, 1.5), (20.0, 45.0, 2.0))
"""Tilt and its bearing in degrees, zoom on the axis."""

PEER = "OpenCV's blur and cubic warp"


def _homography(
    shape: tuple[int, int], tilt_deg: float, bearing_deg: float, zoom: float
) -> FloatArray:
    """Camera that looks at the reference's centre from ``zoom`` times its distance."""
    return PairPose(zoom=zoom, tilt_deg=tilt_deg, bearing_deg=bearing_deg).matrix(shape)


def _blurred_and_warped(
    image: Float32Array, matrix: FloatArray, zoom: float, size: tuple[int, int]
) -> object:
    """What OpenCV alone makes of it."""
    blurred = cv2.GaussianBlur(image, (0, 0), SIGMA_PX * sqrt(zoom * zoom - 1))
    return cv2.warpPerspective(blurred, matrix, size, flags=cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP)


def _memory_mb(work: Work) -> float:
    """Most memory that a run takes in a process of its own, beyond what there was before."""
    reading, writing = os.pipe()
    process = os.fork()
    if process == 0:
        before = memory_bytes("VmRSS")
        work()
        os.write(writing, str(memory_bytes("VmHWM") - before).encode())
        os._exit(0)
    os.close(writing)
    with os.fdopen(reading) as answer:
        taken = int(answer.read())
    os.waitpid(process, 0)
    return taken / 1e6


def _compare_memory(record: Recorder, shape: tuple[int, int]) -> None:
    """Measure the memory of every lens at one pose, before anything else has left memory behind."""
    image = np.random.default_rng(0).uniform(0, 255, shape).astype(np.float32)
    size, pose = (shape[1], shape[0]), POSES[2]
    matrix = _homography(shape, *pose)
    peer_mb = _memory_mb(partial(_blurred_and_warped, image, matrix, pose[2], size))
    for name, psf in LENSES:
        own_mb = _memory_mb(partial(simulate_pose_of_image, image, matrix, size, psf))
        record.figure(
            f"memory of a pose, {name}, {size[0]} x {size[1]}", own_mb, "MB", PEER, peer_mb
        )


def _compare(record: Recorder, shape: tuple[int, int]) -> None:
    """Time all lenses, poses and models for one size."""
    image = np.random.default_rng(0).uniform(0, 255, shape).astype(np.float32)
    size, seconds = (shape[1], shape[0]), record.pick(1.0, 0.1)
    for name, psf in LENSES:
        for tilt_deg, bearing_deg, zoom in POSES:
            matrix = _homography(shape, tilt_deg, bearing_deg, zoom)
            for model in POSE_MODELS:
                own = partial(
                    simulate_pose_of_image, image, matrix, size, psf, PoseOptions(model=model)
                )
                start_s = time.perf_counter()
                own()
                took_ms = 1e3 * (time.perf_counter() - start_s)
                record.say(f"the first call takes {took_ms:.0f} ms")
                case = f"{name}, {size[0]} x {size[1]}, tilt {tilt_deg:g} at {bearing_deg:g}"
                peer = partial(_blurred_and_warped, image, matrix, zoom, size)
                record.race(f"pose, {case}, zoom {zoom}, {model}", own, PEER, peer, seconds)


def _corner_field(shape: tuple[int, int]) -> PsfField:
    """PSF whose sigma grows by 30 % with the square of the distance from the middle."""
    coefficients_px2 = np.zeros((3, 15))
    # (1 + .3 r^2)^2 with r^2 = u^2 + v^2
    coefficients_px2[:, [0, 3, 5, 10, 12, 14]] = SIGMA_PX**2 * np.array(
        [1, 0.6, 0.6, 0.09, 0.18, 0.09]
    )
    coefficients_px2[1] = 0
    return PsfField(width_px=shape[1], height_px=shape[0], coefficients_px2=coefficients_px2)


def _compare_fields(record: Recorder, shape: tuple[int, int]) -> None:
    """Time zooms and models for a PSF that varies over the frame."""
    image = np.random.default_rng(0).uniform(0, 255, shape).astype(np.float32)
    field, (rows, cols) = _corner_field(shape), shape
    for zoom in FIELD_ZOOMS:
        grid = SamplingGrid.centred(shape, zoom)
        size, origin_px = (grid.cols, grid.rows), ((cols - grid.cols) / 2, (rows - grid.rows) / 2)
        for model in POSE_MODELS:
            options = PoseOptions(model=model, origin_px=origin_px)
            record.race(
                f"PSF that varies, {cols} x {rows}, zoom {zoom}, {model}",
                partial(simulate_pose_of_image, image, grid.matrix, size, field, options),
                PEER,
                partial(_blurred_and_warped, image, grid.matrix, zoom, size),
                record.pick(1.0, 0.1),
            )


@benchmark("numpy", "numba", "scipy", "opencv-contrib-python-headless", note="one thread, float32")
def main(record: Recorder) -> None:
    cv2.setNumThreads(1)
    # Compiles.
    matrix = _homography((64, 64), 5.0, 0.0, 1.5)
    simulate_pose_of_image(np.zeros((64, 64), np.float32), matrix, (64, 64), GAUSSIAN)
    shapes = record.pick(SHAPES, SHAPES[:1])
    for shape in shapes:
        _compare_memory(record, shape)
    for shape in shapes:
        _compare(record, shape)
    _compare_fields(record, shapes[0])
