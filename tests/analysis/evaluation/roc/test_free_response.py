"""Marks of maps and the FROC: worked by hand."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from analysis.evaluation.roc import Disc, MarkedPair, Marks, froc, marks_of


def marks(*each: tuple[float, float, float]) -> Marks:
    """Of scores and places (x, y)."""
    table = np.array(each, np.float64).reshape(-1, 3)
    return Marks(scores=table[:, 0], x_px=table[:, 1], y_px=table[:, 2])


def test_a_worked_curve() -> None:
    change = Disc(x_px=10.0, y_px=20.0, radius_px=3.0)
    pairs = [
        # Two marks on the change, of which the higher finds it, and a higher one elsewhere.
        MarkedPair(
            marks=marks((9.0, 40.0, 20.0), (8.0, 11.0, 21.0), (6.0, 10.0, 17.0)), change=change
        ),
        # Missed by a hair.
        MarkedPair(marks=marks((5.0, 10.0, 23.1)), change=change),
        MarkedPair(marks=marks((7.0, 10.0, 20.0), (4.0, 1.0, 1.0)), change=None),
        MarkedPair(marks=marks(), change=None),
    ]
    curve = froc(pairs)
    # Falling: false 9, found 8, false 7, 5, 4 of four pairs and two changes; the straight rest is
    # two points.
    assert curve.false_marks_per_pair.tolist() == [0, 0.25, 0.25, 1.0]
    assert curve.found.tolist() == [0, 0, 0.5, 0.5]
    assert curve.thresholds.tolist() == [np.inf, 9.0, 8.0, 4.0]
    assert [curve.found_at(rate) for rate in (0.0, 0.24, 0.25, 5.0)] == [0, 0, 0.5, 0.5]


def test_without_a_change_there_is_no_curve_and_without_marks_it_is_a_point() -> None:
    with pytest.raises(ValueError, match="none of 1 pairs"):
        froc([MarkedPair(marks=marks((1.0, 1.0, 1.0)), change=None)])
    change = Disc(x_px=0.0, y_px=0.0, radius_px=1.0)
    curve = froc([MarkedPair(marks=marks(), change=change)])
    assert (curve.found.tolist(), curve.false_marks_per_pair.tolist()) == ([0], [0])


@given(st.integers(0, 2**32 - 1))
def test_found_and_false_rise_as_the_threshold_falls(seed: int) -> None:
    rng = np.random.default_rng(seed)
    change = Disc(x_px=5.0, y_px=5.0, radius_px=4.0)
    pairs = [
        MarkedPair(
            marks=marks(*np.round(rng.uniform(0, 10, (rng.integers(0, 6), 3)))),
            change=change if is_changed else None,
        )
        for is_changed in (True, False, True)
    ]
    curve = froc(pairs)
    assert np.all(np.diff(curve.found) >= 0)
    assert np.all(np.diff(curve.false_marks_per_pair) >= 0)
    assert np.all(np.diff(curve.thresholds) < 0)
    assert curve.found[-1] <= 1


def test_marks_are_the_highest_local_maxima_apart_from_each_other() -> None:
    level = np.zeros((30, 50), np.float32)
    level[4, 40] = 5.0
    level[4, 43] = 4.0  # too near to the first
    level[20, 10], level[20, 11] = 3.0, 2.0  # a slope
    level[29, 49] = 1.0  # in the corner
    found = marks_of(level, 3, 5.0)
    assert found.scores.tolist() == [5.0, 3.0, 1.0]
    assert found.x_px.tolist() == [40.0, 10.0, 49.0]
    assert found.y_px.tolist() == [4.0, 20.0, 29.0]
    assert marks_of(level, 4, 3.0).scores.tolist() == [5.0, 3.0, 1.0, 0.0]
    assert marks_of(level, 2, 2.0).scores.tolist() == [5.0, 4.0]


def test_a_mark_is_highest_in_a_disc_and_not_in_a_square() -> None:
    level = np.full((21, 21), -np.inf, np.float32)
    level[10, 10] = 1.0
    level[13, 14] = 2.0  # 5 px away
    assert marks_of(level, 5, 5.0).scores.tolist() == [2.0]
    assert marks_of(level, 5, 4.9).scores.tolist() == [2.0, 1.0]


def test_pixels_that_are_not_seen_have_no_marks() -> None:
    level = np.full((9, 12), np.nan, np.float32)
    assert marks_of(level, 20, 3.0).scores.size == 0
    level[3, 4] = -2.0
    found = marks_of(level, 20, 3.0)
    assert (found.scores.tolist(), found.x_px.tolist(), found.y_px.tolist()) == ([-2], [4], [3])


@given(st.integers(0, 2**32 - 1), st.integers(1, 20), st.sampled_from([1.0, 1.5, 3.0, 4.2]))
@settings(max_examples=40)
def test_marks_by_definition(seed: int, count: int, apart_px: float) -> None:
    rng = np.random.default_rng(seed)
    level = rng.integers(0, 6, (14, 17)).astype(np.float32)
    rows, cols = np.indices(level.shape)
    highest = [
        (-float(level[y, x]), y, x)
        for y, x in np.ndindex(*level.shape)
        if level[np.hypot(rows - y, cols - x) <= apart_px].max() == level[y, x]
    ]
    expected: list[tuple[float, int, int]] = []
    for score, y, x in sorted(highest):
        if all(np.hypot(y - b, x - a) > apart_px for _, b, a in expected):
            expected.append((score, y, x))
    found = marks_of(level, count, apart_px)
    places = zip((-found.scores).tolist(), found.y_px.tolist(), found.x_px.tolist(), strict=True)
    assert list(places) == expected[:count]


@pytest.mark.parametrize(
    ("shape", "count", "apart_px", "says"),
    [
        ((4,), 1, 2.0, "rows and columns"),
        ((0, 3), 1, 2.0, "rows and columns"),
        ((4, 4), 0, 2.0, "count"),
        ((4, 4), 21, 2.0, "count"),
        ((4, 4), 1, 0.5, "apart_px"),
    ],
)
def test_what_is_no_map_or_no_number_of_marks_is_refused(
    shape: tuple[int, ...], count: int, apart_px: float, says: str
) -> None:
    with pytest.raises(ValueError, match=says):
        marks_of(np.zeros(shape, np.float32), count, apart_px)
    with pytest.raises(ValueError, match="radius_px"):
        Disc(x_px=0.0, y_px=0.0, radius_px=0.0)
