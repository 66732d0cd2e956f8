from collections.abc import Callable
from math import sqrt

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.errors import RegistrationError
from calibration.registration.pair import (
    AxialRegistration,
    Registration,
    register,
    register_axial,
    register_distorted,
)
from simulation import GaussianPsf, zoom_out_on_grid
from tests.simulation.closed_form import Item, photograph, random_scene

FloatArray = NDArray[np.float64]
Align = Callable[[FloatArray, FloatArray, GaussianPsf], object]

OPTICAL_SIGMA_PX = 0.6
PSF = GaussianPsf(
    sigma_x_px=sqrt(OPTICAL_SIGMA_PX**2 + 1 / 12), sigma_y_px=sqrt(OPTICAL_SIGMA_PX**2 + 1 / 12)
)
REFERENCE_SHAPE = (260, 360)
ORIGIN_PX = (7.3, 11.6)
"""Where the follow-up's first pixel lies in the reference, (y, x)."""


@pytest.fixture(scope="module")
def scene() -> list[Item]:
    return random_scene(3, 600, 450)


@pytest.fixture(scope="module")
def reference(scene: list[Item]) -> FloatArray:
    rows, cols = REFERENCE_SHAPE
    return photograph(scene, REFERENCE_SHAPE, 1.0, OPTICAL_SIGMA_PX, (-rows / 2, -cols / 2))


def followup_of(scene: list[Item], zoom: float) -> FloatArray:
    """Not square, off the centre, wider than the reference covers; with gain and offset."""
    rows, cols = REFERENCE_SHAPE
    shape = (int(rows / zoom) - 5, int(cols / zoom) + 3)
    origin = (ORIGIN_PX[0] - rows / 2, ORIGIN_PX[1] - cols / 2)
    return 0.8 * photograph(scene, shape, zoom, OPTICAL_SIGMA_PX, origin) + 9


def corner_error_px(
    registration: Registration | AxialRegistration, shape: tuple[int, int], zoom: float
) -> float:
    """Largest error of a corner's place, in follow-up pixels."""
    truth = np.array([[zoom, 0, ORIGIN_PX[1]], [0, zoom, ORIGIN_PX[0]], [0, 0, 1]])
    corners = np.array([[x, y, 1] for x in (0, shape[1] - 1) for y in (0, shape[0] - 1)]).T
    found = registration.matrix @ corners
    return float(np.abs(found[:2] / found[2] - (truth @ corners)[:2]).max() / zoom)


@pytest.mark.parametrize("zoom", [1.004, 1.1, 1.5, 2.0, 2.4, 3.0])
def test_an_axial_pose_is_found_to_a_hundredth_of_a_pixel(
    scene: list[Item], reference: FloatArray, zoom: float
) -> None:
    followup = followup_of(scene, zoom)
    registration = register_axial(reference, followup, PSF)
    assert corner_error_px(registration, followup.shape, zoom) < 0.01
    assert registration.zoom == pytest.approx(zoom, rel=5e-5)  # 0.01 px over half the image
    assert registration.correlation > 0.999


@pytest.mark.parametrize("zoom", [1.1, 1.5, 2.4])
def test_without_a_psf_it_is_still_found_to_some_hundredths(
    scene: list[Item], reference: FloatArray, zoom: float
) -> None:
    followup = followup_of(scene, zoom)
    registration = register_axial(reference, followup)
    assert corner_error_px(registration, followup.shape, zoom) < 0.03


@pytest.mark.slow
@pytest.mark.parametrize("zoom", [1.1, 1.5, 2.0, 3.0])
def test_a_homography_is_found_to_two_hundredths_of_a_pixel(
    scene: list[Item], reference: FloatArray, zoom: float
) -> None:
    followup = followup_of(scene, zoom)
    registration = register(reference, followup, PSF)
    # Eight parameters on some ten thousand pixels, the corners lie outside the reference.
    assert corner_error_px(registration, followup.shape, zoom) < 0.02
    assert registration.zoom == pytest.approx(zoom, rel=2e-4)


def test_a_small_rotation_is_part_of_a_homography_and_no_axial_pose(
    scene: list[Item], reference: FloatArray
) -> None:
    # The blobs of the scene are round: turned about the centre they keep their closed form.
    blobs = [item for item in scene if not item.is_rectangle]
    turn = np.deg2rad(8.0)
    turned = [
        Item(
            False,
            np.cos(turn) * item.y_px + np.sin(turn) * item.x_px,
            np.cos(turn) * item.x_px - np.sin(turn) * item.y_px,
            item.height_px,
            item.width_px,
            item.level_dn,
        )
        for item in blobs
    ]
    first = photograph(blobs, (240, 300), 1.0, OPTICAL_SIGMA_PX)
    second = photograph(turned, (160, 200), 1.5, OPTICAL_SIGMA_PX)
    registration = register(first, second, PSF)
    matrix = registration.matrix
    # Follow-up to reference turns back: x = cos x' + sin y'.
    assert np.arctan2(matrix[0, 1], matrix[0, 0]) == pytest.approx(turn, abs=2e-4)
    np.testing.assert_allclose(matrix @ [99.5, 79.5, 1], [149.5, 119.5, 1], atol=0.02)
    with pytest.raises(RegistrationError):
        register_axial(first, second, PSF)


