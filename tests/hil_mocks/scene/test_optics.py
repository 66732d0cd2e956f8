import numpy as np
import pytest

from hil_mocks.truth.render import Lens


def lens(focus_distance_mm: float | None = None, gain: float = 0.0) -> Lens:
    return Lens(
        sigma_x_px=0.6,
        sigma_y_px=0.5,
        rho=0.2,
        corner_sigma_gain=gain,
        focal_length_mm=8.0,
        f_number=4.0,
        pixel_pitch_um=8.3,
        focus_distance_mm=focus_distance_mm,
    )


def test_the_covariance_is_that_of_the_widths_and_their_correlation() -> None:
    np.testing.assert_allclose(lens().covariance_px2(200.0), [[0.36, 0.06], [0.06, 0.25]])


def test_sigma_grows_by_the_gain_at_the_corner() -> None:
    np.testing.assert_allclose(
        lens(gain=0.3).covariance_px2(200.0, 1.0), 1.69 * lens().covariance_px2(200.0)
    )


def test_a_lens_that_refocuses_has_no_blur_disc() -> None:
    assert lens().blur_disc_px(123.0) == 0


def test_the_blur_disc_is_that_of_the_thin_lens() -> None:
    # By hand: image distances 8 * 300 / 292 and 8 * 200 / 192, aperture 2 mm.
    sensor_mm, image_mm = 8 * 300 / 292, 8 * 200 / 192
    by_similar_triangles_mm = 2.0 * abs(image_mm - sensor_mm) / image_mm
    assert lens(300.0).blur_disc_px(200.0) == pytest.approx(by_similar_triangles_mm / 8.3e-3)
    assert lens(300.0).blur_disc_px(300.0) == 0


def test_the_variance_of_the_blur_disc_is_a_sixteenth_of_its_diameter_squared() -> None:
    # Mean of x^2 over a disc of radius R is R^2 / 4.
    disc_px = lens(300.0).blur_disc_px(200.0)
    assert lens(300.0).defocus_variance_px2(200.0) == pytest.approx((disc_px / 2) ** 2 / 4)


def test_a_lens_cannot_be_focused_within_its_focal_length() -> None:
    with pytest.raises(ValueError):
        lens(7.0)
