"""Drawings in two levels and pages scanned to white are aligned by what they show.

H.json: written and read by one class.
"""

import json
from math import sqrt
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calibration.errors import HomographyFileError, RegistrationError
from calibration.files import read_homography, write_homography
from calibration.registration import (
    AlignedPhotograph,
    Homography,
    ImageFeatures,
    Registration,
    RegistrationReference,
    register_images,
)
from calibration.registration._features import features_of
from simulation import GaussianPsf
from simulation.arrays import Float32Array, FloatArray
from tests.simulation.closed_form import Item, photograph, random_scene

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


def corner_error_px(registration: Registration, shape: tuple[int, int], zoom: float) -> float:
    """Largest error of a corner's coordinates, in follow-up pixels."""
    truth = np.array([[zoom, 0, ORIGIN_PX[1]], [0, zoom, ORIGIN_PX[0]], [0, 0, 1]])
    corners = np.array([[x, y, 1] for x in (0, shape[1] - 1) for y in (0, shape[0] - 1)]).T
    found = registration.matrix @ corners
    return float(np.abs(found[:2] / found[2] - (truth @ corners)[:2]).max() / zoom)


@pytest.mark.slow
@pytest.mark.parametrize("zoom", [1.004, 1.1, 1.5, 2.0, 2.4, 3.0])
def test_a_pose_is_found_to_a_hundredth_of_a_pixel(
    scene: list[Item], reference: FloatArray, zoom: float
) -> None:
    followup = followup_of(scene, zoom)
    registration = register_images(reference, followup, PSF)
    assert corner_error_px(registration, followup.shape, zoom) < 0.01
    assert registration.zoom == pytest.approx(zoom, rel=5e-5)  # 0.01 px over half the image
    assert registration.correlation > 0.999


@pytest.mark.slow
@pytest.mark.parametrize("zoom", [1.1, 1.5, 2.4])
def test_without_a_psf_it_is_still_found_to_some_hundredths(
    scene: list[Item], reference: FloatArray, zoom: float
) -> None:
    followup = followup_of(scene, zoom)
    assert corner_error_px(register_images(reference, followup, None), followup.shape, zoom) < 0.03


def test_a_small_rotation_is_found(scene: list[Item]) -> None:
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
    registration = register_images(first, second, PSF)
    matrix = registration.matrix
    # Follow-up to reference turns back: x = cos x' + sin y'.
    assert np.arctan2(matrix[0, 1], matrix[0, 0]) == pytest.approx(turn, abs=2e-4)
    np.testing.assert_allclose(matrix @ [99.5, 79.5, 1], [149.5, 119.5, 1], atol=0.02)


@pytest.mark.slow
def test_a_border_row_that_comes_and_goes_does_not_keep_it_from_settling() -> None:
    # Both centres on one axis, 200 of 300 rows at zoom 1.5: the reference ends where a pixel
    # does. Of a dozen seeds this one went to and fro between two rows.
    rng = np.random.default_rng(9)
    wide = random_scene(3, 900, 900)
    near, far = (
        photograph(wide, (300, 390), zoom, OPTICAL_SIGMA_PX) + rng.normal(0, 1, (300, 390))
        for zoom in (1.0, 1.5)
    )
    assert register_images(near, far, PSF).zoom == pytest.approx(1.5, rel=1e-4)


def test_swapping_the_photographs_inverts_the_pose(
    scene: list[Item], reference: FloatArray
) -> None:
    followup = followup_of(scene, 1.5)
    further, nearer = (
        register_images(reference, followup, PSF),
        register_images(followup, reference, PSF),
    )
    product = further.matrix @ nearer.matrix
    # The same pixels are compared both times, from other starts: a hundredth of a pixel.
    np.testing.assert_allclose(product / product[2, 2], np.eye(3), atol=0.01)
    # Without noise the error is what the interpolations leave: of the same size.
    assert 1 / 3 < 1.5 * nearer.place_err_px / further.place_err_px < 3


def test_an_image_without_features_is_refused(reference: FloatArray) -> None:
    with pytest.raises(RegistrationError) as refused:
        register_images(reference, np.full((100, 120), 50.0), PSF)
    assert (refused.value.reason, refused.value.at_fault) == ("no_detail", "followup")


def test_a_colour_image_is_refused(reference: FloatArray) -> None:
    colour = np.stack([reference] * 3, axis=-1)
    register_images(reference, reference, PSF)
    with pytest.raises(ValueError):
        register_images(colour, reference, PSF)


def test_a_result_says_of_itself_what_fits_a_line_or_two(
    scene: list[Item], reference: FloatArray
) -> None:
    registration = register_images(reference, followup_of(scene, 1.5), PSF)
    assert len(repr(registration)) < 400
    assert "array" not in repr(registration)
    assert f"zoom {registration.zoom:.6g}" in repr(registration)