def test_the_standard_error_covers_the_error_under_noise(
    scene: list[Item], reference: FloatArray
) -> None:
    rng = np.random.default_rng(8)
    followup = followup_of(scene, 1.5)
    registration = register_axial(
        reference + rng.normal(0, 2, reference.shape), followup + rng.normal(0, 2, followup.shape),
        PSF,
    )  # fmt: skip
    assert abs(registration.zoom - 1.5) < 4 * registration.zoom_err
    assert registration.zoom_err < 2e-4
    assert registration.shift_err_px < 0.02
    expected_y_px = ORIGIN_PX[0] + ((followup.shape[0] - 1) * 1.5 - 259) / 2
    expected_x_px = ORIGIN_PX[1] + ((followup.shape[1] - 1) * 1.5 - 359) / 2
    limit_px = 4 * registration.shift_err_px
    assert registration.shift_y_px == pytest.approx(expected_y_px, abs=limit_px)
    assert registration.shift_x_px == pytest.approx(expected_x_px, abs=limit_px)


def test_a_border_row_that_comes_and_goes_does_not_keep_it_from_settling() -> None:
    # Both centres on one axis, 200 of 300 rows at zoom 1.5: the reference ends where a pixel
    # does. Of a dozen seeds this one went to and fro between two rows.
    rng = np.random.default_rng(9)
    wide = random_scene(3, 900, 900)
    near, far = (
        photograph(wide, (300, 390), zoom, OPTICAL_SIGMA_PX) + rng.normal(0, 1, (300, 390))
        for zoom in (1.0, 1.5)
    )
    assert register_axial(near, far, PSF).zoom == pytest.approx(1.5, rel=1e-4)


def test_the_overlap_is_what_can_be_simulated_and_it_predicts_the_followup(
    scene: list[Item], reference: FloatArray
) -> None:
    followup = followup_of(scene, 1.5)
    overlap = register_axial(reference, followup, PSF).overlap
    part = followup[overlap.rows, overlap.cols]
    assert part.shape == (overlap.grid.rows, overlap.grid.cols)
    simulated = zoom_out_on_grid(reference, overlap.grid, PSF)
    np.testing.assert_allclose(simulated[4:-4, 4:-4] * 0.8 + 9, part[4:-4, 4:-4], atol=1.0)


def axial(zoom: float, origin_y_px: float, origin_x_px: float) -> AxialRegistration:
    return AxialRegistration(
        zoom=zoom, zoom_err=0.0, origin_y_px=origin_y_px, origin_x_px=origin_x_px,
        shift_err_px=0.0, reference_shape=(100, 120), followup_shape=(60, 60), inlier_count=99,
        match_rms_px=0.1, correlation=1.0, residual_rms_dn=0.0,
    )  # fmt: skip


def test_the_overlap_holds_whole_pixels_only() -> None:
    # By hand: row i covers [i * 2 - 10.5 - 1, i * 2 - 10.5 + 1] of [-0.5, 99.5]: rows 6 to 54.
    # Column j covers [2 j + 0.5 - 1, 2 j + 0.5 + 1] of [-0.5, 119.5]: columns 0 to 59.
    overlap = axial(2.0, -10.5, 0.5).overlap
    assert (overlap.rows, overlap.cols) == (slice(6, 55), slice(0, 60))
    assert (overlap.grid.origin_y_px, overlap.grid.origin_x_px) == (1.5, 0.5)


def test_images_that_hardly_overlap_are_refused() -> None:
    with pytest.raises(RegistrationError) as refused:
        _ = axial(2.0, 70.0, 0.5).overlap
    assert refused.value.reason == "little_overlap"


@pytest.mark.parametrize("align", [register, register_axial])
def test_a_followup_that_is_nearer_is_refused(
    scene: list[Item],
    reference: FloatArray,
    align: Align,
) -> None:
    with pytest.raises(RegistrationError) as refused:
        align(followup_of(scene, 1.5), reference, PSF)
    assert refused.value.reason == "nearer"


def test_images_of_different_scenes_are_refused(reference: FloatArray) -> None:
    other = photograph(random_scene(77, 600, 450), (200, 300), 1.5, OPTICAL_SIGMA_PX)
    with pytest.raises(RegistrationError):
        register_axial(reference, other, PSF)


@pytest.mark.parametrize("align", [register, register_distorted])
def test_an_image_without_features_is_refused(reference: FloatArray, align: Align) -> None:
    with pytest.raises(RegistrationError) as refused:
        align(reference, np.full((100, 120), 50.0), PSF)
    assert (refused.value.reason, refused.value.at_fault) == ("no_detail", "followup")


@pytest.mark.parametrize("align", [register, register_distorted])
def test_a_colour_image_is_refused(reference: FloatArray, align: Align) -> None:
    colour = np.stack([reference] * 3, axis=-1)
    align(reference, reference, PSF)
    with pytest.raises(ValueError):
        align(colour, reference, PSF)
