"""What both photographs show, by the surfaces of both: closed form, on lines along the rows."""

from dataclasses import replace

import numpy as np
import pytest

from calibration.parallax._parallax import Surface, seen_in_both
from calibration.parallax._views import AlignedViews

SHAPE = (60, 120)
INNER = np.s_[10:50, 10:110]
"""Away from the borders, where a surface is known from one side alone."""

PLACE, SHIFT_PX = np.s_[20:40, 30:50], 12


def views() -> AlignedViews:
    everywhere, level = np.ones(SHAPE, dtype=np.bool_), np.zeros(SHAPE, dtype=np.float32)
    return AlignedViews(
        target=level,
        source=level,
        is_target=everywhere,
        is_source=everywhere,
        to_x=level + 1,
        to_y=level,
    )


def surface(parallax_px: float = 0.0) -> Surface:
    """Known and matched everywhere."""
    every = np.ones(SHAPE, dtype=np.bool_)
    level = np.zeros(SHAPE, dtype=np.float32)
    return Surface(
        parallax_px=level + np.float32(parallax_px),
        error_px=level,
        is_matched=every,
        is_known=every,
        is_sure=every,
        is_elsewhere=~every,
    )


def without_match(one: Surface) -> Surface:
    matched = one.is_matched.copy()
    matched[PLACE] = False
    return replace(one, is_matched=matched)


def elsewhere(one: Surface) -> Surface:
    there = np.zeros(SHAPE, dtype=np.bool_)
    rows, cols = PLACE
    there[rows, cols.start + SHIFT_PX : cols.stop + SHIFT_PX] = True
    return replace(one, is_elsewhere=there)


@pytest.mark.parametrize("is_matched", [True, False])
@pytest.mark.parametrize("is_elsewhere", [True, False])
def test_what_has_no_match_is_hidden_by_a_thing_of_the_other_view(
    *, is_matched: bool, is_elsewhere: bool
) -> None:
    """What is matched is seen, whatever lies there; so is what has changed on the surface."""
    own, other = surface(SHIFT_PX), surface(SHIFT_PX)
    own = own if is_matched else without_match(own)
    other = elsewhere(other) if is_elsewhere else other
    expected = np.ones(SHAPE, dtype=np.bool_)
    expected[PLACE] = is_matched or not is_elsewhere
    seen = seen_in_both(own, other, views())
    # Along the lines, 12 px further are beyond the other frame.
    inner = np.s_[10:50, 10:95]
    np.testing.assert_array_equal(seen[inner], expected[inner])


def test_a_surface_that_the_other_view_has_elsewhere_is_hidden_without_a_match() -> None:
    own, other = without_match(surface()), surface()
    parallax = other.parallax_px.copy()
    parallax[PLACE] = 8.0
    expected = np.ones(SHAPE, dtype=np.bool_)
    expected[PLACE] = False
    seen = seen_in_both(own, replace(other, parallax_px=parallax), views())
    np.testing.assert_array_equal(seen[INNER], expected[INNER])
