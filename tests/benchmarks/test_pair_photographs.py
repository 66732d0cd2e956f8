"""The renderer of two photographs, beside closed forms."""

from math import pi

import numpy as np
import pytest

from benchmarks.truth.lenses import f_number, gaussian
from benchmarks.truth.pairs import (
    SAMPLES_PER_PX,
    SCENES,
    Development,
    FlatScene,
    PairPose,
    pair_of,
    photograph,
    scene,
    seen_spot,
)
from simulation.arrays import FloatArray

FRAME = (90, 120)
MIDDLE_X, MIDDLE_Y = (FRAME[1] - 1) / 2, (FRAME[0] - 1) / 2
FREQ = (0.11, -0.06)  # cycles per reference pixel along x and y
POSE = PairPose(zoom=1.4, tilt_deg=6, bearing_deg=50, turn_deg=20, shift=(0.05, -0.1))


def wave() -> FlatScene:
    rows, cols = (3 * n * SAMPLES_PER_PX for n in FRAME)
    y, x = np.mgrid[:rows, :cols] / SAMPLES_PER_PX
    level = 100 + 50 * np.cos(2 * pi * (FREQ[0] * x + FREQ[1] * y))
    return FlatScene(name="wave", coefficients=level.astype(np.float32), origin_px=(120.0, 90.0))


def spline_transfer(freq_cy_per_px: float) -> float:
    """Of the samples of a cubic B-spline's continuous function: sinc^4 of cycles per sample."""
    return float(np.sinc(freq_cy_per_px / SAMPLES_PER_PX) ** 4)


def expected(x: FloatArray, y: FloatArray, transfer: FloatArray | float) -> FloatArray:
    own = spline_transfer(FREQ[0]) * spline_transfer(FREQ[1])
    return 100 + 50 * own * transfer * np.cos(2 * pi * (FREQ[0] * (x + 120) + FREQ[1] * (y + 90)))


def test_the_reference_is_the_scene_times_the_transfer_function() -> None:
    camera = f_number(5.6)
    found = photograph(wave(), FRAME, PairPose(), camera)
    y, x = np.mgrid[: FRAME[0], : FRAME[1]].astype(np.float64)
    transfer = camera.otf(*np.array(FREQ)[:, None])
    # 0.02: float32, and the replicas of the spline's samples (1e-4 of 50 DN).
    assert np.abs(found - expected(x, y, transfer))[8:-8, 8:-8].max() < 0.02


def test_a_followup_shows_the_wave_at_its_local_frequency() -> None:
    camera = gaussian(0.8, has_pixel=False)
    found = photograph(wave(), FRAME, POSE, camera)
    y, x = np.mgrid[: FRAME[0], : FRAME[1]].astype(np.float64)
    u, v = POSE.positions(x, y, FRAME)
    phase = FREQ[0] * u + FREQ[1] * v
    along_y, along_x = (np.asarray(slope) for slope in np.gradient(phase))
    transfer = camera.otf(along_x, along_y)
    # 0.1: across the PSF, the tilt changes the local frequency by some 1e-3 of itself.
    assert np.abs(found - expected(u, v, transfer))[10:-10, 10:-10].max() < 0.1


def test_a_pose_without_motion_maps_pixels_to_themselves_through_any_lens() -> None:
    x, y = np.array([3.0, 100.0]), np.array([80.0, 2.0])
    u, v = PairPose(distortion_k1=-0.03).positions(x, y, FRAME)
    assert u == pytest.approx(x, abs=1e-9)
    assert v == pytest.approx(y, abs=1e-9)


def test_a_zoom_out_keeps_the_middle_and_scales_by_the_zoom() -> None:
    u, v = PairPose(zoom=2.0).positions(np.array([MIDDLE_X + 10]), np.array([MIDDLE_Y]), FRAME)
    assert u == pytest.approx(MIDDLE_X + 20)
    assert v == pytest.approx(MIDDLE_Y)


def test_a_spot_has_the_width_and_height_that_were_asked_for() -> None:
    flat = FlatScene(
        name="flat", coefficients=np.full((900, 1200), 80.0, np.float32), origin_px=(50.0, 50.0)
    )
    camera = gaussian(0.9, has_pixel=False)
    pose = PairPose(zoom=1.5, shift=(0.02, 0.01))
    spot = seen_spot(pose, FRAME, (60.0, 40.0), sigma_px=1.5, amplitude_dn=6.0, blur_px=0.9)
    pair = pair_of(flat, FRAME, pose, (camera, camera), (spot,))
    y, x = np.mgrid[: FRAME[0], : FRAME[1]]
    shape = 6 * np.exp(-((x - 60.0) ** 2 + (y - 40.0) ** 2) / (2 * 1.5**2))
    assert pair.followup_dn - 80 == pytest.approx(shape, abs=2e-3)  # float32 of 80 DN
    assert pair.reference_dn == pytest.approx(80, abs=1e-3)


@pytest.mark.parametrize("name", SCENES)
def test_each_scene_has_the_contrast_that_was_asked_for(name: str) -> None:
    made = scene(name, FRAME, 3, contrast_dn=20.0)
    left, top = (round(n * SAMPLES_PER_PX) for n in made.origin_px)
    rows, cols = (n * SAMPLES_PER_PX for n in FRAME)
    inner = made.coefficients[top : top + rows, left : left + cols]
    assert inner.std() == pytest.approx(20, rel=0.02)  # the frame ends between samples
    assert inner.mean() == pytest.approx(110, abs=1)


def test_noise_bits_and_jpeg_do_what_they_say() -> None:
    flat = np.full((100, 100), 100.0)
    noisy = Development(noise_dn=2.0).of(flat, 1)
    assert noisy.std() == pytest.approx(2, rel=0.05)  # 10,000 px: 0.7 %, 7 standard errors
    deep = Development(bits=12).of(flat, 1)
    assert np.all(deep == 1600)
    shallow = Development(bits=8, gain=3.0).of(flat, 1)
    assert np.all(shallow == 255)
    photo = Development(jpeg_quality=90, gamma=0.45).of(flat, 1)
    assert photo == pytest.approx(255 * (100 / 255) ** 0.45, abs=1)
