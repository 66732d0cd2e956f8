"""Poses seen without and through a lens with radial distortion."""

from math import hypot

import numpy as np
import pytest
from hypothesis import example, given, settings, strategies as st
from scipy.optimize import brentq

from calibration.registration import DistortedPose
from simulation import GaussianPsf, PoseOptions, simulate_pose_of_image
from simulation.arrays import FloatArray
from simulation.pose._view_filter import pose_noise_gain
from simulation.pose._warp import (
    ideal_factors,
    lens_of,
    project,
    projection_depth,
    projection_slopes,
    seen_factors,
    warped,
)
from simulation.pose.view import PoseView
from tests.simulation.poses import PHOTOGRAPH, PSF, TILTED_PSF, tilted

MATRIX = np.array([[1.4, 0.1, -20.0], [-0.2, 1.3, 5.0], [2e-4, -1e-4, 1.1]])
COORDINATE = st.floats(-500.0, 500.0)


@given(x=COORDINATE, y=COORDINATE)
def test_a_point_goes_where_the_matrix_takes_it(x: float, y: float) -> None:
    u, v, w = MATRIX @ [x, y, 1.0]
    assert projection_depth(MATRIX, x, y) == pytest.approx(w, rel=1e-14)
    np.testing.assert_allclose(project(MATRIX, x, y), (u / w, v / w), rtol=1e-13, atol=1e-12)


@given(x=COORDINATE, y=COORDINATE)
def test_the_slopes_are_the_derivative(x: float, y: float) -> None:
    step = 1e-3
    ahead_x, back_x = (project(MATRIX, x + s, y) for s in (step, -step))
    ahead_y, back_y = (project(MATRIX, x, y + s) for s in (step, -step))
    along_x, along_y = (
        np.subtract(ahead, back) / (2 * step)
        for ahead, back in ((ahead_x, back_x), (ahead_y, back_y))
    )
    a, b, c, d = projection_slopes(MATRIX, x, y)
    np.testing.assert_allclose([[a, b], [c, d]], np.column_stack([along_x, along_y]), atol=1e-8)


def test_arrays_of_any_shape_are_taken_point_by_point() -> None:
    y, x = np.mgrid[:3, :4].astype(np.float64)
    to_x, to_y = project(MATRIX, x, y)
    assert to_x.shape == to_y.shape == (3, 4)
    assert (to_x[2, 1], to_y[2, 1]) == project(MATRIX, 1.0, 2.0)


ROWS, COLS = 90, 120
MIDDLE_X, MIDDLE_Y = (COLS - 1) / 2, (ROWS - 1) / 2
CORNER_PX = hypot(MIDDLE_X, MIDDLE_Y)
POSE = tilted(150.0, (COLS, ROWS), 7.0, 1.4)


def seen_place(matrix: FloatArray, k1: float, x: float, y: float) -> tuple[float, float]:
    """Where a follow-up place lies in the reference: the definition, its inverse by bisection."""
    dx, dy = x - MIDDLE_X, y - MIDDLE_Y
    seen = hypot(dx, dy) / CORNER_PX
    ideal = brentq(lambda r: r * (1 + k1 * r * r) - seen, 0.0, 1.5, xtol=1e-14)
    scale = ideal / seen if seen else 1.0
    u, v, w = matrix @ [MIDDLE_X + scale * dx, MIDDLE_Y + scale * dy, 1.0]
    dx, dy = u / w - MIDDLE_X, v / w - MIDDLE_Y
    factor = 1 + k1 * (hypot(dx, dy) / CORNER_PX) ** 2
    return MIDDLE_X + factor * dx, MIDDLE_Y + factor * dy


def view(k1: float, psf: GaussianPsf = PSF) -> PoseView:
    return PoseView.of(POSE, (ROWS, COLS), (COLS, ROWS), psf, None, k1)