@pytest.mark.slow
def test_a_prepared_reference_gives_every_follow_up_the_pose_that_it_has_alone(
    scene: list[Item], reference: FloatArray, monkeypatch: pytest.MonkeyPatch
) -> None:
    looked_at: list[tuple[int, ...]] = []

    def noted(levels: Float32Array, *others: Any, **options: Any) -> ImageFeatures:
        looked_at.append(levels.shape)
        return features_of(levels, *others, **options)

    monkeypatch.setattr(f"{RegistrationReference.__module__}.features_of", noted)
    prepared = RegistrationReference.of(reference)
    for zoom in (1.1, 1.5):
        followup = followup_of(scene, zoom)
        alone, found = (register_images(near, followup, PSF) for near in (reference, prepared))
        np.testing.assert_array_equal(found.matrix, alone.matrix)
    # Twice as an array, once as it was prepared; the other four are of follow-ups.
    assert looked_at.count(REFERENCE_SHAPE) == 3
    assert len(looked_at) == 7


def drawing(shape: tuple[int, int], seed: int = 1) -> FloatArray:
    """Black bars and squares on white, at whole pixels."""
    rng = np.random.default_rng(seed)
    made = np.full(shape, 255.0)
    for _ in range(70):
        row, col = (int(rng.integers(0, n - 8)) for n in shape)
        high, wide = (int(n) for n in rng.integers(4, 40, 2))
        made[row : row + high, col : col + wide] = 0.0
    return made


@pytest.mark.slow
@pytest.mark.parametrize("shift", [(0, 0), (5, 3)])
def test_a_drawing_in_two_levels_is_aligned(shift: tuple[int, int]) -> None:
    down, right = shift
    whole = drawing((330, 420))
    followup = whole[down : down + 300, right : right + 400].copy()
    followup[100:112, 200:215] = 255.0 - followup[100:112, 200:215]
    found = register_images(whole[:300, :400], followup)
    y, x = np.mgrid[20:280:40, 20:380:40].astype(np.float64)
    at_y, at_x = found.pose.to_reference_px(y, x)
    away_px = np.hypot(at_y - y - down, at_x - x - right)
    assert away_px.max() < 0.1


def test_clipped_paper_is_left_out_as_long_as_enough_else_is_there() -> None:
    scene = np.clip(120 + 60 * np.random.default_rng(2).normal(size=(90, 120)), 0, 254)
    scene[:40] = 255.0
    photograph = AlignedPhotograph.of(scene)
    assert photograph.usable is not None
    assert not photograph.usable[:38].any()
    scene[:80] = 255.0
    assert AlignedPhotograph.of(scene).usable is None


MATRIX = np.array([[1.5, 0.1, -20.0], [-0.1, 1.5, 5.0], [1e-5, 0.0, 1.0]])


def test_what_is_written_is_read_back(tmp_path: Path) -> None:
    path = tmp_path / "H.json"
    written = Homography(matrix=MATRIX, size=(640, 480), distortion_k1=-0.01)
    write_homography(path, written)
    found = read_homography(path)
    np.testing.assert_array_equal(found.matrix, MATRIX)
    assert (found.size, found.distortion_k1) == ((640, 480), -0.01)
    assert json.loads(path.read_text("utf-8")) == {
        "schema": "standoff.homography/1",
        "matrix": MATRIX.tolist(),
        "size": [640, 480],
        "distortion_k1": -0.01,
        "provenance": None,
    }


def test_the_distortion_may_be_left_out(tmp_path: Path) -> None:
    path = stored(tmp_path, {})
    assert read_homography(path).distortion_k1 == 0.0


def stored(folder: Path, change: dict[str, Any]) -> Path:
    path = folder / "H.json"
    content = {"schema": "standoff.homography/1", "matrix": MATRIX.tolist(), "size": [30, 20]}
    path.write_text(json.dumps(content | change), encoding="utf-8")
    return path


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("schema", "standoff.psf/1"),
        ("matrix", [[1, 0], [0, 1]]),
        ("matrix", "unit"),
        ("matrix", [[1, 0, 0], [0, 1, 0], [0, 0, 10**400]]),
        ("matrix", [[1, 0, 0], [0, 0, 5], [0, 0, 1]]),
        ("size", 30),
        ("size.1", [30]),
        ("size.0", [0, 20]),
        ("size.1", [30, 2.5]),
        ("distortion_k1", 1),
        ("distortion_k1", None),
        ("distortion_k1", True),
        ("distortion_k1", "-0.1"),
        ("distortion_k1", 10**400),
    ],
)
def test_the_value_at_fault_is_named(tmp_path: Path, key: str, value: object) -> None:
    path = stored(tmp_path, {key.partition(".")[0]: value})
    with pytest.raises(HomographyFileError) as refused:
        read_homography(path)
    assert (refused.value.source, refused.value.key) == (str(path), key)


def test_a_matrix_cannot_be_changed_afterwards() -> None:
    homography = Homography(matrix=MATRIX, size=(640, 480))
    with pytest.raises(ValueError):
        homography.matrix[0, 0] = 2.0
    assert MATRIX.flags.writeable
