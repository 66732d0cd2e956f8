"""Alignments that nothing confirms are refused with what is wrong, warned of or left to a hint."""

from functools import cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from calibration.errors import RegistrationError
from calibration.registration import (
    FeatureMatches,
    Registration,
    RegistrationHints,
    register_images,
)
from simulation import GaussianPsf
from simulation.arrays import FloatArray
from tests.simulation.closed_form import photograph, random_scene

SHAPE = (120, 160)
ZOOM = 1.5
SIGMA_PX = 0.6
PSF = GaussianPsf(sigma_x_px=0.67, sigma_y_px=0.67)
MIDDLE = np.array([(SHAPE[1] - 1) / 2, (SHAPE[0] - 1) / 2])
REMEDIES = ("--expect-zoom", "--homography", "--points", "--mask")


@cache
def seen(zoom: float, seed: int = 3) -> FloatArray:
    image = photograph(random_scene(seed, 300, 300), SHAPE, zoom, SIGMA_PX)
    image.setflags(write=False)
    return image


def truth(aside_px: float = 0.0) -> FloatArray:
    """Follow-up pixels to reference pixels, both about the same middle."""
    x, y = MIDDLE * (1 - ZOOM)
    return np.array([[ZOOM, 0.0, x + aside_px], [0.0, ZOOM, y], [0.0, 0.0, 1.0]])


def error_px(found: Registration) -> float:
    y, x = np.mgrid[20:100:20, 30:130:20].astype(np.float64)
    at_y, at_x = found.pose.to_reference_px(y, x)
    true = truth()
    away = np.hypot(at_x - (ZOOM * x + true[0, 2]), at_y - (ZOOM * y + true[1, 2]))
    return float(away.max())


def texture(shape: tuple[int, int], seed: int, sigma_px: float = 1.5) -> FloatArray:
    made = gaussian_filter(np.random.default_rng(seed).normal(size=shape), sigma_px, mode="wrap")
    return np.asarray(120 + 25 * made / made.std())


@pytest.mark.slow
def test_a_negative_of_the_scene_is_refused() -> None:
    with pytest.raises(RegistrationError):
        register_images(seen(1.0), 256.0 - seen(ZOOM), PSF)


@pytest.mark.slow
def test_no_other_scene_is_taken_for_the_reference() -> None:
    with pytest.raises(RegistrationError) as refused:
        register_images(seen(1.0), seen(ZOOM, 70), PSF)
    assert refused.value.reason in ("low_correlation", "little_overlap")
    assert all(one in str(refused.value) for one in REMEDIES)


@pytest.mark.parametrize("at_fault", ["reference", "followup"])
def test_a_photograph_without_detail_is_the_one_at_fault(at_fault: str) -> None:
    images = {"reference": seen(1.0), "followup": seen(ZOOM), at_fault: np.full(SHAPE, 50.0)}
    with pytest.raises(RegistrationError) as refused:
        register_images(images["reference"], images["followup"])
    assert (refused.value.reason, refused.value.at_fault) == ("no_detail", at_fault)


def test_points_that_are_right_to_some_pixels_are_refined() -> None:
    followup = np.array([[30.0, 20], [130, 25], [125, 95], [35, 100], [80, 60]])
    reference = followup @ truth()[:2, :2].T + truth()[:2, 2]
    rough = FeatureMatches(followup, reference + np.random.default_rng(4).normal(0, 1.5, (5, 2)))
    found = register_images(seen(1.0), seen(ZOOM), PSF, RegistrationHints(points=rough))
    assert error_px(found) < 0.03
    assert not found.warnings


def test_a_pose_that_is_right_to_some_pixels_is_refined() -> None:
    hint = RegistrationHints(matrix=truth(aside_px=3.0))
    assert error_px(register_images(seen(1.0), seen(ZOOM), PSF, hint)) < 0.03


def test_a_given_pose_that_the_pixels_contradict_is_kept_with_a_warning() -> None:
    hint = RegistrationHints(matrix=truth())
    found = register_images(seen(1.0), seen(ZOOM, 70), PSF, hint)
    np.testing.assert_array_equal(found.matrix, truth())
    assert "kept as it is" in found.warnings[0]


def test_a_given_pose_without_overlap_is_refused() -> None:
    with pytest.raises(RegistrationError) as refused:
        register_images(seen(1.0), seen(ZOOM), PSF, RegistrationHints(matrix=truth(aside_px=900.0)))
    assert refused.value.reason == "little_overlap"


