"""Which captures of a target hang together, on scenes whose photographs have a closed form."""

from functools import cache

import numpy as np
import pytest

from calibration.geometry import GeometryCapture, PlaneLens
from calibration.geometry._matching import _match_textures, _MatchedSeries
from simulation.arrays import FloatArray
from tests.simulation.closed_form import photograph, random_scene

SHAPE = (200, 260)
FOCAL_PX = 400.0
LENS = PlaneLens(width_px=SHAPE[1], height_px=SHAPE[0], focal_length_px=FOCAL_PX)


@cache
def view(zoom: float, middle_x_px: float, seed: int = 3) -> FloatArray:
    """The scene from ``zoom`` times as far away, over a place ``middle_x_px`` beside its middle."""
    corner = (-zoom * (SHAPE[0] - 1) / 2, middle_x_px - zoom * (SHAPE[1] - 1) / 2)
    return photograph(random_scene(seed, 900, 1500), SHAPE, zoom, 0.6, corner)


def matched(*images: FloatArray) -> tuple[_MatchedSeries, list[GeometryCapture]]:
    captures = [
        GeometryCapture(
            name=str(n), kind="texture", target="t", orientation_deg=0.0, height_mm=n, image=image
        )
        for n, image in enumerate(images)
    ]
    return _match_textures(captures, LENS), captures


@pytest.mark.slow
def test_two_places_that_only_a_third_capture_shows_both_hang_together() -> None:
    # The first two see 290 px apart: no common point. The third sees both from twice as far.
    found, captures = matched(view(1.0, -145.0), view(1.05, 145.0), view(2.2, 0.0))
    assert found.series is not None
    assert [one.capture for one in found.series.captures] == captures
    assert found.exclusions == ()
    first, second, third = captures
    assert [(part.capture, part.other) for part in found.matches] == [
        (third, first),
        (third, second),
    ]
    poses = [one.pose for one in found.series.captures]
    # Features are right to half a pixel; a third of a frame carries them on to its middle.
    np.testing.assert_allclose([pose.distance for pose in poses], [1.0, 1.05, 2.2], rtol=0.02)
    # Places on the target, in units of the first one's distance.
    expected = (np.array([-145.0, 145.0, 0.0]) + 145.0) / FOCAL_PX
    np.testing.assert_allclose([pose.x for pose in poses], expected, atol=5.0 / FOCAL_PX)
    np.testing.assert_allclose([pose.y for pose in poses], 0.0, atol=5.0 / FOCAL_PX)
    np.testing.assert_allclose([pose.turn_rad for pose in poses], 0.0, atol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("blank", [0, 1, 2])
@pytest.mark.parametrize("level", [0.0, 1.0])
def test_a_capture_without_detail_is_told_so_and_its_neighbours_are_kept(
    blank: int, level: float
) -> None:
    images = [view(zoom, 0.0) for zoom in (1.0, 1.2, 1.5)]
    images[blank] = 100.0 + level * np.tile(np.arange(SHAPE[1], dtype=np.float64), (SHAPE[0], 1))
    found, captures = matched(*images)
    assert found.series is not None
    kept = [one.capture for one in found.series.captures]
    assert kept == [capture for n, capture in enumerate(captures) if n != blank]
    [excluded] = found.exclusions
    assert excluded.capture is captures[blank]
    assert excluded.reason.startswith("it has only 0 features")


@pytest.mark.slow
def test_where_no_two_belong_together_all_are_refused() -> None:
    found, captures = matched(view(1.0, 0.0), view(1.2, 0.0, seed=77))
    assert found.series is None
    assert [one.capture for one in found.exclusions] == captures
    assert found.matches == ()
