"""What a correlation that no edge tells does to the widths."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from calibration.edges import orientation_of
from calibration.psf import fit_covariance, share_of_correlation
from simulation.arrays import FloatArray
from tests.calibration.known import known


def widths(angles_deg: FloatArray, sigma_x: float, sigma_y: float, rho: float) -> FloatArray:
    """sqrt(n' Sigma n) for edges of these directions."""
    xy = rho * sigma_x * sigma_y
    covariance = np.array([[sigma_x**2, xy], [xy, sigma_y**2]])
    normal = np.deg2rad(angles_deg + 90.0)
    n = np.stack([np.cos(normal), np.sin(normal)])
    return np.asarray(np.sqrt(np.einsum("in,ij,jn->n", n, covariance, n)))


@settings(max_examples=60, deadline=None)
@given(
    sigma_x=st.floats(0.3, 2.0),
    ratio=st.floats(0.6, 1.6),
    rho=st.floats(-0.6, 0.6),
    turn=st.floats(0.0, 180.0),
)
def test_exact_widths_give_the_exact_covariance(
    sigma_x: float, ratio: float, rho: float, turn: float
) -> None:
    angles = np.asarray((np.arange(8) * 22.5 + turn) % 180.0, dtype=np.float64)
    sigma = widths(angles, sigma_x, sigma_x * ratio, rho)
    fit = fit_covariance(angles, sigma, np.full(8, 1e-3))
    assert known(fit.sigma_x_px).value == pytest.approx(sigma_x, rel=1e-6)
    assert known(fit.sigma_y_px).value == pytest.approx(sigma_x * ratio, rel=1e-6)
    assert known(fit.rho).value == pytest.approx(rho, abs=1e-6)


def test_a_vertical_edge_measures_sigma_x_alone() -> None:
    # Worked example: the width across an edge at 95 degrees is taken as sigma_x.
    fit = fit_covariance(np.array([95.0]), np.array([0.9]), np.array([0.01]))
    assert known(fit.sigma_x_px).value == pytest.approx(0.9)
    assert known(fit.sigma_x_px).err == pytest.approx(0.01)
    assert fit.sigma_y_px is None
    assert fit.rho is None
    assert fit.covariance_px2 is None


def test_vertical_and_horizontal_edges_leave_the_correlation_open() -> None:
    fit = fit_covariance(np.array([90.0, 0.0]), np.array([0.9, 0.7]), np.array([0.01, 0.01]))
    assert known(fit.sigma_x_px).value == pytest.approx(0.9)
    assert known(fit.sigma_y_px).value == pytest.approx(0.7)
    assert fit.rho is None


@pytest.mark.slow
@pytest.mark.parametrize("count", [9, 24, 60])
def test_the_95_percent_intervals_contain_the_truth_95_times_of_100(count: int) -> None:
    rng = np.random.default_rng(count)
    truth = (0.62, 0.51, 0.3)
    inside = np.zeros(3)
    draws = 300
    for _ in range(draws):
        angles = rng.uniform(0.0, 180.0, count)
        err = rng.uniform(0.004, 0.012, count)
        fit = fit_covariance(angles, widths(angles, *truth) + rng.normal(0.0, err), err)
        estimates = (fit.sigma_x_px, fit.sigma_y_px, fit.rho)
        for place, (estimate, true) in enumerate(zip(estimates, truth, strict=True)):
            inside[place] += known(estimate).low <= true <= known(estimate).high
    # 300 draws of probability 0.95 scatter by 1.3 %: three of those.
    assert np.all(np.abs(inside / draws - 0.95) < 0.04)


def test_scatter_beyond_the_errors_widens_them() -> None:
    rng = np.random.default_rng(7)
    angles = np.linspace(0.0, 175.0, 36)
    sigma = widths(angles, 0.6, 0.6, 0.0) + rng.normal(0.0, 0.02, 36)
    fit = fit_covariance(angles, sigma, np.full(36, 1e-4))
    assert fit.scatter_px == pytest.approx(0.02, rel=0.35)  # 36 edges: 12 %, three of those
    assert known(fit.sigma_x_px).err > 0.003


def test_a_few_wild_edges_do_not_move_the_result() -> None:
    rng = np.random.default_rng(12)
    angles = rng.uniform(0.0, 180.0, 40)
    sigma = widths(angles, 0.6, 0.5, 0.1) + rng.normal(0.0, 0.003, 40)
    sigma[:3] = 1.5
    fit = fit_covariance(angles, sigma, np.full(40, 0.003))
    assert known(fit.sigma_x_px).value == pytest.approx(0.6, abs=0.005)
    assert fit.edges_used == 37


@pytest.mark.parametrize(
    ("angle_deg", "name"),
    [
        (0.0, "horizontal"),
        (22.0, "horizontal"),
        (23.0, "diagonal"),
        (67.0, "diagonal"),
        (68.0, "vertical"),
        (112.0, "vertical"),
        (135.0, "diagonal"),
        (179.0, "horizontal"),
    ],
)
def test_an_edge_is_named_within_22_5_degrees_of_the_axis(angle_deg: float, name: str) -> None:
    assert orientation_of(angle_deg) == name


def test_no_edge_and_impossible_widths_are_refused() -> None:
    empty = np.array([])
    with pytest.raises(ValueError):
        fit_covariance(empty, empty, empty)
    with pytest.raises(ValueError):
        fit_covariance(np.array([0.0]), np.array([0.5]), np.array([0.0]))


def test_widths_that_no_covariance_has_leave_the_correlation_open() -> None:
    # 1 along both axes, 2 along a diagonal: the other diagonal would have 1 + 1 - 4 < 0.
    fit = fit_covariance(np.array([90.0, 0.0, 45.0]), np.array([1.0, 1.0, 2.0]), np.full(3, 0.01))
    assert known(fit.sigma_x_px).value == pytest.approx(1.0)
    assert known(fit.sigma_y_px).value == pytest.approx(1.0)
    assert fit.rho is None
    assert fit.covariance_px2 is None
    assert fit.weights.tolist() == [1.0, 1.0, 0.0]


def test_a_correlation_known_to_a_third_only_is_left_open() -> None:
    # d rho = 2 sigma d sigma / (sigma_x sigma_y) / (2 n_x n_y) = 2 d sigma for unit widths.
    angles = np.array([90.0, 0.0, 45.0])
    vague = fit_covariance(angles, np.ones(3), np.array([0.001, 0.001, 0.15]))
    assert vague.rho is None
    assert known(vague.sigma_x_px).err == pytest.approx(0.001)
    clear = fit_covariance(angles, np.ones(3), np.array([0.001, 0.001, 0.1]))
    assert known(clear.rho).err == pytest.approx(0.2, rel=0.01)


def test_edges_of_nearly_one_direction_do_not_tell_the_width_across() -> None:
    # Normals within 25 degrees of y: xx is an extrapolation, known to a third; rho to 0.1.
    fit = fit_covariance(np.array([0.0, 25.0, 155.0]), np.ones(3), np.full(3, 0.05))
    assert fit.sigma_x_px is None
    assert fit.rho is None
    assert known(fit.sigma_y_px).value == pytest.approx(1.0)


def test_a_negative_variance_is_no_width() -> None:
    # At 22 degrees n_x^2 = 0.14: 0.14 * 1 + 0.86 yy = 0.09 makes yy negative.
    fit = fit_covariance(np.array([90.0, 22.0]), np.array([1.0, 0.3]), np.full(2, 0.01))
    assert known(fit.sigma_x_px).value == pytest.approx(1.0)
    assert fit.sigma_y_px is None


def test_an_edge_five_degrees_off_upright_hides_nearly_a_tenth_of_rho() -> None:
    # sin 5 cos 5 / cos^2 5 = tan 5 degrees.
    assert share_of_correlation(np.array([95.0])) == pytest.approx(np.tan(np.deg2rad(5.0)))
    assert share_of_correlation(np.array([90.0])) == pytest.approx(0.0, abs=1e-15)
    assert share_of_correlation(np.array([85.0, 95.0])) == pytest.approx(0.0, abs=1e-15)
    assert share_of_correlation(np.array([45.0])) == 0.0  # no width along an axis comes of it


@given(lean_deg=st.floats(-15.0, 15.0), rho=st.floats(-0.15, 0.15))
def test_the_fitted_width_is_off_by_that_share(lean_deg: float, rho: float) -> None:
    angles = np.array([90.0 + lean_deg])
    normal = np.deg2rad(angles + 90.0)
    nx, ny = np.cos(normal), np.sin(normal)
    across = np.sqrt(nx**2 + 2 * rho * nx * ny + ny**2)  # widths of 1 px
    found = known(fit_covariance(angles, across, np.full(1, 0.001)).sigma_x_px)
    expected = abs(rho) * share_of_correlation(angles)
    assert abs(found.value - 1.0) == pytest.approx(expected, rel=0.1, abs=1e-12)
