"""Alignments that no pose explains are refused with what is wrong, not returned."""

from collections.abc import Callable
from functools import cache

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from calibration.errors import RegistrationError
from calibration.registration import pair
from calibration.registration.distortion_refinement import refined_distorted_pose
from calibration.registration.features import FeatureMatches
from calibration.registration.pair import register_distorted
from calibration.registration.refinement import refined_pose
from simulation import GaussianPsf
from simulation.arrays import FloatArray
from tests.simulation.closed_form import photograph, random_scene

Refine = Callable[[FloatArray, FloatArray, FloatArray], object]

SHAPE = (120, 160)
ZOOM = 1.5
SIGMA_PX = 0.6
PSF = GaussianPsf(sigma_x_px=0.67, sigma_y_px=0.67)
MIDDLE = np.array([(SHAPE[1] - 1) / 2, (SHAPE[0] - 1) / 2])


@cache
def seen(zoom: float, seed: int = 3) -> FloatArray:
    image = photograph(random_scene(seed, 300, 300), SHAPE, zoom, SIGMA_PX)
    image.setflags(write=False)
    return image


def truth(aside_px: float = 0.0) -> FloatArray:
    """Follow-up pixels to reference pixels, both about the same middle."""
    x, y = MIDDLE * (1 - ZOOM)
    return np.array([[ZOOM, 0.0, x + aside_px], [0.0, ZOOM, y], [0.0, 0.0, 1.0]])


def by_homography(reference: FloatArray, followup: FloatArray, start: FloatArray) -> object:
    return refined_pose(reference, followup, PSF, start)


def with_distortion(reference: FloatArray, followup: FloatArray, start: FloatArray) -> object:
    return refined_distorted_pose(reference, followup, PSF, start)


EACH = pytest.mark.parametrize("refine", [by_homography, with_distortion])


@EACH
def test_a_negative_of_the_scene_is_refused(refine: Refine) -> None:
    with pytest.raises(RegistrationError) as refused:
        refine(seen(1.0), 256.0 - seen(ZOOM), truth())
    assert refused.value.reason == "unlike"


@EACH
def test_a_start_that_leaves_no_overlap_is_refused(refine: Refine) -> None:
    with pytest.raises(RegistrationError) as refused:
        refine(seen(1.0), seen(ZOOM), truth(aside_px=400.0))
    assert refused.value.reason == "little_overlap"


@EACH
def test_a_scene_drowned_in_noise_is_refused_with_the_correlation(refine: Refine) -> None:
    # Noise of twice the contrast where both overlap: a correlation of 1 / sqrt(1 + 4).
    contrast = np.std(seen(ZOOM)[20:100, 27:133])
    noisy = seen(ZOOM) + np.random.default_rng(2).normal(0, 2 * contrast, SHAPE)
    with pytest.raises(RegistrationError) as refused:
        refine(seen(1.0), noisy, truth())
    assert refused.value.reason == "low_correlation"
    # 8000 pixels: 0.01.
    assert refused.value.correlation == pytest.approx(5**-0.5, abs=0.03)


@EACH
@pytest.mark.parametrize("seed", range(70, 77))
def test_no_other_scene_is_taken_for_the_reference(refine: Refine, seed: int) -> None:
    with pytest.raises(RegistrationError) as refused:
        refine(seen(1.0), seen(ZOOM, seed), truth())
    assert refused.value.reason in ("unlike", "not_settled", "low_correlation", "no_lens")


@pytest.fixture
def matched(monkeypatch: pytest.MonkeyPatch) -> Callable[[FloatArray], None]:
    """Let the features match as a matrix says, right to 0.2 px."""

    def match(matrix: FloatArray) -> None:
        rng = np.random.default_rng(4)
        followup = rng.uniform((30, 25), (130, 95), (80, 2))
        reference = followup @ matrix[:2, :2].T + matrix[:2, 2]
        found = FeatureMatches(followup, reference + rng.normal(0, 0.2, reference.shape))
        monkeypatch.setattr(pair, "match_features", lambda *_: found)

    return match


def test_features_that_agree_with_the_pixels_are_aligned(
    matched: Callable[[FloatArray], None],
) -> None:
    matched(truth())
    found = register_distorted(seen(1.0), seen(ZOOM), PSF)
    assert found.zoom == pytest.approx(ZOOM, rel=2e-4)
    assert found.inlier_count > 70
    # 0.2 px along each axis.
    assert found.match_rms_px == pytest.approx(0.2 * np.sqrt(2), rel=0.25)


def test_features_of_a_mirror_image_are_refused(matched: Callable[[FloatArray], None]) -> None:
    mirrored = np.array([[-ZOOM, 0.0, SHAPE[1] - 1.0], [0.0, ZOOM, 0.0], [0.0, 0.0, 1.0]])
    matched(mirrored)
    with pytest.raises(RegistrationError) as refused:
        register_distorted(seen(1.0), seen(ZOOM), PSF)
    assert (refused.value.reason, refused.value.count) == ("no_common_pose", 0)


def test_features_that_contradict_the_pixels_are_refused_with_how_much(
    matched: Callable[[FloatArray], None],
) -> None:
    matched(truth(aside_px=2.5))
    with pytest.raises(RegistrationError) as refused:
        register_distorted(seen(1.0), seen(ZOOM), PSF)
    assert refused.value.reason == "contradiction"
    assert refused.value.error_px == pytest.approx(2.5, abs=0.15)


def test_a_pose_that_the_pixels_hardly_tell_is_refused_with_its_error(
    matched: Callable[[FloatArray], None],
) -> None:
    # Large soft blobs: they correlate well, but their slopes are lost in the noise.
    near, far = (gaussian_filter(seen(zoom), 8.0 / zoom) for zoom in (1.0, ZOOM))
    noise = np.random.default_rng(3).normal(0, 0.9 * np.std(far[20:100, 27:133]), SHAPE)
    matched(truth())
    with pytest.raises(RegistrationError) as refused:
        register_distorted(near, far + noise, PSF)
    assert refused.value.reason == "uncertain"
    assert refused.value.error_px is not None
    assert 0.25 < refused.value.error_px < 10