@given(
    k1=st.floats(-0.12, 0.12),
    x=st.floats(0.0, COLS - 1.0),
    y=st.floats(0.0, ROWS - 1.0),
)
# Ideally a hundredth of a corner beyond the fold: outside the frame, but no jump away from it.
@example(k1=-0.109375, x=119.0, y=0.0)
def test_a_place_is_where_the_definition_puts_it(k1: float, x: float, y: float) -> None:
    found = view(k1).survey(np.array([y]), np.array([x]))[0, 0, :2]
    defined = seen_place(POSE, k1, x, y)
    np.testing.assert_allclose(found, defined, rtol=0, atol=1e-9)
    lens = lens_of(k1, (ROWS, COLS), (ROWS, COLS))
    found = warped(POSE, lens, np.array([[x, y]]))[0]
    np.testing.assert_allclose(found, defined, rtol=0, atol=1e-9)


@given(
    k1=st.floats(-0.12, 0.12),
    x=st.floats(1.0, COLS - 2.0),
    y=st.floats(1.0, ROWS - 2.0),
)
def test_the_missing_blur_is_that_of_the_derivative(k1: float, x: float, y: float) -> None:
    # A by central differences of the definition; what is missing is A Sigma A^T - Sigma.
    step = 1e-4
    ahead_x, back_x = (seen_place(POSE, k1, x + s, y) for s in (step, -step))
    ahead_y, back_y = (seen_place(POSE, k1, x, y + s) for s in (step, -step))
    a = np.column_stack([np.subtract(ahead_x, back_x), np.subtract(ahead_y, back_y)]) / (2 * step)
    sigma = np.asarray(TILTED_PSF.covariance_px2)
    missing = a @ sigma @ a.T - sigma
    found = view(k1, TILTED_PSF).survey(np.array([y]), np.array([x]))[0, 0, 2:]
    np.testing.assert_allclose(
        found, [missing[0, 0], missing[0, 1], missing[1, 1]], rtol=0, atol=1e-7
    )


def shown_radius(k1: float, k2: float) -> float:
    """Ideal radius up to which the lens shows anything: the first zero of 1 + 3 k1 q + 5 k2 q^2."""
    squares = np.roots([5 * k2, 3 * k1, 1.0])
    real = squares[np.isreal(squares)].real
    return float(np.sqrt(np.min(real[real > 0], initial=np.inf)))


# Rounded, so that the zeros of the derivative are no overflow to the test itself.
K1, K2 = (st.floats(-most, most).map(lambda value: round(value, 9)) for most in (0.3, 0.1))


@given(k1=K1, k2=K2, share=st.floats(0.0, 1.0))
@example(k1=-4 / 27, k2=0.0, share=1.0)
def test_up_to_the_fold_the_ideal_radius_is_the_one_that_is_seen(
    k1: float, k2: float, share: float
) -> None:
    ideal = share * min(shown_radius(k1, k2), 4.0)
    seen = ideal * (1 + k1 * ideal**2 + k2 * ideal**4)
    found = seen * ideal_factors(k1, k2, np.array([seen**2]))[0]
    assert found <= shown_radius(k1, k2) * (1 + 1e-12)
    # At the fold all radii near it are seen at the same one: the seen radius is what is known.
    assert found * (1 + k1 * found**2 + k2 * found**4) == pytest.approx(seen, rel=1e-12, abs=1e-12)


@given(k1=st.floats(-0.4, -1e-3), share=st.floats(0.0, 0.999))
def test_the_ideal_radius_of_a_barrel_is_the_closed_form(k1: float, share: float) -> None:
    # r (1 - k r^2) = s with r = 2 sin(a) / sqrt(3 k) is sin(3 a) = s sqrt(27 k) / 2.
    seen = share * 2 / np.sqrt(-27 * k1)
    expected = 2 * np.sin(np.arcsin(share) / 3) / np.sqrt(-3 * k1)
    found = seen * ideal_factors(k1, 0.0, np.array([seen**2]))[0]
    # At 0.999 the seen radius grows by 0.03 for 1: rounding is 30 times as large.
    assert found == pytest.approx(expected, rel=1e-13, abs=1e-15)


