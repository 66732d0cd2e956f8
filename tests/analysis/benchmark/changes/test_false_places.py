"""False places against the threshold."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from hypothesis.extra.numpy import arrays
from scipy.ndimage import label

from analysis.benchmark._change_answers import PlaceSteps, level_exceeded_by, place_counts


def test_two_peaks_are_two_places_down_to_the_saddle_between_them() -> None:
    scores = np.full((20, 30), -1.0, np.float32)
    scores[5, 3:8] = [9, 5, 4, 5, 7]
    found = place_counts(scores, most=3)
    # Below the background, which covers all, there are the one region and 100 full percents.
    assert found.levels.tolist() == [9.0, 7.0, 4.0, -1.0]
    assert found.counts.tolist() == [1.0, 2.0, 1.0, np.inf]


def test_pixels_that_touch_at_a_corner_are_one_place_and_columns_do_not_wrap() -> None:
    scores = np.zeros((20, 30), np.float32)
    scores[4, 29] = scores[5, 0] = scores[10, 10] = scores[11, 11] = 1.0
    assert place_counts(scores, most=9).counts[0] == 3.0


def test_a_map_that_is_everywhere_the_same_has_more_places_than_any_frame_is_allowed() -> None:
    assert place_counts(np.ones((20, 30), np.float32), most=500).counts.tolist() == [101.0]


def test_pixels_without_a_score_are_no_place() -> None:
    scores = np.full((5, 5), np.nan, np.float32)
    assert place_counts(scores, most=5).levels.size == 0


@settings(max_examples=40)
@given(arrays(np.int8, (9, 13), elements=st.integers(0, 6)))
def test_counts_are_regions_as_another_algorithm_labels_them_and_full_percents(
    scores: np.ndarray[tuple[int, int], np.dtype[np.int8]],
) -> None:
    found = place_counts(scores.astype(np.float32), most=1e9)
    for level in np.unique(scores):
        is_above = scores >= level
        expected = label(is_above, np.ones((3, 3)))[1] + 100 * int(is_above.sum()) // scores.size
        at = np.flatnonzero(found.levels >= level)[-1]
        assert found.counts[at] == expected


def test_the_threshold_is_where_there_would_be_more_than_one_place_a_frame() -> None:
    maps = [np.zeros((30, 40), np.float32) for _ in range(2)]
    maps[0][3, 3], maps[0][9, 9], maps[1][20, 20] = 8.0, 6.0, 4.0
    steps = PlaceSteps.of([place_counts(one, most=9) for one in maps])
    assert steps.threshold(1.0, np.ones(2)) == 4.0
    assert steps.threshold(0.5, np.ones(2)) == 6.0
    assert steps.threshold(0.4, np.ones(2)) == 8.0
    # Of the second map alone, drawn twice, the place and all of the frame below it count.
    assert steps.threshold(1.0, np.array([0.0, 2.0])) == 0.0


def test_the_level_that_a_share_of_pixels_exceeds() -> None:
    falling = np.arange(1000, 0, -1).astype(np.float32)
    assert level_exceeded_by([falling], 1000, 0.01) == 990.0
    assert np.sum(falling > 990.0) == 10
    assert level_exceeded_by([falling[:20]], 1000, 0.01) == 990.0


def test_where_a_map_is_not_followed_further_no_threshold_is_allowed() -> None:
    noise = np.random.default_rng(1).normal(size=(30, 40)).astype(np.float32)
    whole, begun = (PlaceSteps.of([place_counts(noise, most)]) for most in (1e9, 3))
    for places in (1.0, 2.0, 3.0):
        assert whole.threshold(places, np.ones(1)) == begun.threshold(places, np.ones(1))
    assert begun.threshold(50.0, np.ones(1)) == pytest.approx(begun.levels[-1])
