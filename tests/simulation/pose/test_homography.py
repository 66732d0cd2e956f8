import numpy as np
import pytest
from hypothesis import given, strategies as st

from simulation.pose.warp import project, projection_depth, projection_slopes

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
