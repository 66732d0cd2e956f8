"""Widths of edges that share their capture's focus, drawn from the model itself."""

import numpy as np
import pytest

from calibration.psf import fit_covariance
from calibration.psf._covariance import CovarianceFit
from calibration.psf._repeatability import (
    EdgeSquares,
    FocusScatter,
    SharedByCapture,
    _CaptureModel,
    capture_of,
    without_blur,
)
from simulation.arrays import FloatArray, IntArray
from tests.calibration.psf.measured_edges import edge


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


XX, XY, YY = 0.5, 0.05, 0.42
ERR_PX = 0.004


def squares_of(
    captures: int, scatter_px2: float, rng: np.random.Generator
) -> tuple[FloatArray, FloatArray, IntArray]:
    """Angles, widths and captures of eight edges in each: of two squares turned at random."""
    turn = rng.uniform(0.0, 90.0, (captures, 2, 1))
    angles = (turn + np.array([0.0, 0.0, 90.0, 90.0])).ravel()
    group = np.repeat(np.arange(captures), 8)
    normal = np.deg2rad(angles + 90.0)
    nx, ny = np.cos(normal), np.sin(normal)
    squares = XX * nx**2 + 2 * XY * nx * ny + YY * ny**2
    squares = np.maximum(squares + rng.normal(0.0, scatter_px2, captures)[group], 0.02)
    return angles, np.sqrt(squares) + rng.normal(0.0, ERR_PX, group.size), group.astype(np.int64)


def of_captures(angles: FloatArray, group: IntArray) -> SharedByCapture:
    return SharedByCapture(
        group=group,
        normal_rad=np.deg2rad(angles + 90.0),
        columns=np.empty((group.size, 0)),
        precision=np.empty(0),
    )


def fitted(angles: FloatArray, sigma: FloatArray, group: IntArray) -> CovarianceFit:
    return fit_covariance(angles, sigma, np.full(sigma.size, ERR_PX), of_captures(angles, group))


def test_one_capture_leaves_everything_as_it_is() -> None:
    angles, sigma, group = squares_of(1, 0.0, np.random.default_rng(1))
    alone = fit_covariance(angles, sigma, np.full(sigma.size, ERR_PX))
    found = fitted(angles, sigma, group)
    assert found.sigma_x_px == alone.sigma_x_px
    assert found.by_capture is None


def test_captures_that_do_not_differ_leave_everything_as_it_is() -> None:
    angles, sigma, group = squares_of(6, 0.0, np.random.default_rng(2))
    alone = fit_covariance(angles, sigma, np.full(sigma.size, ERR_PX))
    found = fitted(angles, sigma, group)
    assert found.by_capture is not None
    assert not found.by_capture.is_scattered
    assert found.sigma_x_px == alone.sigma_x_px
    assert found.rho == alone.rho
    assert FocusScatter.of(found.by_capture).mean_err_px2 == 0.0


def test_exact_edges_of_captures_with_known_offsets_give_their_scatter() -> None:
    # Worked example: offsets of -d, 0, d have the standard deviation d, and their mean d / sqrt(3).
    offset = 0.1
    angles = np.tile([10.0, 100.0, 55.0, 145.0], 3)
    group = np.repeat(np.arange(3), 4).astype(np.int64)
    sigma = np.sqrt(0.5 + offset * (group - 1.0))
    found = fit_covariance(angles, sigma, np.full(12, 1e-5), of_captures(angles, group))
    assert found.by_capture is not None
    focus = FocusScatter.of(found.by_capture)
    assert focus.scatter_px2 == pytest.approx(offset, rel=1e-3)
    assert focus.mean_err_px2 == pytest.approx(offset / np.sqrt(3), rel=1e-3)
    assert focus.captures == 3
    assert focus.freedom == 2.0
    # Student's quantile for two degrees of freedom is 4.303 (any table).
    assert found.sigma_x_px is not None
    high = 0.5 + 4.303 * offset / np.sqrt(3)
    assert found.sigma_x_px.high == pytest.approx(np.sqrt(high), rel=1e-3)
    assert list(found.by_capture.offset_px2.values()) == pytest.approx([-0.1, 0.0, 0.1], abs=1e-4)


