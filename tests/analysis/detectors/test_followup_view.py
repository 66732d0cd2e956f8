import numpy as np
import pytest
from hypothesis import given, strategies as st

from analysis.detectors import followup_view, in_light_of, sees_reference

QUARTER_TURN = np.array([[0.0, -1, 4], [1, 0, 0], [0, 0, 1]])
"""A follow-up of 5 columns and 7 rows whose pixel (x, y) is the reference's (4 - y, x)."""


def test_the_same_pose_is_the_same_image() -> None:
    image = np.random.default_rng(1).normal(100, 10, (9, 12))
    seen = followup_view(image, (9, 12), np.eye(3))
    np.testing.assert_allclose(seen.levels, image, atol=1e-9)
    assert seen.inside.all()


def test_a_quarter_turn_puts_rows_into_columns() -> None:
    image = np.arange(35.0).reshape(7, 5)
    seen = followup_view(image, (5, 7), QUARTER_TURN)
    x, y = np.meshgrid(np.arange(7), np.arange(5))
    np.testing.assert_allclose(seen.levels, image[x, 4 - y], atol=1e-9)
    assert seen.inside.all()


@given(scale=st.floats(0.1, 10), sign=st.sampled_from((-1.0, 1.0)))
def test_a_homography_has_no_scale_and_no_sign(scale: float, sign: float) -> None:
    matrix = np.array([[1.1, 0.1, -2], [-0.2, 0.9, 1], [0.01, -0.005, 1]])
    plain = sees_reference((20, 30), (15, 25), matrix)
    np.testing.assert_array_equal(sees_reference((20, 30), (15, 25), sign * scale * matrix), plain)
    assert 0 < plain.mean() < 1


def test_pixels_beyond_the_horizon_see_nothing() -> None:
    # Depth is 1 - x / 10: the horizon is column 10, behind it the plane would be seen mirrored.
    matrix = np.array([[1.0, 0, 0], [0, 1, 0], [-0.1, 0, 1]])
    inside = sees_reference((1000, 1000), (4, 14), matrix)
    assert inside[0].tolist() == [True] * 10 + [False] * 4


def test_gain_and_offset_are_found_from_what_both_show_alone() -> None:
    rng = np.random.default_rng(2)
    seen = rng.normal(100, 10, (30, 40))
    inside = np.zeros((30, 40), dtype=np.bool_)
    inside[5:, :25] = True
    followup = np.where(inside, 1.4 * seen - 30, 900.0)
    found = in_light_of(followup, seen, inside)
    np.testing.assert_allclose(found, followup, rtol=1e-9)


def test_a_negative_is_not_taken_for_another_light() -> None:
    seen = np.random.default_rng(3).normal(100, 10, (30, 40))
    found = in_light_of(200 - seen, seen, np.ones((30, 40), dtype=np.bool_))
    assert np.ptp(found - seen) == pytest.approx(0, abs=1e-9)
