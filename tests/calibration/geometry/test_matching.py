"""Which captures of a target hang together, on scenes whose photographs have a closed form."""

from functools import cache

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.geometry.matching import match_series
from tests.simulation.closed_form import photograph, random_scene

FloatArray = NDArray[np.float64]

SHAPE = (200, 260)
FOCAL_PX = 400.0


@cache
def view(zoom: float, middle_x_px: float, seed: int = 3) -> FloatArray:
    """The scene from ``zoom`` times as far away, over a place ``middle_x_px`` beside its middle."""
    corner = (-zoom * (SHAPE[0] - 1) / 2, middle_x_px - zoom * (SHAPE[1] - 1) / 2)
    return photograph(random_scene(seed, 900, 1500), SHAPE, zoom, 0.6, corner)


def test_two_places_that_only_a_third_capture_shows_both_hang_together() -> None:
    # The first two see 290 px apart: no common point. The third sees both from twice as far.
    found = match_series([view(1.0, -145.0), view(1.05, 145.0), view(2.2, 0.0)], FOCAL_PX)
    assert found.kept == (0, 1, 2)
    assert found.refused == {}
    assert [(part.capture, part.other) for part in found.matches] == [(2, 0), (2, 1)]
    # Features are right to half a pixel; a third of a frame carries them on to its middle.
    zooms = np.exp([pose.log_distance for pose in found.poses])
    np.testing.assert_allclose(zooms, [1.0, 1.05, 2.2], rtol=0.02)
    # Places on the target, in units of the first one's distance.
    expected = (np.array([-145.0, 145.0, 0.0]) + 145.0) / FOCAL_PX
    np.testing.assert_allclose([pose.x for pose in found.poses], expected, atol=5.0 / FOCAL_PX)
    np.testing.assert_allclose([pose.y for pose in found.poses], 0.0, atol=5.0 / FOCAL_PX)
    np.testing.assert_allclose([pose.turn_rad for pose in found.poses], 0.0, atol=0.02)


@pytest.mark.parametrize("blank", [0, 1, 2])
def test_a_capture_without_detail_is_told_so_and_its_neighbours_are_kept(blank: int) -> None:
    images = [view(zoom, 0.0) for zoom in (1.0, 1.2, 1.5)]
    images[blank] = 100.0 + np.tile(np.arange(SHAPE[1], dtype=np.float64), (SHAPE[0], 1))
    found = match_series(images, FOCAL_PX)
    assert found.kept == tuple(place for place in range(3) if place != blank)
    assert list(found.refused) == [blank]
    assert found.refused[blank].startswith("it has only")


def test_where_no_two_belong_together_all_are_refused() -> None:
    found = match_series([view(1.0, 0.0), view(1.2, 0.0, seed=77)], FOCAL_PX)
    assert sorted(found.refused) == [0, 1]
    assert found.matches == ()
