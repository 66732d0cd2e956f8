import numpy as np
import pytest

from simulation import GaussianPsf, PoseOptions, SamplingGrid, simulate_pose, zoom_operator
from simulation.capture_noise import propagated_variance
from simulation.pose.view_filter import pose_noise_gain
from tests.simulation.poses import tilted

PSF = GaussianPsf(sigma_x_px=0.9, sigma_y_px=0.7)
TILTED_PSF = GaussianPsf(sigma_x_px=0.9, sigma_y_px=0.7, rho=0.4)

MATCHED = PoseOptions(model="matched")


def test_a_follow_up_from_the_same_place_keeps_the_noise() -> None:
    gain = pose_noise_gain(np.eye(3), (30, 40), (40, 30), PSF, MATCHED)
    assert gain == pytest.approx(np.ones((30, 40)), abs=1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("psf", [PSF, TILTED_PSF])
@pytest.mark.parametrize("zooms", [(1.0, 1.0), (1.1, 1.1), (1.37, 1.37), (2.0, 1.6)])
def test_an_axial_follow_up_has_the_exact_sum_of_squared_weights(
    psf: GaussianPsf, zooms: tuple[float, float]
) -> None:
    # The exact sum comes from the operator itself, which is another code path.
    grid = SamplingGrid(
        zoom_y=zooms[0], zoom_x=zooms[1], origin_y_px=30.3, origin_x_px=30.6, rows=25, cols=30
    )
    shape = (150, 160)
    exact = propagated_variance(zoom_operator(shape, grid, psf, "matched"), np.ones(shape))
    gain = pose_noise_gain(grid.matrix, shape, (30, 25), psf, MATCHED)
    # The operator's bands are short: its sums are off by up to 1.09 % at zoom 1.37 with rho 0.4.
    assert gain == pytest.approx(exact, rel=1.2e-2)


@pytest.mark.slow
def test_a_tilted_follow_up_has_the_scatter_of_simulated_noise() -> None:
    shape, size = (200, 280), (280, 200)
    matrix = tilted(300.0, size, 20.0, 1.3)
    rng = np.random.default_rng(5)
    count = 60
    squares = np.zeros(shape)
    for _ in range(count):
        squares += (
            simulate_pose(rng.normal(size=shape), matrix, size, TILTED_PSF, MATCHED).image ** 2
        )
    inside = ~simulate_pose(np.zeros(shape), matrix, size, TILTED_PSF, MATCHED).outside
    inside[:12], inside[-12:], inside[:, :12], inside[:, -12:] = False, False, False, False
    gain = pose_noise_gain(matrix, shape, size, TILTED_PSF, MATCHED)
    # Strips across the tilt, of some 5000 correlated pixels: 60 draws scatter by about 0.5 %.
    for left in range(0, 280, 40):
        strip = np.s_[:, left : left + 40]
        chosen = inside[strip]
        if chosen.sum() < 2000:
            continue
        measured = (squares[strip] / count)[chosen].mean()
        assert measured == pytest.approx(gain[strip][chosen].mean(), rel=0.02)
    assert gain[inside].max() > 1.5 * gain[inside].min()


def test_a_missing_psf_is_refused() -> None:
    with pytest.raises(ValueError):
        pose_noise_gain(np.eye(3), (30, 40), (40, 30), None, MATCHED)