@given(k1=K1, k2=K2, ideal=st.floats(1e-3, 100.0))
def test_beyond_the_fold_no_point_comes_back_into_the_frame(
    k1: float, k2: float, ideal: float
) -> None:
    frame = 1.0
    seen = ideal * seen_factors(k1, k2, np.array([ideal**2]), frame)[0]
    if ideal < shown_radius(k1, k2) * (1 - 1e-9):
        assert seen == pytest.approx(ideal * (1 + k1 * ideal**2 + k2 * ideal**4), rel=1e-12)
    elif ideal > shown_radius(k1, k2) * (1 + 1e-9):
        assert seen >= frame


def test_a_seen_radius_that_the_lens_cannot_show_is_taken_to_the_fold() -> None:
    k1 = -0.12
    fold = 1 / np.sqrt(-3 * k1)
    seen = np.array([1.2, 2.0, 50.0])
    np.testing.assert_allclose(seen * ideal_factors(k1, 0.0, seen**2), fold, rtol=1e-12)


def test_a_ramp_keeps_its_level_at_every_place() -> None:
    # A blur leaves a ramp as it is, so that the level is the place.
    x = np.broadcast_to(np.arange(COLS, dtype=np.float64), (ROWS, COLS)).copy()
    followup = simulate_pose_of_image(x, POSE, (COLS, ROWS), PSF, PoseOptions(distortion_k1=-0.05))
    for row, col in ((20, 30), (45, 60), (70, 85)):
        place = seen_place(POSE, -0.05, col, row)[0]
        assert 10 < place < COLS - 10  # the border's mirror image is out of reach
        assert followup.image[row, col] == pytest.approx(place, abs=1e-3)


def test_without_distortion_every_bit_is_as_before() -> None:
    size = PHOTOGRAPH.shape[::-1]
    matrix = tilted(300.0, size, 5.0, 1.3)
    plain = simulate_pose_of_image(PHOTOGRAPH, matrix, size, PSF)
    told = simulate_pose_of_image(PHOTOGRAPH, matrix, size, PSF, PoseOptions(distortion_k1=0.0))
    np.testing.assert_array_equal(told.image, plain.image)


@given(k1=st.floats(-0.12, 0.12))
@settings(max_examples=15, deadline=None)
def test_the_same_pose_of_a_distorting_lens_is_the_same_image(k1: float) -> None:
    # What one lens bends it bends alike: nothing moves where the camera did not.
    same = simulate_pose_of_image(
        PHOTOGRAPH,
        np.eye(3),
        PHOTOGRAPH.shape[::-1],
        PSF,
        PoseOptions(model="matched", distortion_k1=k1),
    )
    assert not same.outside.any()
    np.testing.assert_allclose(same.image, PHOTOGRAPH, rtol=0, atol=0.02)


def test_a_part_of_the_frame_is_that_part_of_the_whole() -> None:
    size = PHOTOGRAPH.shape[::-1]
    matrix = tilted(300.0, size, 5.0, 1.3)
    whole = simulate_pose_of_image(PHOTOGRAPH, matrix, size, PSF, PoseOptions(distortion_k1=0.04))
    x, y = 70, 40
    shift = np.array([[1.0, 0.0, x], [0.0, 1.0, y], [0.0, 0.0, 1.0]])
    # The homography of ideal places counts from the part's own first pixel.
    part = simulate_pose_of_image(
        PHOTOGRAPH,
        matrix @ shift,
        (100, 60),
        PSF,
        PoseOptions(origin_px=(x, y), distortion_k1=0.04),
    )
    # The part has a lattice and terms of its own: each within 7e-4 of the image's deviation of 60.
    difference = part.image - whole.image[y : y + 60, x : x + 100]
    assert float(np.sqrt(np.mean(difference**2))) < 0.04
    assert float(np.abs(difference).max()) < 0.25


