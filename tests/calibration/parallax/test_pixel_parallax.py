"""Poses with the parallax of every pixel: there and back, mirrored, exchanged."""

from dataclasses import replace
from typing import Literal

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from calibration.registration import DistortedPose, PixelParallax
from calibration.registration._distorted_pose import SmoothDisplacement
from simulation.arrays import BoolArray, FloatArray
from tests.calibration.known import known

Role = Literal["reference", "followup"]
ROLES: tuple[Role, ...] = ("reference", "followup")

FRAME = (50, 70)
ROWS, COLS = np.indices(FRAME).astype(np.float64)
Y, X = (at.astype(np.float64) for at in np.mgrid[15.25:34:3, 20.5:48:4])
"""Between pixels, and far enough inside for every displacement here."""

MATRIX = np.array([[1.03, 0.02, 1.5], [-0.02, 1.03, -0.7], [1e-4, -5e-5, 1.0]])


def linear(slope: FloatArray, offset: tuple[float, float], role: Role) -> PixelParallax:
    """Places ``(y, x)`` are taken to ``(1 + slope) @ place + offset``; the way back is linear, too.

    Linear maps are exact between pixels, but for single precision: 4e-6 px of 50.
    """
    places = np.stack([ROWS, COLS])
    there = np.eye(2) + slope
    displaced = np.tensordot(slope, places, axes=1) + np.reshape(offset, (2, 1, 1))
    back = np.linalg.inv(there)
    restored = np.tensordot(back, places - np.reshape(offset, (2, 1, 1)), axes=1) - places
    left, right = COLS < 30, ROWS < 25
    return PixelParallax(
        displaced_px=displaced.astype(np.float32),
        restored_px=restored.astype(np.float32),
        is_seen=np.asarray(left),
        is_seen_back=np.asarray(right),
        error_px=np.zeros(left.shape, dtype=np.float32),
        photograph=role,
    )


SLOPE = np.array([[0.02, -0.01], [0.03, 0.05]])
OFFSET = (0.8, -2.5)


def pose(
    role: Role,
    *,
    k1: float = 0.0,
    bend: SmoothDisplacement | None = None,
    matrix: FloatArray = MATRIX,
) -> DistortedPose:
    return DistortedPose(
        matrix=matrix,
        k1=k1,
        reference_shape=FRAME,
        followup_shape=FRAME,
        displacement=bend,
        parallax=linear(SLOPE, OFFSET, role),
    )


def bend_of(role: Role) -> SmoothDisplacement:
    knots = np.random.default_rng(2).uniform(-0.5, 0.5, (2, 6, 7))
    return SmoothDisplacement(knots_px=knots, shape=FRAME, photograph=role)


@settings(max_examples=20)
@given(
    slopes=st.lists(st.floats(-0.05, 0.05), min_size=4, max_size=4),
    offset=st.tuples(st.floats(-4, 4), st.floats(-4, 4)),
)
def test_displaced_and_restored_is_the_same_place(
    slopes: list[float], offset: tuple[float, float]
) -> None:
    depth = linear(np.reshape(slopes, (2, 2)), offset, "followup")
    # Single precision of displacements of up to 8 px, 1e-6, twice.
    np.testing.assert_allclose(depth.restored(*depth.displaced(Y, X)), (Y, X), atol=1e-5)
    np.testing.assert_allclose(depth.displaced(*depth.restored(Y, X)), (Y, X), atol=1e-5)


def test_between_pixels_it_is_linear_and_beyond_the_frame_as_at_its_border() -> None:
    depth = linear(SLOPE, OFFSET, "followup")
    y, x = depth.displaced(Y, X)
    np.testing.assert_allclose(y, Y + 0.02 * Y - 0.01 * X + 0.8, atol=1e-5)
    np.testing.assert_allclose(x, X + 0.03 * Y + 0.05 * X - 2.5, atol=1e-5)
    at_y, at_x = np.array([-9.0, 20.0]), np.array([10.0, 90.0])
    y, x = depth.displaced(at_y, at_x)
    np.testing.assert_allclose(y - at_y, [-0.01 * 10 + 0.8, 0.4 - 0.69 + 0.8], atol=1e-5)
    np.testing.assert_allclose(x - at_x, [0.05 * 10 - 2.5, 0.6 + 3.45 - 2.5], atol=1e-5)


