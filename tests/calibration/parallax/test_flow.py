"""Optical flow beside a plane: what is displaced by a known amount is found there, and no more."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.parallax._flow import matches_of_flow
from calibration.parallax._views import AlignedViews
from calibration.registration import DistortedPose
from simulation.arrays import FloatArray

FRAME = (160, 200)
PLATE, BY = np.s_[60:110, 70:140], (6, -4)
"""What is displaced, and by how much: to the right, and down."""

POSE = DistortedPose(
    matrix=np.array([[1.0, 0, 11], [0, 1, -7], [0, 0, 1]]),
    k1=0.0,
    reference_shape=FRAME,
    followup_shape=FRAME,
)
"""The source's pixels lie so far from the target's."""


def waves(seed: int) -> FloatArray:
    rng = np.random.default_rng(seed)
    y, x = np.indices(FRAME)
    u, v = rng.uniform(-0.7, 0.7, (2, 30))
    at = rng.uniform(0, 2 * np.pi, 30)
    return np.asarray(
        np.cos(u[:, None, None] * x + v[:, None, None] * y + at[:, None, None]).sum(0) / 5
    )


def views_of(target: FloatArray, source: FloatArray) -> AlignedViews:
    whole = np.ones(target.shape, dtype=np.bool_)
    return AlignedViews(
        target=target.astype(np.float32),
        source=source.astype(np.float32),
        is_target=whole,
        is_source=whole,
        to_x=np.zeros(target.shape, dtype=np.float32),
        to_y=np.zeros(target.shape, dtype=np.float32),
    )


def with_plate() -> tuple[FloatArray, FloatArray]:
    """A ground that stays, and a part that is displaced."""
    target, source = waves(1), waves(1)
    target[PLATE] = waves(2)[PLATE]
    rows, cols = PLATE
    right, down = BY
    source[rows.start + down : rows.stop + down, cols.start + right : cols.stop + right] = target[
        PLATE
    ]
    return target, source


def displaced_px(own: FloatArray, other: FloatArray) -> FloatArray:
    """How far matches are from where the plane has them."""
    return np.asarray(other - own - np.array([11, -7]))


@pytest.mark.parametrize("factor", [1, 2])
def test_a_plate_is_found_where_it_lies_and_the_ground_where_the_plane_has_it(factor: int) -> None:
    views = views_of(*with_plate())
    found = matches_of_flow(views, factor, POSE)
    # Pixels of the matching are so many of the photograph's, in which the pose is.
    own = (found.followup_px + 0.5) / factor - 0.5
    away = displaced_px(found.followup_px, found.reference_px) / factor
    rows, cols = PLATE
    x, y = own.T
    inner = (x > cols.start + 8) & (x < cols.stop - 8) & (y > rows.start + 8) & (y < rows.stop - 8)
    assert np.count_nonzero(inner) > 50
    np.testing.assert_allclose(np.median(away[inner], axis=0), BY, atol=0.1)
    assert np.mean(np.hypot(*(away[inner] - BY).T) < 0.5) > 0.9
    far = (
        (x < cols.start - 25) | (x > cols.stop + 25) | (y < rows.start - 25) | (y > rows.stop + 25)
    )
    assert np.count_nonzero(far) > 200
    assert np.mean(np.hypot(*away[far].T) < 0.3) > 0.98


def test_what_only_one_photograph_shows_has_no_match() -> None:
    target, source = with_plate()
    views = views_of(target, source)
    hole = np.ones(FRAME, dtype=np.bool_)
    hole[:, 150:] = False
    found = matches_of_flow(replace(views, is_source=hole), 1, POSE)
    assert found.followup_px[:, 0].max() < 150


def test_there_are_at_most_a_few_thousand() -> None:
    found = matches_of_flow(views_of(waves(1), waves(1)), 1, POSE)
    assert 1000 < len(found.followup_px) < 4000
    np.testing.assert_allclose(displaced_px(found.followup_px, found.reference_px), 0, atol=1e-3)