@pytest.mark.slow
def test_detail_on_a_rim_alone_that_tells_no_pose_is_refused() -> None:
    drawn = np.random.default_rng(0).normal(size=(120, 160)).cumsum(axis=1)
    rim = np.where(np.arange(160) < 150, 100.0, np.clip(128 + 5 * drawn, 0, 255))
    with pytest.raises(RegistrationError) as refused:
        register_images(rim, rim.copy())
    assert refused.value.reason == "uncertain"


@pytest.mark.slow
def test_a_tiled_scene_is_warned_of() -> None:
    scene = np.tile(texture((60, 60), 5), (4, 5))
    found = register_images(scene[:180, :240], scene[7:187, 11:251])
    assert any("repeats" in one for one in found.warnings)


@pytest.mark.slow
@pytest.mark.parametrize("periods", [-2, 1])
def test_of_several_periods_the_given_pose_chooses_one(periods: int) -> None:
    scene = np.tile(texture((60, 60), 5), (6, 7))
    true = np.array([[1.0, 0.0, 11 + 60 * periods], [0.0, 1.0, 7.0], [0.0, 0.0, 1.0]])
    near = true.copy()
    near[:2, 2] += 2.0
    hint = RegistrationHints(matrix=near)
    found = register_images(scene[:240, :320], scene[7:247, 11:331], hints=hint)
    np.testing.assert_allclose(found.matrix, true, atol=0.05)


def test_what_is_left_out_does_not_count() -> None:
    scene = texture((260, 340), 6)
    reference, followup = scene[:240, :320], scene[9:249, 13:333].copy()
    covered = np.zeros(followup.shape, dtype=np.bool_)
    covered[:, :150] = True
    # Another scene moves along with the camera there.
    followup[covered] = reference[covered]
    found = register_images(reference, followup, hints=RegistrationHints(left_out=covered))
    np.testing.assert_allclose(found.matrix, [[1, 0, 13], [0, 1, 9], [0, 0, 1]], atol=0.02)


def test_a_mask_of_another_shape_is_an_error() -> None:
    with pytest.raises(ValueError):
        register_images(
            seen(1.0), seen(ZOOM), hints=RegistrationHints(left_out=np.zeros((3, 4), bool))
        )


@pytest.mark.parametrize(
    "hints",
    [
        {"zoom": 0.0},
        {"zoom": float("nan")},
        {"matrix": np.zeros((3, 3))},
        {"matrix": np.eye(2)},
        {"points": FeatureMatches(np.zeros((3, 2)), np.zeros((3, 2)))},
    ],
)
def test_hints_that_cannot_be_are_errors(hints: dict[str, object]) -> None:
    with pytest.raises(ValueError):
        RegistrationHints(**hints)  # type: ignore[arg-type]


def test_little_contrast_in_much_noise_is_aligned() -> None:
    rng = np.random.default_rng(8)
    scene = 120 + 6 * (texture((260, 340), 9, 3.0) - 120) / 25
    near, far = (
        np.rint(scene[top : top + 240, left : left + 320] + rng.normal(0, 2.5, (240, 320)))
        for top, left in ((0, 0), (9, 13))
    )
    found = register_images(near, far)
    y, x = np.mgrid[20:220:20, 20:300:20].astype(np.float64)
    at_y, at_x = found.pose.to_reference_px(y, x)
    error = float(np.sqrt(np.mean((at_y - y - 9) ** 2 + (at_x - x - 13) ** 2)))
    # One draw of eight figures: within a factor of 3.
    assert error < 3 * found.place_err_px
    assert found.place_err_px < 0.3


@pytest.mark.slow
def test_gain_and_offset_do_not_matter() -> None:
    plain = register_images(seen(1.0), seen(ZOOM), PSF).matrix
    other = register_images(3.0 * seen(1.0) - 40, 0.2 * seen(ZOOM) + 7, PSF).matrix
    np.testing.assert_allclose(other, plain, atol=0.01)


@pytest.mark.parametrize("shape", [(2, 2), (3, 3), (1, 400), (15, 200)])
def test_a_photograph_of_a_few_pixels_has_no_detail(shape: tuple[int, int]) -> None:
    few = texture(shape, 3)
    with pytest.raises(RegistrationError) as refused:
        register_images(seen(1.0), few)
    assert (refused.value.reason, refused.value.at_fault) == ("no_detail", "followup")
    with pytest.raises(RegistrationError) as refused:
        register_images(few, seen(1.0))
    assert (refused.value.reason, refused.value.at_fault) == ("no_detail", "reference")