def test_captures_of_one_edge_each_are_independent_edges() -> None:
    rng = np.random.default_rng(3)
    angles, sigma, group = squares_of(4, 0.05, rng)
    each = np.arange(group.size)
    alone = fit_covariance(angles, sigma, np.full(sigma.size, ERR_PX))
    found = fitted(angles, sigma, each)
    assert found.sigma_x_px == alone.sigma_x_px
    assert found.by_capture is not None
    assert found.by_capture.offset_px2 == {}
    assert FocusScatter.of(found.by_capture).scatter_px2 == pytest.approx(0.05, rel=0.6)


@pytest.mark.slow
@pytest.mark.parametrize("scatter_px2", [0.0, 0.05, 0.15])
def test_the_intervals_hold_the_truth_95_times_of_100_whatever_the_focus_does(
    scatter_px2: float,
) -> None:
    rng = np.random.default_rng(round(100 * scatter_px2))
    inside = np.zeros(2)
    draws = 80
    for _ in range(draws):
        found = fitted(*squares_of(int(rng.integers(4, 13)), scatter_px2, rng))
        truth = zip((found.sigma_x_px, found.sigma_y_px), (XX, YY), strict=True)
        for place, (one, square) in enumerate(truth):
            assert one is not None
            inside[place] += one.low**2 <= square <= one.high**2
    # Of 80 draws of probability 0.95, 69 or more are inside 999 times of 1000; of intervals half as
    # wide, 54. benchmarks/studies/psf_coverage.py counts thousands.
    assert np.all(inside >= 69)


def test_the_scatter_between_captures_is_found() -> None:
    angles, sigma, group = squares_of(60, 0.1, np.random.default_rng(5))
    found = fitted(angles, sigma, group)
    assert found.by_capture is not None
    focus = FocusScatter.of(found.by_capture)
    # A standard deviation of 60 values has an error of 9 %: three of those.
    assert focus.scatter_px2 == pytest.approx(0.1, rel=0.28)
    assert focus.scatter_err_px2 == pytest.approx(0.1 / np.sqrt(118), rel=0.35)


def test_edges_of_two_directions_keep_their_degrees_of_freedom_when_weighed_again() -> None:
    # Edges that lean by 5 degrees, and by some tenths more or less, hardly tell rho: that is an
    # unknown of its own, and one only, however often the edges are weighed.
    rng = np.random.default_rng(0)
    angles = np.tile(np.repeat([5.0, 95.0], 20), 6) + rng.normal(0.0, 0.3, 240)
    group = np.repeat(np.arange(6), 40).astype(np.int64)
    normal = np.deg2rad(angles + 90.0)
    design = np.column_stack([np.cos(normal) ** 2, np.sin(2 * normal), np.sin(normal) ** 2])
    squares = design @ [XX, XY, YY] + rng.normal(0.0, 0.03, 6)[group]
    edges = EdgeSquares(
        design=design,
        squares_px2=squares + rng.normal(0.0, 2 * np.sqrt(XX) * ERR_PX, 240),
        err_px=np.full(240, ERR_PX),
        spread_px=2 * np.sqrt(squares),
        trust=np.ones(240),
    )
    model = _CaptureModel(edges, group, np.zeros(3))
    model.is_scattered = True
    again = model.with_trust(np.ones(240)).with_trust(np.ones(240))
    assert again.edges.design.shape == model.edges.design.shape == (240, 4)
    assert again.between == model.between == 4
    assert np.isfinite(again.solved().values).all()


def test_no_interval_of_rho_goes_beyond_1() -> None:
    # Three edges that contradict one another: rho comes out near -1, and with a wide interval.
    found = fit_covariance(
        np.array([146.4, 57.7, 163.9]),
        np.array([0.3652, 2.0358, 0.3340]),
        np.array([0.028, 0.16, 0.018]),
    )
    assert found.rho is not None
    assert found.rho.value == pytest.approx(-0.98, abs=0.01)
    assert found.rho.low == -1.0
    assert found.rho.high < -0.9
