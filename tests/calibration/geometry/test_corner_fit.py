"""Corners of a chessboard whose photograph has a closed form: a product of two blurred steps."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.special import ndtr

from calibration.geometry.board import FittedCorners, fit_corners
from simulation.arrays import FloatArray

SHAPE = (60, 80)
SIDE_PX = 24.0
CLEAR = 0.125
UPRIGHT = np.diag([SIDE_PX, SIDE_PX])


def step(distance_px: FloatArray, sigma_px: float) -> FloatArray:
    """From -1 to 1, averaged over a pixel: the integral of ndtr is z ndtr(z) + pdf(z)."""

    def integral(z: FloatArray) -> FloatArray:
        return np.asarray(z * ndtr(z) + np.exp(-0.5 * z**2) / np.sqrt(2 * np.pi))

    upper, lower = (distance_px + 0.5) / sigma_px, (distance_px - 0.5) / sigma_px
    return 2 * sigma_px * (integral(upper) - integral(lower)) - 1


def corner(
    x_px: float, y_px: float, sigma_px: float = 0.6, contrast_dn: float = 400.0
) -> FloatArray:
    """Black above left and below right of an upright corner, white elsewhere."""
    y, x = np.arange(SHAPE[0], dtype=np.float64), np.arange(SHAPE[1], dtype=np.float64)
    product = np.outer(step(y - y_px, sigma_px), step(x - x_px, sigma_px))
    return 1000.0 - contrast_dn * product


def fitted(image: FloatArray, *points: tuple[float, float]) -> FittedCorners:
    at = np.array(points)
    return fit_corners(image, at, np.tile(UPRIGHT, (len(at), 1, 1)), CLEAR)


@settings(max_examples=25)
@given(
    x=st.floats(-0.5, 0.5),
    y=st.floats(-0.5, 0.5),
    sigma=st.floats(0.45, 1.2),
    contrast=st.floats(-900.0, 900.0).filter(lambda value: abs(value) > 50),
)
def test_a_corner_is_found_to_a_hundredth_of_a_pixel_whichever_squares_are_black(
    x: float, y: float, sigma: float, contrast: float
) -> None:
    found = fitted(corner(40.0 + x, 30.0 + y, sigma, contrast), (40.0, 30.0))
    assert found.is_good.tolist() == [True]
    # Two nodes a pixel and axis do not integrate a step of 0.45 px exactly.
    np.testing.assert_allclose(found.points_px, [[40.0 + x, 30.0 + y]], atol=0.01)


def test_the_standard_error_is_that_of_the_scatter() -> None:
    rng = np.random.default_rng(5)
    clean = corner(40.2, 29.7)
    errors, stated = [], []
    for _ in range(30):
        found = fitted(clean + rng.normal(0, 15.0, SHAPE), (40.0, 30.0))
        errors.append(found.points_px[0] - (40.2, 29.7))
        stated.append(found.err_px[0])
    # 60 coordinates: their rms scatters by 9 %.
    assert np.sqrt(np.mean(np.square(errors))) == pytest.approx(np.mean(stated), rel=0.3)


@pytest.mark.parametrize(("x_px", "y_px"), [(5.0, 30.0), (75.0, 30.0), (40.0, 5.0), (40.0, 55.0)])
def test_a_corner_whose_cross_leaves_the_frame_is_not_good(x_px: float, y_px: float) -> None:
    found = fitted(corner(x_px, y_px), (x_px, y_px))
    assert found.is_good.tolist() == [False]
    assert found.err_px.tolist() == [np.inf]


def test_squares_too_small_for_a_fit_are_not_good() -> None:
    at = np.array([[40.0, 30.0]])
    assert not fit_corners(corner(40.0, 30.0), at, UPRIGHT[None] * 0.25, CLEAR).is_good.any()


def test_where_there_is_no_corner_none_is_good() -> None:
    rng = np.random.default_rng(1)
    y, x = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float64)
    flat, ramp = np.full(SHAPE, 1000.0), 1000.0 + 3.0 * x - 2.0 * y
    for image in (flat, ramp, rng.normal(1000.0, 100.0, SHAPE)):
        found = fitted(image, (40.0, 30.0))
        assert not found.is_good.any()
        np.testing.assert_array_equal(found.points_px, [[40.0, 30.0]])


def test_a_corner_far_from_where_it_was_looked_for_is_another_one() -> None:
    image = corner(42.0, 30.0)
    found = fitted(image, (40.0, 30.0), (41.0, 30.0))
    # Right to a pixel is what the detector promises.
    assert found.is_good.tolist() == [False, True]
    np.testing.assert_allclose(found.points_px[1], [42.0, 30.0], atol=0.01)
