"""Small maps drawn by hand: what is interpolated, what is hidden, and what is left out."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from calibration.parallax._occlusion import (
    filled_holes,
    filled_surface,
    guarded,
    hidden_in_other,
    is_elsewhere,
    known_surface,
    matched_both_ways,
    place_error,
)
from simulation.arrays import BoolArray, Float32Array
from tests.calibration.parallax.test_matching import views_of

FRAME = (40, 60)
LAST_COL = FRAME[1] - 1
ROWS, COLS = np.indices(FRAME)
NONE: BoolArray = np.zeros(FRAME, dtype=np.bool_)
ALONG_X, ALONG_Y = np.ones(FRAME, dtype=np.float32), np.zeros(FRAME, dtype=np.float32)
VIEWS = views_of(NONE.astype(float), NONE.astype(float), (1.0, 0.0))


def level(parallax_px: float) -> Float32Array:
    return np.full(FRAME, parallax_px, dtype=np.float32)


def steps(first: float, last: float, at: int = 30) -> Float32Array:
    """One surface left of a column, and another from there on."""
    return np.where(at > COLS, first, last).astype(np.float32)


def gap(first: int, last: int) -> BoolArray:
    """All but some columns."""
    return np.asarray((first > COLS) | (last <= COLS))


@settings(max_examples=20)
@given(
    level_px=st.floats(-20, 20, width=32),
    slope=st.floats(-0.1, 0.1),
    first=st.integers(5, 25),
    width=st.integers(1, 25),
)
def test_a_gap_of_one_surface_is_interpolated_along_the_line(
    level_px: float, slope: float, first: int, width: int
) -> None:
    true = (level_px + slope * (COLS - 30)).astype(np.float32)
    known = gap(first, first + width)
    holed = np.where(known, true, np.float32(99))
    filled, is_sure = filled_surface(holed, known, NONE, ALONG_X, ALONG_Y)
    # A line between two of its points is the line, to single precision of 25 px.
    np.testing.assert_allclose(filled, true, atol=2e-5)
    assert is_sure.all()


def test_at_a_jump_only_what_was_matched_counts() -> None:
    """Known left of column 20 at 0, and from 38 on at 8; between, some was matched."""
    known = gap(20, 38)
    matched = known | ((COLS >= 25) & (COLS < 30))
    parallax = np.where(COLS < 38, 0, 8).astype(np.float32)
    parallax[:, 25:30] = 7.5
    filled, is_sure = filled_surface(parallax, known, matched, ALONG_X, ALONG_Y)
    np.testing.assert_array_equal(is_sure, matched)
    np.testing.assert_array_equal(filled[:, 25:30], 7.5)
    np.testing.assert_array_equal(filled[known], parallax[known])
    # What was not matched is of one side or the other, and not between.
    assert set(np.unique(filled[:, 20:25])) | set(np.unique(filled[:, 30:38])) <= {0.0, 8.0}


def test_in_a_wide_gap_at_a_jump_nothing_counts() -> None:
    """A thing by itself is in it, that changed or is hidden; of one surface, it is filled."""
    known = gap(10, 50)
    parallax = np.where(COLS < 50, 0, 8).astype(np.float32)
    _, is_sure = filled_surface(parallax, known, ~NONE, ALONG_X, ALONG_Y)
    np.testing.assert_array_equal(is_sure, known)
    _, is_sure = filled_surface(level(3.0), known, ~NONE, ALONG_X, ALONG_Y)
    assert is_sure.all()


def test_beyond_the_last_known_pixel_its_parallax_goes_on_and_does_not_count() -> None:
    known = COLS < 40
    matched = known | (COLS >= 50)
    parallax = np.where(known, 3.0, np.where(COLS >= 55, 3.4, 9.0)).astype(np.float32)
    filled, is_sure = filled_surface(parallax, known, matched, ALONG_X, ALONG_Y)
    np.testing.assert_array_equal(filled[:, 40:55], 3.0)
    # Matched, and within a pixel of it.
    np.testing.assert_array_equal(filled[:, 55:], np.float32(3.4))
    np.testing.assert_array_equal(is_sure, known | (COLS >= 55))


def test_where_nothing_lies_along_the_line_it_is_looked_for_across() -> None:
    known = (ROWS < 10) | (ROWS >= 30)
    true = (0.05 * ROWS).astype(np.float32)
    filled, is_sure = filled_surface(true * known, known, NONE, ALONG_X, ALONG_Y)
    np.testing.assert_allclose(filled, true, atol=1e-5)
    assert is_sure.all()


@pytest.mark.parametrize(("first", "last"), [(0.0, 8.0), (8.0, 0.0)])
def test_what_another_surface_covers_in_the_other_view_is_hidden(first: float, last: float) -> None:
    """Towards the right the source has what the target shows, by the surface's parallax.

    Rising from 0 to 8 at column 30, the source's columns 30 to 37 show what the target does not.
    Falling from 8 to 0, the target's 8 columns from 30 on lie where the source shows the left.
    """
    own = steps(first, last)
    # In the source, what is before ends where its last pixel lies.
    other = steps(first, last, 38)
    hidden = hidden_in_other(own, other, ~NONE, VIEWS)
    expected = (COLS >= 30) & (COLS < 38) if first > last else NONE
    np.testing.assert_array_equal(hidden, expected)
    # And what is not known of the other view hides nothing.
    assert not hidden_in_other(own, other, NONE, VIEWS).any()


def test_pixels_are_matched_both_ways_where_they_end_at_themselves() -> None:
    own, other = steps(8.0, 0.0), steps(8.0, 0.0, 38)
    both = matched_both_ways(own, other, VIEWS)
    np.testing.assert_array_equal(both, (COLS < 30) | (COLS >= 38))
    # Beyond the border there is nothing to come back from.
    outwards = matched_both_ways(level(8.0), level(8.0), VIEWS)
    np.testing.assert_array_equal(outwards, LAST_COL >= COLS + 8)


@pytest.mark.parametrize(("side", "is_dropped"), [(8, True), (9, False)])
def test_small_islands_are_dropped(side: int, is_dropped: bool) -> None:
    """64 pixels are few, 81 are not; an island differs by 3 px from what surrounds it."""
    island = NONE.copy()
    island[10 : 10 + side, 20 : 20 + side] = True
    parallax = np.where(island, 3.0, 0.0).astype(np.float32)
    known = known_surface(parallax, ~NONE, level(0.5))
    np.testing.assert_array_equal(known, ~island if is_dropped else ~NONE)


def test_a_slope_is_one_surface_however_much_it_rises() -> None:
    known = known_surface((0.9 * COLS).astype(np.float32), ~NONE, level(0.5))
    assert known.all()


def test_what_does_not_look_like_its_match_is_not_known_nor_what_is_near() -> None:
    away = np.hypot(ROWS - 20, COLS - 30)
    unlike = np.where(away < 5, 20.0, 0.5).astype(np.float32)
    known = known_surface(level(0.0), ~NONE, unlike)
    # The mean over 1.5 px reaches 2.2 about as far beyond the border, and the band 4 px.
    assert not known[away < 5 + 3].any()
    assert known[away > 5 + 4 + 3].all()
    # That many times what is expected is where unlike begins.
    assert known_surface(level(0.0), ~NONE, level(2.1)).all()
    assert not known_surface(level(0.0), ~NONE, level(2.3)).any()


def disc(row: int, col: int, radius: float) -> BoolArray:
    return np.asarray(np.hypot(ROWS - row, COLS - col) < radius)


@pytest.mark.parametrize(("across", "down"), [(0.0, 0.0), (0.1, -0.05)])
def test_a_hole_that_one_surface_surrounds_is_filled_by_its_plane(
    across: float, down: float
) -> None:
    true = (2 + across * COLS + down * ROWS).astype(np.float32)
    hole = disc(20, 30, 5)
    filled, is_hole = filled_holes(np.where(hole, np.float32(50), true), ~hole, ~NONE)
    np.testing.assert_array_equal(is_hole, hole)
    # Single precision of 8 px.
    np.testing.assert_allclose(filled, true, atol=1e-5)


def test_a_hole_on_a_slope_that_joins_two_surfaces_is_not_filled() -> None:
    """Parallax of two pixels in five is no surface's; of one in five it is."""
    hole = disc(20, 30, 5)
    for slope, is_filled in ((0.4, False), (0.2, True)):
        true = (slope * COLS).astype(np.float32)
        _, is_hole = filled_holes(np.where(hole, np.float32(50), true), ~hole, ~NONE)
        assert is_hole.any() == is_filled


