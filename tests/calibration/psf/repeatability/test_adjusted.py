import pytest

from calibration.psf.repeatability import capture_of, without_blur
from tests.calibration.psf.consistency.measured_edges import edge


def test_what_is_taken_off_leaves_the_error_of_the_variance() -> None:
    one = edge(sigma_px=0.8)
    less = without_blur(one, 0.28)
    assert less.sigma_px == pytest.approx(0.6)
    assert less.sigma_px * less.sigma_err_px == pytest.approx(one.sigma_px * one.sigma_err_px)


def test_an_edge_as_soft_as_its_target_has_no_optical_width() -> None:
    less = without_blur(edge(sigma_px=0.8), 0.7)
    assert less.optical_sigma_px is None
    assert less.sigma_px == pytest.approx(0.08)  # a hundredth of the variance is left


def test_the_image_tells_a_capture_that_has_no_number() -> None:
    assert capture_of(edge(capture=3)) == 3
    assert capture_of(edge(capture=None, image="b.tif")) == "b.tif"
