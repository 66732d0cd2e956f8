"""A pose from matched features is one that a camera in front of the scene can have."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from calibration.errors import RegistrationError
from calibration.registration import (
    FeatureMatches,
    ImageFeatures,
    homography_pose,
    match_features,
)
from simulation.arrays import FloatArray

SHAPE = (100, 120)
POINTS = np.random.default_rng(1).uniform(0.0, 300.0, (60, 2))


def mapped(matrix: FloatArray) -> FloatArray:
    places = np.column_stack([POINTS, np.ones(len(POINTS))]) @ matrix.T
    return np.asarray(places[:, :2] / places[:, 2:])


def test_points_that_a_homography_moved_give_it_back() -> None:
    matrix = np.array([[1.4, 0.1, -20.0], [-0.1, 1.3, 5.0], [2e-4, -1e-4, 1.0]])
    found, inlier = homography_pose(FeatureMatches(followup_px=POINTS, reference_px=mapped(matrix)))
    np.testing.assert_allclose(found, matrix, rtol=1e-3, atol=1e-3)
    assert inlier.all()


@pytest.mark.parametrize(
    "matrix",
    [
        # A mirror image; and a horizon between the points, one side of it behind the camera.
        [[-1.4, 0.0, 400.0], [0.0, 1.4, 0.0], [0.0, 0.0, 1.0]],
        [[1.4, 0.0, 0.0], [0.0, 1.4, 0.0], [-1 / 150, 0.0, 1.0]],
    ],
)
def test_what_turns_the_scene_inside_out_is_refused(
    matrix: list[list[float]], monkeypatch: pytest.MonkeyPatch
) -> None:
    # OpenCV refuses most of these itself; what slips through is made to, here.
    known = np.array(matrix)
    everyone = np.ones((len(POINTS), 1), dtype=np.uint8)
    monkeypatch.setattr(cv2, "findHomography", lambda *_arguments: (known, everyone))
    matches = FeatureMatches(followup_px=POINTS, reference_px=mapped(known))
    with pytest.raises(RegistrationError) as refused:
        homography_pose(matches)
    assert refused.value.reason == "inside_out"


def test_points_without_an_order_agree_on_nothing() -> None:
    away = np.random.default_rng(2).uniform(0.0, 300.0, POINTS.shape)
    with pytest.raises(RegistrationError) as refused:
        homography_pose(FeatureMatches(followup_px=POINTS, reference_px=away))
    assert refused.value.reason == "no_common_pose"
    assert refused.value.count is not None
    assert refused.value.count < 12


@pytest.mark.parametrize("level", [0.0, 1.0])
@pytest.mark.parametrize("at_fault", ["reference", "followup"])
def test_the_image_without_detail_is_the_one_at_fault(at_fault: str, level: float) -> None:
    rng = np.random.default_rng(3)
    images = dict.fromkeys(("reference", "followup"), gaussian_filter(rng.normal(size=SHAPE), 1.5))
    # A constant or a ramp.
    images[at_fault] = np.full(SHAPE, 50.0) + level * np.arange(SHAPE[1])
    with pytest.raises(RegistrationError) as refused:
        match_features(**images)
    error = refused.value
    assert (error.reason, error.at_fault, error.count) == ("no_detail", at_fault, 0)


@pytest.mark.parametrize("allowed", [1.0, 0.3, 0.004])
def test_the_two_nearest_descriptors_are_those_that_opencv_finds(allowed: float) -> None:
    rng = np.random.default_rng(3)
    near, far = (
        ImageFeatures(
            points_px=np.zeros((count, 2)),
            # Whole numbers up to 255, of a length of 512 as a rule, as SIFT has them.
            descriptors=rng.integers(0, 80, (count, 128)).astype(np.float32),
            frames=np.ones((count, 2)),
            shape=SHAPE,
        )
        for count in (300, 700)
    )
    mask = (rng.random((700, 300)) < allowed).astype(np.uint8)
    found = near.nearest_to(far, mask)
    expected = cv2.BFMatcher(cv2.NORM_L2).knnMatch(far.descriptors, near.descriptors, 2, mask)
    for number, matches in enumerate(expected):
        count = len(matches)
        np.testing.assert_array_equal(
            found.distances[number, :count], [one.distance for one in matches]
        )
        assert np.isinf(found.distances[number, count:]).all()
        assert found.numbers[number, :count].tolist() == [one.trainIdx for one in matches]


def test_a_sample_that_opencv_cannot_solve_is_no_pose(monkeypatch: pytest.MonkeyPatch) -> None:
    def raising(*_: object) -> object:
        raise cv2.error("!model.empty() in function 'setModelParameters'")

    monkeypatch.setattr(cv2, "findHomography", raising)
    with pytest.raises(RegistrationError) as refused:
        homography_pose(FeatureMatches(followup_px=POINTS, reference_px=POINTS))
    assert refused.value.reason == "no_common_pose"