def test_a_hole_between_two_surfaces_is_left() -> None:
    """As what one photograph hides is."""
    hole = disc(20, 30, 5)
    parallax = steps(0.0, 5.0)
    filled, is_hole = filled_holes(parallax, ~hole, ~NONE)
    assert not is_hole.any()
    np.testing.assert_array_equal(filled, parallax)


@pytest.mark.parametrize(("side_px", "is_hidden"), [(3, False), (4, True), (9, True)])
def test_a_few_pixels_of_another_parallax_are_an_error_of_it(side_px: int, is_hidden: bool) -> None:
    patch = (ROWS >= 10) & (10 + side_px > ROWS) & (COLS >= 10) & (10 + side_px > COLS)
    other = np.where(patch, np.float32(9), level(1.0))
    hidden = hidden_in_other(level(1.0), other, ~NONE, VIEWS)
    assert hidden.sum() == side_px**2 * is_hidden


def test_holes_that_are_tiny_or_huge_or_beyond_a_photograph_are_left() -> None:
    for hole, shown in (
        (disc(20, 30, 1.5), ~NONE),  # 9 px
        (disc(20, 30, 9), ~NONE),  # a tenth of the frame
        (disc(20, 30, 5), ~disc(18, 30, 1)),
    ):
        assert not filled_holes(level(1.0), ~hole, shown)[1].any()


