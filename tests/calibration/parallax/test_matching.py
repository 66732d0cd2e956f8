"""Matching to a whole pixel: what was displaced by whole pixels is found where it went.

Noise has no pixel like another. Directions along which a whole number of pixels is one of columns
and of rows are those of the Pythagorean triangle of 3, 4 and 5.
"""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from calibration.parallax._matching import match_views
from calibration.parallax._occlusion import matched_both_ways
from calibration.parallax._views import AlignedViews
from simulation.arrays import BoolArray, FloatArray

Levels = NDArray[Any]

FRAME = (64, 80)
BORDER_PX = 16
INNER = np.s_[BORDER_PX:-BORDER_PX, BORDER_PX:-BORDER_PX]
"""Further from the border than any displacement here, and than a census reaches."""

DIRECTIONS = {
    "right": (1.0, 0.0),
    "left": (-1.0, 0.0),
    "down": (0.0, 1.0),
    "aslant": (0.6, 0.8),
    "aslant_back": (-0.8, 0.6),
}


def views_of(
    target: Levels, source: Levels, to: tuple[float, float] | tuple[FloatArray, FloatArray]
) -> AlignedViews:
    """Two images that show something everywhere, and lines ``(x, y)``."""
    whole = np.ones(target.shape, dtype=np.bool_)
    along_x, along_y = (np.broadcast_to(one, target.shape).astype(np.float32) for one in to)
    return AlignedViews(
        target=target.astype(np.float32),
        source=source.astype(np.float32),
        is_target=whole,
        is_source=whole,
        to_x=along_x,
        to_y=along_y,
    )


def noise(seed: int = 0) -> FloatArray:
    """Levels of 100 with a standard deviation of 20, smoothed as lenses do, no two alike."""
    white = np.random.default_rng(seed).normal(0, 1, FRAME)
    near = sum(np.roll(white, (j, i), (0, 1)) for j in (-1, 0, 1) for i in (-1, 0, 1))
    return np.asarray(100 + 20 * near / 3)


def moved(image: Levels, parallax_px: int, to: tuple[float, float]) -> Levels:
    """The source, in which everything of a target lies so far along the lines."""
    by_x, by_y = (round(parallax_px * one) for one in to)
    return np.roll(image, (by_y, by_x), (0, 1))


def shifted_views(parallax_px: int, name: str = "right") -> AlignedViews:
    to = DIRECTIONS[name]
    return views_of(noise(), moved(noise(), parallax_px, to), to)


@pytest.mark.parametrize("name", DIRECTIONS)
@pytest.mark.parametrize("parallax_px", [-10, -5, 0, 5, 10])
def test_a_displacement_of_whole_pixels_is_found_exactly_by_both_views(
    name: str, parallax_px: int
) -> None:
    views = shifted_views(parallax_px, name)
    found = match_views(views, -12, 12)
    np.testing.assert_array_equal(found.target[INNER], parallax_px)
    # On the source's own pixels, and counted the same way.
    np.testing.assert_array_equal(found.source[INNER], parallax_px)
    assert matched_both_ways(found.target, found.source, views)[INNER].all()


def two_surfaces() -> tuple[AlignedViews, BoolArray]:
    """A square at 6 px before another surface at -2, and where the source shows the square."""
    back, front = noise(1), noise(2)
    square = np.zeros(FRAME, dtype=np.bool_)
    square[20:44, 28:54] = True
    to = DIRECTIONS["right"]
    target = np.where(square, front, back)
    there = moved(square, 6, to)
    source = np.where(there, moved(front, 6, to), moved(back, -2, to))
    return views_of(target, source, to), square


def test_two_surfaces_are_told_apart_up_to_what_a_census_reaches() -> None:
    views, square = two_surfaces()
    found = match_views(views, -5, 9)
    # A census reaches 4 px across and 3 down, which mixes both surfaces, and so does its blur.
    middle = np.zeros_like(square)
    middle[25:39, 34:48] = True
    np.testing.assert_array_equal(found.target[middle], 6)
    around = np.ones_like(square)
    # On its right, 8 px of the ground are hidden in the source as well.
    around[15:49, 22:68] = False
    around[:5], around[-5:], around[:, :BORDER_PX], around[:, -BORDER_PX:] = (False,) * 4
    np.testing.assert_array_equal(found.target[around], -2)