def test_tiles_join_without_a_seam() -> None:
    # More than one tile, bent by a lot: each looks at all of the reference that it needs.
    rows, cols = 620, 700
    x = np.broadcast_to(np.arange(cols, dtype=np.float64), (rows, cols)).copy()
    size = (cols, rows)
    matrix = tilted(900.0, size, 4.0, 1.1)
    for k1 in (-0.1, 0.1):
        bent = simulate_pose_of_image(x, matrix, size, PSF, PoseOptions(distortion_k1=k1))
        seen = ~bent.outside & (bent.image > 12) & (bent.image < cols - 13)
        second = np.abs(np.diff(bent.image, 2, axis=1))
        assert second[seen[:, 2:] & seen[:, :-2]].max() < 0.02


@pytest.mark.slow
def test_noise_is_passed_on_where_the_lens_puts_it() -> None:
    # The mean of squared weights, over noise that is drawn.
    rng = np.random.default_rng(5)
    gain = pose_noise_gain(POSE, (ROWS, COLS), (COLS, ROWS), PSF, PoseOptions(distortion_k1=0.1))
    found = np.mean(
        [
            simulate_pose_of_image(
                rng.standard_normal((ROWS, COLS)),
                POSE,
                (COLS, ROWS),
                PSF,
                PoseOptions(distortion_k1=0.1),
            ).image
            ** 2
            for _ in range(200)
        ],
        axis=0,
    )
    inside = np.s_[25:65, 30:90]
    # 200 draws: each pixel's mean square is known to 10 %, that of 2400 pixels to 1 %.
    assert float(np.mean(found[inside] / gain[inside])) == pytest.approx(1.0, abs=0.02)


def test_what_lies_beyond_the_fold_of_a_barrel_is_not_seen() -> None:
    # Ideally 1 / sqrt(3 k) = 1.83 corners out: from zoom 3 the follow-up's corners look further,
    # and r (1 - k r^2) would bring them back into the frame from 2.89 on.
    k1, zoom = -0.1, 3.0
    matrix = np.array(
        [[zoom, 0, MIDDLE_X * (1 - zoom)], [0, zoom, MIDDLE_Y * (1 - zoom)], [0, 0, 1]]
    )
    image = np.full((ROWS, COLS), 100.0)
    seen = simulate_pose_of_image(image, matrix, (COLS, ROWS), PSF, PoseOptions(distortion_k1=k1))
    y, x = np.mgrid[:ROWS, :COLS]
    radius = np.hypot(x - MIDDLE_X, y - MIDDLE_Y) / CORNER_PX
    # Follow-up places at 0.9 corners are ideally beyond 0.9, and 2.7 in the reference.
    assert seen.outside[radius > 0.9].all()
    assert not seen.outside[radius < 0.2].any()
    np.testing.assert_allclose(seen.image[~seen.outside], 100.0, rtol=1e-6)
    # Calibration says the same of where they lie.
    pose = DistortedPose(
        matrix=matrix, k1=k1, reference_shape=(ROWS, COLS), followup_shape=(ROWS, COLS)
    )
    place_y, place_x = pose.followup_places_px()
    inside = (np.abs(place_y - MIDDLE_Y) <= ROWS / 2) & (np.abs(place_x - MIDDLE_X) <= COLS / 2)
    np.testing.assert_array_equal(inside, ~seen.outside)


def test_a_follow_up_larger_than_the_lens_shows_is_refused() -> None:
    image = PHOTOGRAPH[:90, :120]
    simulate_pose_of_image(image, np.eye(3), (300, 200), PSF, PoseOptions(distortion_k1=0.1))
    with pytest.raises(ValueError):
        simulate_pose_of_image(image, np.eye(3), (300, 200), PSF, PoseOptions(distortion_k1=-0.1))


@pytest.mark.parametrize("k1", [0.13, -0.15, -0.19, -0.3, float("nan"), float("inf")])
def test_a_distortion_of_no_lens_is_refused(k1: float) -> None:
    with pytest.raises(ValueError):
        simulate_pose_of_image(
            PHOTOGRAPH, np.eye(3), (100, 100), PSF, PoseOptions(distortion_k1=k1)
        )
