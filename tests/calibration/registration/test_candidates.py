"""Features that are found again where a weakly founded pose puts them confirm or correct it.

A photograph and the mirror image of another are told from photographs of one scene.

Mirroring is exact: the columns or the rows of an array in reverse.
"""

from dataclasses import replace

import numpy as np
import pytest

from calibration.errors import RegistrationError
from calibration.registration import (
    Agreement,
    AlignedPhotograph,
    DistortedPose,
    FeatureMatches,
    RefinedPose,
    RegistrationHints,
    _candidates as candidates_module,
    _pair as pair_module,
    block_votes,
    register_images,
)
from calibration.registration._candidates import (
    ELSEWHERE_MOST,
    Candidate,
    Choice,
    PhotographPair,
    looked_again,
    second_look,
)
from calibration.registration._distorted_pose import SmoothDisplacement
from calibration.registration._features import features_of
from calibration.registration._hypotheses import PoseHypothesis
from calibration.registration._refinement import _PlaceErrors
from simulation.arrays import FloatArray
from tests.calibration.known import known
from tests.calibration.registration.test_any_two import (
    Waves,
    error_px,
    middle,
    placed,
    similarity,
    waves,
)

SHAPE = (240, 320)
TRUE = similarity(1.3, 10.0, (middle(SHAPE), middle(SHAPE)), 2e-4)


def candidate(matrix: FloatArray) -> tuple[PhotographPair, Candidate]:
    """A pose that nothing speaks for, of a scene with many details."""
    scene = waves(4, 0.01, 0.12)
    pair = PhotographPair(
        reference=AlignedPhotograph.of(scene.seen(np.eye(3), SHAPE)),
        followup=AlignedPhotograph.of(scene.seen(TRUE, SHAPE)),
        psf=None,
    )
    agreement = Agreement(
        correlation=0.5,
        significance=11.0,
        overlap_px=10_000,
        overlap=0.8,
        rival_correlation=0.1,
        rival_shift_px=(30.0, 0.0),
    )
    return pair, Candidate(
        hypothesis=PoseHypothesis(matrix=matrix),
        directed=pair.directed(pair.pose_of(matrix)),
        agreement=agreement,
    )


def off(by_px: float) -> FloatArray:
    """The true pose with a perspective that moves the corners by so much, and them alone."""
    lean = np.eye(3)
    lean[2, 0] = by_px / 160 / 320
    back = np.eye(3)
    back[:2, 2] = middle(SHAPE)
    return np.asarray(TRUE @ back @ lean @ np.linalg.inv(back))


def test_a_pose_that_is_some_pixels_off_is_corrected() -> None:
    pair, weak = candidate(off(12.0))
    assert error_px(weak.directed.of_followup, TRUE) > 2
    better = looked_again(pair, weak)
    assert error_px(better.directed.of_followup, TRUE) < 0.3
    assert better.hypothesis.match_count >= 20


def test_matches_say_how_far_details_lie_from_where_a_pose_puts_them() -> None:
    _, true = candidate(TRUE)
    look = known(second_look(true.directed))
    own_px = known(look.displacement_px(true.directed.pose))
    assert own_px < 0.5
    aside = TRUE.copy()
    aside[:2, 2] += 9.0
    off_px = look.displacement_px(candidate(aside)[1].directed.pose)
    # About 9 px along both axes of the reference, of which 1.3 are one of the follow-up.
    assert off_px == pytest.approx(9 * 2**0.5 / 1.3, abs=0.6)


@pytest.mark.parametrize(
    ("significances", "looked_at"),
    [
        ({8: 4.0, 4: 8.0, 2: 14.0, 1: 22.0}, [8, 4, 2, 1]),  # it grows as with a true pose
        ({8: 4.0, 4: 4.4, 2: 20.0, 1: 20.0}, [8, 4]),  # chance: a closer look shows no more
        ({8: 4.0, 4: 2.0, 2: 20.0, 1: 20.0}, [8, 4]),
        ({8: 3.0, 4: 20.0, 2: 20.0, 1: 20.0}, [8]),  # nothing speaks for a closer look
    ],
)
def test_a_closer_look_ends_where_it_shows_no_more_than_the_one_before(
    monkeypatch: pytest.MonkeyPatch, significances: dict[int, float], looked_at: list[int]
) -> None:
    pair, found = candidate(TRUE)
    looked: list[int] = []

    def judged_at(*arguments: object) -> Candidate:
        factors = arguments[-1]
        assert isinstance(factors, list)
        looked.append(factors[-1])
        agreement = replace(found.agreement, significance=significances[factors[-1]])
        return replace(found, agreement=agreement)

    monkeypatch.setattr(candidates_module, "_refined_and_judged", judged_at)
    monkeypatch.setattr(candidates_module, "comparison_factor", lambda _: 8)
    candidates_module._judged(pair, PoseHypothesis(matrix=TRUE))
    assert list(dict.fromkeys(looked)) == looked_at


