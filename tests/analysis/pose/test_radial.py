"""Another lens's radial term, from corners whose places follow from a closed form."""

import numpy as np
import pytest

from analysis.pose import RadialTerm, straightened
from calibration.registration import TrackedPose
from simulation.arrays import FloatArray

SHAPE = (480, 640)
MATRIX = np.array([[1.06, 0.03, -9.0], [-0.02, 1.05, 4.0], [2e-5, -3e-5, 1.0]])


def pose(
    k1: float, seed: int = 1, noise_px: float = 0.2, matrix: FloatArray = MATRIX
) -> TrackedPose:
    """Corners as a lens sees them whose radii grow by ``1 + k1 r**2``."""
    rng = np.random.default_rng(seed)
    straight = rng.uniform((20, 20), (619, 459), (90, 2))
    moved = np.column_stack((straight, np.ones(90))) @ matrix.T
    middle = np.array([319.5, 239.5])
    aside = straight - middle
    seen = middle + aside * (1 + k1 * np.sum(aside**2, axis=1, keepdims=True) / (middle @ middle))
    seen = seen + noise_px * rng.standard_normal(seen.shape)
    reference = moved[:, :2] / moved[:, 2:]
    found, _ = _fitted(seen, reference)
    return TrackedPose(
        matrix=found, zoom=1.05, inlier_count=90, rms_px=0.3, frame_px=seen, reference_px=reference
    )


def _fitted(seen: FloatArray, reference: FloatArray) -> tuple[FloatArray, FloatArray]:
    """The homography of least squares, by the direct linear transform."""
    rows = []
    for (x, y), (u, v) in zip(seen, reference, strict=True):
        rows += [[x, y, 1, 0, 0, 0, -u * x, -u * y, -u], [0, 0, 0, x, y, 1, -v * x, -v * y, -v]]
    _, values, right = np.linalg.svd(np.array(rows))
    return right[-1].reshape(3, 3) / right[-1, -1], values


@pytest.mark.parametrize("k1", [-0.05, -0.01, 0.01, 0.05])
def test_the_term_is_found_and_taken_out_of_the_pose(k1: float) -> None:
    term = RadialTerm()
    poses = [pose(k1, seed) for seed in range(4)]
    for one in poses:
        term.add(one, SHAPE)
    assert term.k1 == pytest.approx(k1, rel=0.15)  # to first order in k1
    found = term.without(poses[0], SHAPE)
    corners = np.array([[0, 639, 639, 0], [0, 0, 479, 479], [1, 1, 1, 1]])
    expected, bent, straight = (
        (one @ corners)[:2] / (one @ corners)[2] for one in (MATRIX, poses[0].matrix, found)
    )
    off = [np.abs(one - expected).max() for one in (bent, straight)]
    assert off[1] < 0.6  # of corners that are known to .2 px
    assert off[0] > 2 * off[1]


def test_the_same_lens_is_taken_for_the_same(subtests: pytest.Subtests) -> None:
    for number in range(40):
        with subtests.test(seed=number):
            term = RadialTerm()
            assert term.k1 == 0
            one = pose(0.0, number)
            term.add(one, SHAPE)
            assert term.k1 == 0
            assert term.without(one, SHAPE) is one.matrix


def test_a_straightened_frame_has_what_the_lens_moved_back_in_its_place() -> None:
    y, x = np.mgrid[:480, :640]
    dot = (600.0, 440.0)
    aside = np.array(dot) - (319.5, 239.5)
    seen = np.array((319.5, 239.5)) + aside * (1 + 0.03 * (aside @ aside) / (319.5**2 + 239.5**2))
    frame = 255 * np.exp(-((x - seen[0]) ** 2 + (y - seen[1]) ** 2) / 18)
    made = straightened(np.rint(frame).astype(np.uint8), 0.03).astype(float)
    assert (made * x).sum() / made.sum() == pytest.approx(dot[0], abs=0.1)
    assert (made * y).sum() / made.sum() == pytest.approx(dot[1], abs=0.1)
    assert straightened(np.zeros((3, 4), np.uint8), 0.0).shape == (3, 4)