def test_a_guard_band_surrounds_what_is_not_seen_and_jumps() -> None:
    is_seen = ~NONE.copy()
    is_seen[20, 15] = False
    found = guarded(is_seen, ~NONE, level(1.0))
    away = np.hypot(ROWS - 20, COLS - 15)
    # A disc of 2 px, as OpenCV draws it.
    assert not found[away <= 2].any()
    assert found[away > 3].all()
    beside = guarded(~NONE, ~NONE, steps(0.0, 4.0))
    # The jump's own two columns, and 2 px at either side.
    np.testing.assert_array_equal(beside, (COLS < 27) | (COLS >= 33))
    assert guarded(~NONE, ~NONE, steps(0.0, 1.4)).all()
    # Between lines that were filled one by one, a jump tells of no surface.
    assert guarded(~NONE, gap(29, 32), steps(0.0, 4.0)).all()


def test_a_pixel_is_as_far_off_as_its_error_and_more_beside_a_jump() -> None:
    parallax = np.zeros((20, 40), dtype=np.float32)
    parallax[:, 20:] = 10.0
    error = np.full(parallax.shape, 0.05, dtype=np.float32)
    error[3, 3] = np.inf
    apart = np.zeros_like(parallax)
    apart[5, 7] = 0.4
    matched = np.ones(parallax.shape, dtype=np.bool_)
    matched[10, 16] = False
    found = place_error(parallax, error, apart, matched)
    np.testing.assert_allclose(found[10, [5, 35]], 0.05, rtol=1e-6)
    # As the other view has it elsewhere.
    np.testing.assert_allclose(found[5, 7], 0.4, rtol=1e-6)
    # Interpolated, and a tenth of the jump's 10 px.
    np.testing.assert_allclose(found[3, 3], 0.3, rtol=1e-6)
    np.testing.assert_allclose(found[10, 23], np.hypot(0.05, 1.0), rtol=1e-6)
    # What was not matched may lie anywhere between.
    np.testing.assert_allclose(found[10, 16], np.hypot(0.05, 5.0), rtol=1e-6)


@pytest.mark.parametrize("noise", [0.0, 0.3])
def test_a_thing_taken_for_a_hole_is_found_on_its_line_and_paint_is_not(noise: float) -> None:
    rng = np.random.default_rng(5)
    size = (60, 120)
    ground, thing = rng.normal(size=(2, *size)).astype(np.float32)
    target, source = ground.copy(), ground.copy()
    target[20:40, 30:50] = thing[20:40, 30:50]
    source[20:40, 42:62] = thing[20:40, 30:50]  # 12 px along the line
    target[20:40, 80:100] += 3.0  # painted, on the ground alone
    target += noise * rng.normal(size=size).astype(np.float32)
    source += noise * rng.normal(size=size).astype(np.float32)
    every = np.ones(size, dtype=np.bool_)
    matched = every.copy()
    matched[15:45] = False
    views = views_of(target, source, (1.0, 0.0))
    on_ground = (np.zeros(size, dtype=np.float32), np.zeros(size, dtype=np.float32))
    found = is_elsewhere(views, on_ground, (matched, matched), (-20, 20))
    assert found[20:40, 30:50].all()
    assert not found[:, 72:].any()
    # Nor is it beyond the range, nor where everything is matched.
    assert not is_elsewhere(views, on_ground, (matched, matched), (-20, 8))[:, :42].any()
    assert not is_elsewhere(views, on_ground, (every, every), (-20, 20)).any()


def test_paint_beside_which_the_ground_is_even_is_not_elsewhere() -> None:
    """Even ground looks like even ground beside the paint, which is the ground's there."""
    size = (60, 120)
    noise = 0.05 * np.random.default_rng(6).normal(size=(2, *size)).astype(np.float32)
    target, source = noise[0].copy(), noise[1]
    target[24:34, 50:60] += 3.0
    views, back = views_of(target, source, (1.0, 0.0)), views_of(source, target, (-1.0, 0.0))
    on_ground = (np.zeros(size, dtype=np.float32), np.zeros(size, dtype=np.float32))
    matched = np.ones(size, dtype=np.bool_)
    matched[15:45] = False
    for one in (views, back):
        assert not is_elsewhere(one, on_ground, (matched, matched), (-20, 20)).any()


def test_a_thing_that_is_matched_from_one_side_is_elsewhere_from_the_other() -> None:
    rng = np.random.default_rng(7)
    size = (60, 120)
    ground, thing = rng.normal(size=(2, *size)).astype(np.float32)
    target, source = ground.copy(), ground.copy()
    target[20:40, 30:50] = thing[20:40, 30:50]
    source[20:40, 42:62] = thing[20:40, 30:50]
    level_px, thing_px = np.zeros(size, dtype=np.float32), np.zeros(size, dtype=np.float32)
    thing_px[20:40, 42:62] = 12
    matched = np.ones(size, dtype=np.bool_)
    matched[15:45] = False
    views = views_of(target, source, (1.0, 0.0))
    every = np.ones(size, dtype=np.bool_)
    assert is_elsewhere(views, (level_px, thing_px), (matched, every), (-20, 20))[
        24:36, 34:46
    ].all()