def test_blocks_are_recognised_where_the_true_pose_puts_them_and_beside_another() -> None:
    _, true = candidate(TRUE)
    here = block_votes(*true.directed.photographs, true.directed.pose)
    assert here.here > 30
    assert here.share_elsewhere < 0.05
    # The corners are 24 px off, the middle is not.
    _, wrong = candidate(off(24.0))
    elsewhere = block_votes(*wrong.directed.photographs, wrong.directed.pose)
    assert elsewhere.share_elsewhere > ELSEWHERE_MOST


def test_noise_hides_blocks_and_moves_none() -> None:
    rng, scene = np.random.default_rng(3), waves(4, 0.01, 0.12)
    near, far = (
        AlignedPhotograph.of(scene.seen(one, SHAPE) + rng.normal(0, 60, SHAPE))
        for one in (np.eye(3), TRUE)
    )
    _, true = candidate(TRUE)
    votes = block_votes(near, far, true.directed.pose)
    assert votes.share_elsewhere < 0.1


def test_a_pose_that_outlines_alone_agree_with_is_refused() -> None:
    pair, wrong = candidate(off(24.0))
    # As if the refinement had been drawn there.
    refined = RefinedPose(
        pose=wrong.directed.pose,
        errors=_PlaceErrors(place_err_px=0.05, k1_err=0.0),
        correlation=0.98,
        residual_rms=0.1,
    )
    with pytest.raises(RegistrationError) as refused:
        pair_module._refined(pair, Choice(best=wrong), refined)
    assert refused.value.reason == "contradiction"


SMALL = (180, 240)
ROWS, COLS = SMALL
TRUE_MIRRORED = similarity(1.12, 4.0, (middle(SMALL), middle(SMALL) + np.array([5.0, -3.0])))
FLIPS = {
    "columns": np.array([[-1.0, 0.0, COLS - 1], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]),
    "rows": np.array([[1.0, 0.0, 0.0], [0.0, -1.0, ROWS - 1], [0.0, 0.0, 1.0]]),
}


def scene() -> Waves:
    return waves(3, 0.01, 0.12)


def pair(flip: str | None = None) -> tuple[FloatArray, FloatArray]:
    """The scene and, from another pose, the scene or its mirror image; noise of 3 DN."""
    rng = np.random.default_rng(7)
    near, far = scene().seen(np.eye(3), SMALL), scene().seen(TRUE_MIRRORED, SMALL)
    if flip is not None:
        far = far[:, ::-1] if flip == "columns" else far[::-1]
    return near + rng.normal(0, 3, SMALL), far + rng.normal(0, 3, SMALL)


@pytest.mark.slow
@pytest.mark.parametrize("flip", FLIPS)
def test_a_mirrored_photograph_is_refused_in_one_line_with_the_remedy(flip: str) -> None:
    with pytest.raises(RegistrationError) as refused:
        register_images(*pair(flip))
    assert refused.value.reason == "mirrored"
    said = str(refused.value)
    assert "mirrored" in said
    assert "--mirrored" in said
    assert "\n" not in said


@pytest.mark.slow
@pytest.mark.parametrize("flip", FLIPS)
def test_said_to_be_mirrored_it_is_aligned_by_its_true_pose(flip: str) -> None:
    found = register_images(*pair(flip), hints=RegistrationHints(mirrored=True))
    assert error_px(found.pose, TRUE_MIRRORED @ FLIPS[flip]) < 0.1
    assert np.linalg.det(found.matrix) < 0
    assert found.zoom == pytest.approx(1.12, abs=0.005)
    assert not found.warnings


@pytest.mark.slow
def test_a_mirrored_pose_leads_back_where_it_came_from() -> None:
    pose = register_images(*pair("columns"), hints=RegistrationHints(mirrored=True)).pose
    y, x = np.mgrid[:ROWS:30, :COLS:30].astype(np.float64)
    there = pose.to_reference_px(y, x)
    np.testing.assert_allclose(pose.to_followup_px(*there), (y, x), atol=1e-6)
    assert pose.inverse().zoom == pytest.approx(1 / pose.zoom, rel=1e-3)


@pytest.mark.slow
def test_what_is_not_mirrored_but_said_to_be_is_refused() -> None:
    with pytest.raises(RegistrationError) as refused:
        register_images(*pair(), hints=RegistrationHints(mirrored=True))
    assert refused.value.reason == "not_mirrored"
    assert "leave out --mirrored" in str(refused.value)


def test_what_is_not_mirrored_is_aligned_as_ever() -> None:
    assert error_px(register_images(*pair()).pose, TRUE_MIRRORED) < 0.1


