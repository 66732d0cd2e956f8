import numpy as np
import pytest

from simulation import PoseOptions, PsfField, simulate_pose
from tests.simulation.poses import PHOTOGRAPH, TILTED_PSF, blob, constant_field, tilted


@pytest.mark.slow
def test_an_even_field_is_one_psf() -> None:
    matrix = tilted(300.0, (280, 200), 15.0, 1.2)
    one = simulate_pose(PHOTOGRAPH, matrix, (280, 200), TILTED_PSF)
    field = simulate_pose(PHOTOGRAPH, matrix, (280, 200), constant_field(280, 200, TILTED_PSF))
    assert field.image == pytest.approx(one.image, abs=1e-9)
    assert (field.nearer == one.nearer).all()


def test_a_shift_over_a_field_blurs_by_the_difference_of_its_two_places() -> None:
    # Sigma grows to the right by 1 px^2 per r; the follow-up sees everything 40 px further right.
    size, shift = (201, 101), 40
    coefficients = np.zeros((3, 3))
    coefficients[[0, 2], 0] = 1.5
    coefficients[[0, 2], 1] = 1.0
    field = PsfField(width_px=size[0], height_px=size[1], coefficients_px2=coefficients)
    matrix = np.array([[1.0, 0, -shift], [0, 1, 0], [0, 0, 1]])
    image = blob((101, 201), np.array([70.0, 50.0]), 9 * np.eye(2))
    simulated = simulate_pose(image, matrix, size, field)
    seen = ~simulated.outside
    assert not simulated.nearer.any()
    gained = shift / field.corner_radius_px
    expected = blob((101, 201), np.array([110.0, 50.0]), (9 + gained) * np.eye(2))
    # The common blur's kernel is cut as zoom_out's is: 5e-4 of the peak.
    assert simulated.image[seen] == pytest.approx(expected[seen], abs=1e-3 * expected.max())
    # Back to the left the follow-up is the sharper one.
    back = simulate_pose(image, np.linalg.inv(matrix), size, field)
    assert back.nearer[~back.outside].all()


@pytest.mark.slow
def test_a_part_of_the_follow_up_has_the_psf_of_its_place_in_the_frame() -> None:
    coefficients = np.zeros((3, 6))
    coefficients[[0, 2], 0] = 0.5
    coefficients[[0, 2], 1:] = 0.1, -0.05, 0.2, 0.0, 0.3
    field = PsfField(width_px=280, height_px=200, coefficients_px2=coefficients)
    matrix = tilted(300.0, (280, 200), 10.0, 1.2)
    whole = simulate_pose(PHOTOGRAPH, matrix, (280, 200), field).image
    moved = matrix @ np.array([[1.0, 0, 60], [0, 1, 30], [0, 0, 1]])
    part = simulate_pose(
        PHOTOGRAPH, moved, (150, 120), field, PoseOptions(origin_px=(60.0, 30.0))
    ).image
    # The common blur is chosen for what is seen, and its kernel is cut off at 1e-3 of 255.
    assert part == pytest.approx(whole[30:150, 60:210], abs=0.6)
    wrong = simulate_pose(
        PHOTOGRAPH, moved, (150, 120), field, PoseOptions(origin_px=(0.0, 0.0))
    ).image
    assert abs(wrong - whole[30:150, 60:210]).max() > 1
