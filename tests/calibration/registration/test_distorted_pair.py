"""Registration with a distorting lens, beside the truth of the simulated bench."""

from functools import cache

import numpy as np
import pytest

from calibration.errors import RegistrationError
from calibration.registration import Registration, RegistrationHints, register_images
from hil_mocks import BenchTruth
from hil_mocks.truth.render import CameraPose
from simulation import GaussianPsf
from simulation.arrays import FloatArray
from tests.hil_mocks.benches import bench_config

NEAR_MM = 160.0
EXPOSURE_US = 9000.0
READ_NOISE_DN = 4.0
"""Of a mean of ten frames, about."""


@cache
def truth() -> BenchTruth:
    return BenchTruth(
        bench_config(
            optics__pixel_pitch_um=20.0,
            simulated__width_px=324,
            simulated__height_px=240,
            simulated__k1=-0.01,
            simulated__corner_sigma_gain=0.2,
            simulated__vignetting=0.15,
            simulated__shadow=0.2,
            simulated__dimming_per_100mm=0.05,
            simulated__pupil_offset_mm=10.0,
        )
    )


@cache
def photograph(target: str, zoom: float, pose: CameraPose | None = None) -> FloatArray:
    height_mm = zoom * (NEAR_MM + 10.0) - 10.0
    where = pose or CameraPose(height_mm=height_mm)
    image = truth().expected_image_dn(target, 0.0, where, exposure_us=EXPOSURE_US)
    return image + np.random.default_rng(3).normal(0, READ_NOISE_DN, image.shape)


def psf() -> GaussianPsf:
    return GaussianPsf.from_covariance(truth().total_covariance_px2(NEAR_MM))


def errors_px(found: Registration, zoom: float) -> FloatArray:
    return truth().place_errors_px(found.pose, NEAR_MM, zoom * (NEAR_MM + 10.0) - 10.0)


@cache
def registered(target: str, zoom: float) -> Registration:
    return register_images(photograph(target, 1.0), photograph(target, zoom), psf())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("target", "zoom"),
    [("grass", 1.1), ("grass", 1.6), ("grass", 2.3), ("grass", 3.0), ("lesion", 1.6)],
)
def test_with_one_percent_distortion_every_place_is_right_to_a_twentieth_of_a_pixel(
    target: str, zoom: float
) -> None:
    found = registered(target, zoom)
    assert np.median(errors_px(found, zoom)) < 0.05
    assert found.zoom == pytest.approx(zoom, rel=5e-4)
    # At zoom 3 a ninth of the further frame tells of a distortion of half a pixel.
    assert abs(found.pose.k1 + 0.01) < 5 * found.k1_err + 1e-4


@pytest.mark.slow
def test_the_standard_error_of_a_place_is_of_the_size_of_its_error() -> None:
    found = registered("grass", 1.6)
    error = float(np.sqrt(np.mean(errors_px(found, 1.6) ** 2)))
    # One draw of nine figures: within a factor of 3.
    assert found.place_err_px / 3 < error < 3 * found.place_err_px


@pytest.mark.slow
def test_a_pattern_that_repeats_is_told_apart_by_the_zoom_to_be_expected() -> None:
    zoom = 2.3
    near, far = photograph("chart", 1.0), photograph("chart", zoom)
    found = register_images(near, far, psf(), hints=RegistrationHints(zoom=zoom * 1.04))
    assert np.median(errors_px(found, zoom)) < 0.05


@pytest.mark.slow
def test_without_a_psf_it_is_as_good() -> None:
    found = register_images(photograph("grass", 1.0), photograph("grass", 1.6))
    assert np.median(errors_px(found, 1.6)) < 0.05


@pytest.mark.slow
def test_another_target_is_refused_also_where_the_zoom_is_known() -> None:
    hint = RegistrationHints(zoom=1.6)
    with pytest.raises(RegistrationError):
        register_images(photograph("grass", 1.0), photograph("lesion", 1.6), psf(), hints=hint)


@pytest.mark.slow
def test_a_nearer_followup_has_the_inverse_pose() -> None:
    pose = registered("grass", 1.6).pose
    inverse = register_images(photograph("grass", 1.6), photograph("grass", 1.0), psf()).pose
    y, x = np.mgrid[20:220:20, 20:300:20].astype(np.float64)
    back = inverse.to_reference_px(*pose.to_reference_px(y, x))
    # Both compare the same pixels, the further photograph's.
    np.testing.assert_allclose(back, (y, x), atol=1e-6)


@pytest.mark.slow
def test_a_part_of_a_frame_has_no_distortion_of_its_own() -> None:
    found = register_images(photograph("grass", 1.0), photograph("grass", 1.6)[20:, 30:], psf())
    assert found.pose.k1 == 0.0
    assert found.k1_err == 0.0


@pytest.mark.slow
def test_a_shifted_camera_is_found_in_spite_of_a_wrong_expectation() -> None:
    moved = CameraPose(height_mm=1.3 * (NEAR_MM + 10.0) - 10.0, offset_x_mm=40.0)
    found = register_images(
        photograph("grass", 1.0),
        photograph("grass", 1.3, moved),
        psf(),
        hints=RegistrationHints(zoom=1.3),
    )
    # The zoom behind an ideal lens; a barrel makes the one at a place off the axis smaller.
    ideal_zoom = np.sqrt(np.linalg.det(found.pose.matrix[:2, :2]))
    assert ideal_zoom == pytest.approx(1.3, rel=1e-3)