@pytest.mark.parametrize("is_told", [False, True])
def test_a_scene_that_is_its_own_mirror_image_is_no_mirrored_pair(is_told: bool) -> None:
    half, rng = scene().seen(np.eye(3), SMALL), np.random.default_rng(8)
    whole = half + half[:, ::-1]
    near, far = whole + rng.normal(0, 3, SMALL), whole + rng.normal(0, 3, SMALL)
    found = register_images(near, far, hints=RegistrationHints(mirrored=is_told))
    assert error_px(found.pose, FLIPS["columns"] if is_told else np.eye(3)) < 0.1


def test_a_given_pose_that_is_mirrored_is_refused_unless_that_is_said() -> None:
    matrix = TRUE_MIRRORED @ FLIPS["columns"]
    matrix[:2, 2] += 2.0
    images = pair("columns")
    with pytest.raises(RegistrationError, match="--mirrored") as refused:
        register_images(*images, hints=RegistrationHints(matrix=matrix))
    assert refused.value.reason == "mirrored"
    found = register_images(*images, hints=RegistrationHints(matrix=matrix, mirrored=True))
    assert error_px(found.pose, TRUE_MIRRORED @ FLIPS["columns"]) < 0.1


def test_a_given_pose_that_is_not_mirrored_contradicts_that_it_is() -> None:
    with pytest.raises(RegistrationError) as refused:
        register_images(
            *pair("columns"), hints=RegistrationHints(matrix=TRUE_MIRRORED, mirrored=True)
        )
    assert refused.value.reason == "not_mirrored"


def test_points_of_a_mirrored_pair_are_refused_unless_that_is_said() -> None:
    true = TRUE_MIRRORED @ FLIPS["rows"]
    followup = np.array([[30.0, 20], [200, 25], [190, 150], [35, 140], [100, 80]])
    there = np.round(np.stack(placed(true, *followup.T), axis=1)).astype(np.float64)
    points = FeatureMatches(followup, there)
    images = pair("rows")
    with pytest.raises(RegistrationError) as refused:
        register_images(*images, hints=RegistrationHints(points=points))
    assert refused.value.reason == "mirrored"
    found = register_images(*images, hints=RegistrationHints(points=points, mirrored=True))
    assert error_px(found.pose, true) < 0.1


def test_a_mask_is_that_of_the_follow_up_as_it_is() -> None:
    near, far = pair("columns")
    covered = np.zeros(SMALL, dtype=np.bool_)
    covered[:, :100] = True
    # Another scene moves along with the camera there.
    far[covered] = waves(9, 0.01, 0.12).seen(np.eye(3), SMALL)[covered]
    hints = RegistrationHints(left_out=covered, mirrored=True)
    assert (
        error_px(register_images(near, far, hints=hints).pose, TRUE_MIRRORED @ FLIPS["columns"])
        < 0.1
    )


@pytest.mark.parametrize("photograph", ["reference", "followup", None])
def test_a_pose_of_the_mirror_image_takes_its_pixels_where_the_others_went(
    photograph: str | None,
) -> None:
    knots = np.random.default_rng(1).normal(0, 2, (2, 5, 6))
    bend = (
        SmoothDisplacement(knots_px=knots, shape=SMALL, photograph=photograph)  # type: ignore[arg-type]
        if photograph
        else None
    )
    pose = DistortedPose(
        matrix=similarity(1.1, 20.0, (middle(SMALL), middle(SMALL)), 3e-4),
        k1=-0.03,
        reference_shape=SMALL,
        followup_shape=SMALL,
        displacement=bend,
    )
    pose = replace(pose, matrix=pose.matrix / pose.matrix[2, 2])
    y, x = np.mgrid[:ROWS:20, :COLS:20].astype(np.float64)
    there = pose.mirrored().to_reference_px(y, COLS - 1 - x)
    np.testing.assert_allclose(there, pose.to_reference_px(y, x), atol=1e-8)
    again = pose.mirrored().mirrored().to_reference_px(y, x)
    np.testing.assert_allclose(again, pose.to_reference_px(y, x), atol=1e-8)


def test_features_of_the_mirror_image_are_the_mirrored_features() -> None:
    image = scene().seen(np.eye(3), SMALL).astype(np.float32)
    made = features_of(image).mirrored()
    seen = features_of(np.ascontiguousarray(image[:, ::-1]))
    pairs = seen.pairs_with(made, 0.6)
    assert len(pairs) > 0.8 * len(seen.points_px)
    apart = made.points_px[pairs[:, 0]] - seen.points_px[pairs[:, 1]]
    # A quarter of a pixel: SIFT doubles the image first, whose grid the mirror moves.
    assert np.mean(np.hypot(*apart.T) < 0.25) > 0.9