@pytest.mark.parametrize(
    ("gain", "offset", "gamma"), [(1.0, 0.0, 1.0), (3.0, -40.0, 1.0), (0.4, 90.0, 1.0), (1, 0, 2.2)]
)
def test_another_light_gives_the_same(gain: float, offset: float, gamma: float) -> None:
    views = shifted_views(5)
    other = (views.source / 255).clip(0, None) ** gamma * 255 * gain + offset
    found = match_views(replace(views, source=other.astype(np.float32)), -8, 8)
    np.testing.assert_array_equal(found.target[INNER], 5)
    np.testing.assert_array_equal(found.source[INNER], 5)


def test_lines_that_meet_in_the_frame_are_followed() -> None:
    """A closed form of displacement: 4 px away from the epipole, everywhere but around it."""
    rng = np.random.default_rng(4)
    waves = rng.uniform(-1.2, 1.2, (40, 2))
    phases = rng.uniform(0, 2 * np.pi, 40)

    def level(x: FloatArray, y: FloatArray) -> FloatArray:
        return sum(
            (np.cos(u * x + v * y + at) for (u, v), at in zip(waves, phases, strict=True)),
            np.zeros_like(x),
        )

    y, x = np.meshgrid(np.arange(64.0), np.arange(80.0), indexing="ij")
    away_x, away_y = 37.3 - x, 30.6 - y
    radius = np.hypot(away_x, away_y)
    to = (away_x / radius, away_y / radius)
    views = views_of(level(x - 4 * to[0], y - 4 * to[1]), level(x, y), to)
    found = match_views(views, -8, 8)
    counts = np.zeros(FRAME, dtype=np.bool_)
    counts[8:-8, 8:-8] = True
    counts &= radius > 14
    # Places are rounded to whole pixels: both neighbours of -4 may look most alike.
    assert np.abs(found.target[counts] + 4).max() <= 1
    assert np.mean(found.target[counts] == -4) > 0.9


def test_blocks_are_left_out_and_follow_from_their_neighbours() -> None:
    found = match_views(shifted_views(5), -8, 8)
    # Squares of 8 px, in nine turns: each pixel of a small frame in one of them.
    assert found.is_held_out.all()
    np.testing.assert_array_equal(found.held_out[INNER], 5)


def test_levels_of_held_out_blocks_are_not_looked_at() -> None:
    """Otherwise what they confirm was chosen so that they do."""
    views = shifted_views(5)
    found = match_views(views, -8, 8)
    rows, cols = np.indices(FRAME)
    for down, right in ((0, 0), (8, 16), (16, 8), (16, 16)):  # some of the nine turns
        block = ((rows - down) % 24 < 8) & ((cols - right) % 24 < 8)
        assert found.is_held_out[block].all()
        other = np.where(block, noise(7), views.target).astype(np.float32)
        again = match_views(replace(views, target=other), -8, 8)
        np.testing.assert_array_equal(again.held_out[block], found.held_out[block])


def test_larger_pixels_see_the_same_lines_and_a_share_of_the_displacement() -> None:
    target = np.kron(noise(3), np.ones((3, 3)))[:-1, :-2]
    small = views_of(target, np.roll(target, 12, 1), (0.6, 0.8)).reduced(3)
    rows, cols = FRAME
    assert small.target.shape == (rows - 1, cols - 1)
    np.testing.assert_allclose(small.target, noise(3)[:-1, :-1], rtol=1e-5)
    # Three times four pixels are four of these.
    np.testing.assert_allclose(small.source[:, 4:], small.target[:, :-4], rtol=1e-5)
    np.testing.assert_allclose(np.hypot(small.to_x, small.to_y), 1.0, rtol=1e-5)
    assert small.is_target.all()
