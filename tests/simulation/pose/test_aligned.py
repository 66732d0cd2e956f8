import numpy as np
import pytest

from simulation import PoseOptions, PsfField, SamplingGrid, simulate_pose
from simulation.choices import POSE_MODELS, PoseModel
from tests.simulation.poses import PHOTOGRAPH, TILTED_PSF

SIZE = (150, 130)
GRID = SamplingGrid(zoom_y=1.4, zoom_x=1.8, origin_y_px=33.2, origin_x_px=-20.4, rows=130, cols=150)
MIRRORED = np.array([[-1.5, 0, 290.0], [0, 1.2, -30.3], [0, 0, 1]])
TURN = 1e-13
"""Enough to make every pixel a case of its own, and too little to move any."""


@pytest.mark.parametrize("model", POSE_MODELS)
@pytest.mark.parametrize("matrix", [GRID.matrix, MIRRORED], ids=["beyond the edge", "mirrored"])
def test_a_zoom_is_the_limit_of_one_that_is_turned(
    matrix: np.ndarray[tuple[int, int], np.dtype[np.float64]], model: PoseModel
) -> None:
    options = PoseOptions(model=model)
    turned = matrix + TURN * np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 0]])
    zoomed = simulate_pose(PHOTOGRAPH, matrix, SIZE, TILTED_PSF, options)
    limit = simulate_pose(PHOTOGRAPH, turned, SIZE, TILTED_PSF, options)
    assert limit.outside.any()
    np.testing.assert_array_equal(zoomed.outside, limit.outside)
    np.testing.assert_array_equal(zoomed.nearer, limit.nearer)
    np.testing.assert_allclose(zoomed.image, limit.image, rtol=0, atol=1e-9 * 255)


def test_masks_of_a_zoom_follow_a_psf_that_varies() -> None:
    rows, cols = PHOTOGRAPH.shape[:2]
    coefficients = np.zeros((3, 3))
    coefficients[[0, 2], 0] = 0.6
    coefficients[[0, 2], 1] = 0.4
    field = PsfField(width_px=cols, height_px=rows, coefficients_px2=coefficients)
    matrix = np.diag([-1.05, 1.05, 1.0])
    matrix[0, 2] = cols
    turned = matrix + TURN * np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 0]])
    options = PoseOptions(model="matched", origin_px=(0.0, 0.0))
    zoomed = simulate_pose(PHOTOGRAPH, matrix, (cols, rows), field, options)
    limit = simulate_pose(PHOTOGRAPH, turned, (cols, rows), field, options)
    assert zoomed.nearer.any()
    assert not zoomed.nearer.all()
    np.testing.assert_array_equal(zoomed.nearer, limit.nearer)
