import numpy as np
import pytest

from simulation import GaussianPsf, PsfField
from simulation.arrays import FloatArray

PSF = GaussianPsf(sigma_x_px=0.9, sigma_y_px=0.7, rho=0.3)


def radial_field() -> PsfField:
    """0.5 (1 + u^2 + v^2) along x, 0.3 along y and 0.1 u in the correlation, on 301 x 201."""
    return PsfField(
        width_px=301,
        height_px=201,
        coefficients_px2=np.array(
            [[0.5, 0, 0, 0.5, 0, 0.5], [0, 0.1, 0, 0, 0, 0], [0.3, 0, 0, 0, 0, 0]]
        ),
    )


def test_a_field_of_degree_0_is_one_psf_everywhere() -> None:
    (xx, xy), (_, yy) = PSF.covariance_px2
    field = PsfField(width_px=30, height_px=20, coefficients_px2=np.array([[xx], [xy], [yy]]))
    covariance = field.covariance_px2(np.arange(30.0)[None, :], np.arange(20.0)[:, None])
    assert covariance.shape == (20, 30, 2, 2)
    assert covariance == pytest.approx(np.broadcast_to(PSF.covariance_px2, covariance.shape))


def test_the_corner_is_at_radius_one_and_y_counts_down_the_rows() -> None:
    field = radial_field()
    centre = field.covariance_px2(150.0, 100.0)
    assert centre == pytest.approx(np.diag([0.5, 0.3]))
    # By hand: u = 150 / hypot(150, 100) in the right column.
    u = 150 / np.hypot(150, 100)
    assert field.covariance_px2(300.0, 0.0) == pytest.approx(
        np.array([[1.0, 0.1 * u], [0.1 * u, 0.3]])
    )
    assert field.covariance_px2(0.0, 200.0)[0, 1] == pytest.approx(-0.1 * u)


def test_monomials_go_by_degree_then_by_the_power_of_v() -> None:
    for index, (power_u, power_v) in enumerate(
        [(0, 0), (1, 0), (0, 1), (2, 0), (1, 1), (0, 2), (3, 0), (2, 1), (1, 2), (0, 3)]
    ):
        coefficients = np.zeros((3, 10))
        coefficients[[0, 2], 0] = 2.0
        coefficients[1, index] += 0.5
        field = PsfField(width_px=81, height_px=61, coefficients_px2=coefficients)
        # r = 50: u = 0.6, v = -0.4.
        expected = 0.5 * 0.6**power_u * (-0.4) ** power_v
        assert field.covariance_px2(70.0, 10.0)[0, 1] == pytest.approx(expected)
        assert field.degree == 3


def test_the_coefficients_are_a_copy_that_nobody_changes() -> None:
    coefficients = np.array([[0.5], [0.0], [0.5]])
    field = PsfField(width_px=30, height_px=20, coefficients_px2=coefficients)
    coefficients[0] = 9
    assert field.coefficients_px2[0, 0] == 0.5
    with pytest.raises(ValueError):
        field.coefficients_px2[0, 0] = 1


@pytest.mark.parametrize(
    "coefficients",
    [
        pytest.param(np.eye(2, 3), id="two rows"),
        pytest.param(np.array([[1, 0, 0, 0], [0, 0, 0, 0], [1, 0, 0, 0]]), id="four terms"),
        pytest.param(np.ones((3, 0)), id="no terms"),
        pytest.param(np.full((3, 1), np.nan), id="not finite"),
        pytest.param(np.array([[0.5], [0.6], [0.5]]), id="not positive definite"),
        pytest.param(
            np.array([[0.5, -1, 0], [0, 0, 0], [0.5, 0, 0]]),
            id="positive in the middle, negative in the right column",
        ),
    ],
)
def test_what_is_no_field_is_refused(coefficients: FloatArray) -> None:
    with pytest.raises(ValueError):
        PsfField(width_px=30, height_px=20, coefficients_px2=coefficients)


def test_a_frame_of_one_row_is_refused() -> None:
    with pytest.raises(ValueError):
        PsfField(width_px=30, height_px=1, coefficients_px2=np.array([[0.5], [0.0], [0.5]]))