def test_a_followup_pixel_is_displaced_and_then_taken_by_the_plane() -> None:
    y, x = linear(SLOPE, OFFSET, "followup").displaced(Y, X)
    u, v, w = np.tensordot(MATRIX, np.stack([x, y, np.ones_like(x)]), axes=1)
    np.testing.assert_allclose(pose("followup").to_reference_px(Y, X), (v / w, u / w), atol=1e-9)


def test_a_reference_pixel_is_where_the_plane_has_what_is_displaced() -> None:
    made = pose("reference")
    y, x = made.to_reference_px(Y, X)
    there = (np.eye(2) + SLOPE) @ np.stack([y.ravel(), x.ravel()]) + np.reshape(OFFSET, (2, 1))
    expected = made.plane.to_reference_px(Y, X)
    np.testing.assert_allclose(there, [one.ravel() for one in expected], atol=1e-5)


@pytest.mark.parametrize("role", ROLES)
@pytest.mark.parametrize("k1", [0.0, -0.02])
@pytest.mark.parametrize("bent", [None, *ROLES])
def test_there_and_back_is_the_same_place(role: Role, k1: float, bent: Role | None) -> None:
    made = pose(role, k1=k1, bend=None if bent is None else bend_of(bent))
    # As exact as the parallax and, where there is one, the inverse of a bend.
    there = made.to_reference_px(Y, X)
    np.testing.assert_allclose(made.to_followup_px(*there), (Y, X), atol=1e-4)
    np.testing.assert_allclose(made.to_reference_px(*made.to_followup_px(Y, X)), (Y, X), atol=1e-4)
    again = made.inverse().inverse()
    np.testing.assert_allclose(again.to_reference_px(Y, X), there, atol=1e-9)
    assert again.parallax == made.parallax


@pytest.mark.parametrize("role", ROLES)
@pytest.mark.parametrize("bent", [None, *ROLES])
def test_a_mirrored_pose_takes_mirrored_pixels_where_the_others_went(
    role: Role, bent: Role | None
) -> None:
    made = pose(role, k1=-0.02, bend=None if bent is None else bend_of(bent))
    there = made.mirrored().to_reference_px(Y, FRAME[1] - 1 - X)
    np.testing.assert_allclose(there, made.to_reference_px(Y, X), atol=1e-5)
    again = made.mirrored().mirrored()
    np.testing.assert_allclose(again.to_reference_px(Y, X), made.to_reference_px(Y, X), atol=1e-9)
    assert again.parallax == made.parallax


@pytest.mark.parametrize("role", ROLES)
def test_a_mirrored_pose_sees_mirrored_pixels(role: Role) -> None:
    made = pose(role)
    seen, mirrored = known(made.followup_seen()), known(made.mirrored().followup_seen())
    # Places half-way between two pixels may be rounded to either.
    assert np.mean(mirrored[:, ::-1] == seen) > 0.995


def shifted(depth: PixelParallax, by_y: int, by_x: int) -> DistortedPose:
    matrix = np.array([[1.0, 0, by_x], [0, 1, by_y], [0, 0, 1.0]])
    return replace(pose(depth.photograph, matrix=matrix), parallax=depth)


@pytest.mark.parametrize(("by_y", "by_x"), [(0, 0), (3, -5), (-4, 60)])
def test_pixels_of_the_other_photograph_are_seen_where_the_plane_has_them(
    by_y: int, by_x: int
) -> None:
    rng = np.random.default_rng(1)
    is_seen_back = rng.random(FRAME) < 0.6
    depth = replace(linear(SLOPE, OFFSET, "reference"), is_seen_back=is_seen_back)
    expected: BoolArray = np.zeros(FRAME, dtype=np.bool_)
    for row in range(FRAME[0]):
        for col in range(FRAME[1]):
            y, x = row + by_y, col + by_x
            if 0 <= y < FRAME[0] and 0 <= x < FRAME[1]:
                expected[row, col] = is_seen_back[y, x]
    made = shifted(depth, by_y, by_x)
    np.testing.assert_array_equal(known(made.followup_seen()), expected)
    # With the roles exchanged, it is the photograph itself that says so.
    np.testing.assert_array_equal(known(made.inverse().followup_seen()), depth.is_seen)


def test_a_pose_without_parallax_hides_nothing() -> None:
    assert pose("followup").plane.followup_seen() is None
    assert pose("followup").plane.parallax is None
