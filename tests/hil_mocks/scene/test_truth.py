import numpy as np
import pytest

from hil_mocks import BenchTruth, CameraPose
from tests.hil_mocks.benches import bench_config


def truth(**keys: object) -> BenchTruth:
    return BenchTruth(bench_config(**keys))


def test_the_total_psf_is_the_optical_one_and_a_twelfth() -> None:
    bench = truth(simulated__optical_sigma_x_px=0.6, simulated__optical_rho=0.5)
    optical = bench.optical_covariance_px2(200.0)
    np.testing.assert_allclose(optical, [[0.36, 0.165], [0.165, 0.3025]])
    np.testing.assert_allclose(bench.total_covariance_px2(200.0) - optical, np.eye(2) / 12)


def test_the_psf_at_a_pixel_is_that_of_its_radius() -> None:
    bench = truth(simulated__corner_sigma_gain=0.2)
    np.testing.assert_allclose(
        bench.optical_covariance_px2(200.0, 0.0, 63.0), 1.44 * bench.optical_covariance_px2(200.0)
    )


def test_defocus_makes_the_psf_depend_on_the_height() -> None:
    bench = truth(simulated__focus_distance_mm=200.0)
    sharp, soft = (bench.optical_covariance_px2(height_mm)[0, 0] for height_mm in (200.0, 300.0))
    assert sharp == pytest.approx(0.55**2)
    assert soft > sharp


def test_the_zoom_is_the_ratio_of_pupil_distances() -> None:
    assert truth(simulated__pupil_offset_mm=50.0).zoom(100.0, 250.0) == pytest.approx(2.0)


def test_the_homography_between_heights_is_a_zoom_about_the_principal_point() -> None:
    expected = np.array([[2, 0, -47.5], [0, 2, -31.5], [0, 0, 1.0]])  # c = 2 c - c
    np.testing.assert_allclose(truth().homography_far_to_near(100.0, 200.0), expected, atol=1e-12)


def test_a_homography_takes_a_far_pixel_to_the_near_pixel_of_the_same_point() -> None:
    bench = truth()
    near = CameraPose(height_mm=150.0, offset_x_mm=1.0, roll_deg=4.0)
    far = CameraPose(height_mm=260.0, tilt_x_deg=12.0, tilt_y_deg=-5.0)
    place_mm = (np.array([3.0]), np.array([-2.0]))
    far_px = np.array([*np.concatenate(bench.camera.to_pixel(*place_mm, far)), 1.0])
    x, y, w = bench.homography_far_to_near(near, far) @ far_px
    near_px = np.concatenate(bench.camera.to_pixel(*place_mm, near))
    np.testing.assert_allclose((x / w, y / w), near_px)


def test_gain_and_black_level_are_those_of_the_bench() -> None:
    bench = truth()
    assert bench.gain_e_per_dn() == 5.0
    assert bench.gain_e_per_dn(20.0) == pytest.approx(0.5)
    assert bench.read_noise_e == 12.0
    assert bench.black_level_dn == 64.0


def test_the_expected_level_of_white_paper_is_that_of_the_sensor_by_hand() -> None:
    # 1.5 e-/us x 8000 us / 5 e-/DN + 64 DN; 6 dB are a factor of 1.9953.
    level_dn = truth().expected_image_dn("flat", 0.0, 200.0, exposure_us=8000.0)
    np.testing.assert_allclose(level_dn, 2464.0, rtol=1e-5)
    level_dn = truth().expected_image_dn("flat", 0.0, 200.0, exposure_us=4000.0, gain_db=6.0)
    np.testing.assert_allclose(level_dn, 2458.3, rtol=1e-4)


def test_the_shadow_takes_its_share_of_the_light_from_its_side_of_the_plane() -> None:
    lit = truth().irradiance("flat", 0.0, CameraPose(height_mm=200.0))
    shaded = truth(simulated__shadow=0.4).irradiance("flat", 0.0, CameraPose(height_mm=200.0))
    share = shaded / lit
    # Half of it where its border crosses the origin, more towards +x and +y.
    assert share[31:33, 47:49].mean() == pytest.approx(0.8, abs=1e-3)
    assert share[63, 95] < share[31, 47] < share[0, 0]


def test_the_stand_dims_the_light_with_the_height() -> None:
    bench = truth(simulated__dimming_per_100mm=0.1)
    low, high = (
        float(bench.irradiance("flat", 0.0, CameraPose(height_mm=height_mm)).mean())
        for height_mm in (100.0, 300.0)
    )
    assert low == pytest.approx(0.9)
    assert high / low == pytest.approx(0.81)
