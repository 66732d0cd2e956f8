"""The blur of the target: a pinhole's scale and a sum of variances are the closed form."""

from math import sqrt

import numpy as np
import pytest

from calibration.psf import fit_covariance, measure_softness
from calibration.psf._calibration import _psf_of_edges
from calibration.psf._softness import _capture_scales, side_px
from tests.calibration.known import known
from tests.calibration.psf.measured_edges import FOCAL_PX, PUPIL_MM, SIDE_MM, edge, series, square


def test_the_side_of_a_square_is_the_distance_of_its_edges() -> None:
    sides = square(0.5, 180.0, 0, np.random.default_rng(1))
    assert side_px(sides) == pytest.approx(SIDE_MM * FOCAL_PX / (180.0 + PUPIL_MM), rel=1e-9)


def test_edges_that_do_not_face_each_other_are_no_sides() -> None:
    assert side_px([edge(), edge(place_px=(140.0, 300.0))]) is None
    assert side_px([edge(), edge(angle_deg=30.0, place_px=(145.0, 100.0))]) is None


def test_without_squares_the_heights_tell_the_scales() -> None:
    captures = [edge(capture=k, height_mm=h) for k, h in enumerate((100.0, 200.0, 300.0))]
    scales = known(_capture_scales(captures))
    assert scales.source == "heights"
    assert scales.relative(100.0) == pytest.approx([1.0, 200 / 300, 200 / 400])


@pytest.mark.parametrize("blur_mm", [0.05, 0.1, 0.3])
def test_the_blur_of_a_print_is_taken_off(blur_mm: float) -> None:
    edges = series(np.random.default_rng(2), blur_mm=blur_mm)
    psf = _psf_of_edges(edges)
    soft = known(psf.target_softness)
    assert soft.is_removed
    truth_px2 = (blur_mm * FOCAL_PX / (180.0 + PUPIL_MM)) ** 2
    assert abs(soft.variance_px2 - truth_px2) < 4 * soft.variance_err_px2
    for found in (psf.total.sigma_x_px, psf.total.sigma_y_px):
        assert found is not None
        assert abs(found.value - sqrt(0.5)) < 4 * found.err
        assert found.err < 0.03
    in_mm = soft.in_mm(focal_length_mm=8.0, pixel_pitch_um=8.3)
    # The height's zero is 12.5 mm from the pupil, of which sides do not tell.
    assert in_mm.sigma_mm == pytest.approx(blur_mm, rel=0.12)


def test_a_sharp_target_leaves_the_widths_as_they_are() -> None:
    edges = series(np.random.default_rng(3))
    found = known(measure_softness(edges))
    assert not found.document.is_removed
    assert found.blur_px2 == {}
    widths = np.array([(one.angle_deg, one.sigma_px, one.sigma_err_px) for one in edges]).T
    alone = fit_covariance(*widths)
    assert _psf_of_edges(edges).total.sigma_x_px == alone.sigma_x_px


def test_a_focus_that_drifts_is_not_taken_for_a_soft_target() -> None:
    rng = np.random.default_rng(4)
    edges = []
    for capture, height_mm in enumerate((180.0, 220.0, 270.0, 330.0, 400.0)):
        edges += square(0.4 + 0.001 * (height_mm - 180.0), height_mm, capture, rng)
    found = known(measure_softness(edges))
    assert found.document.variance_px2 < 0
    assert not found.document.is_removed


def test_two_heights_tell_no_softness() -> None:
    assert measure_softness(series(np.random.default_rng(5), heights_mm=(180.0, 400.0))) is None
    assert measure_softness([]) is None
