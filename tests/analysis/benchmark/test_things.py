"""Scores of lists of things: by whose outline an entry lies, what it says, and what is left out."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import standoff
from analysis.benchmark._things_track import REACH_PX, _owners
from analysis.errors import ResultsFileError
from tests.analysis.benchmark.hand_made_set import HandMadeSet, write_json
from tests.analysis.benchmark.test_scores import value

GONE, MOVED, COLOUR = ("gone", 10, 10), ("moved", 40, 10), ("colour", 40, 30)


def entry(x_px: float, y_px: float, what: str | None = None) -> dict[str, Any]:
    place = {"x_px": x_px, "y_px": y_px}
    return place if what is None else {**place, "what": what}


def pairs() -> HandMadeSet:
    """Three things, two photographs of one thing, one of another light, and a mirror image."""
    made = HandMadeSet()
    made.listed("t0", "a", [GONE, MOVED, COLOUR])
    made.listed("t1", "a", [])
    made.listed("t2", "b", [GONE])
    made.listed("t3", "b", [], kind="light")
    made.listed("t4", "b", [], kind="mirrored", mirrored=True)
    return made


def scored(tmp_path: Path, answers: dict[str, Any]) -> Any:
    data = pairs().write(tmp_path / "data")
    program = tmp_path / "program"
    program.mkdir()
    write_json(program, "things.json", answers)
    return standoff.score_benchmark(program, data)


def test_whoever_lists_each_thing_once_with_its_word_makes_no_error(tmp_path: Path) -> None:
    whole = [entry(10, 10, "gone"), entry(40, 10, "moved"), entry(40, 30, "colour")]
    found = scored(
        tmp_path,
        {
            "t0": {"entries": whole},
            "t1": {"entries": []},
            "t2": {"entries": whole[:1]},
            "t3": {"entries": []},
            "t4": {"refused": True},
        },
    )
    for measure in (
        "answered",
        "things_found",
        "precision",
        "told_rightly",
        "unchanged_silent",
        "mirrored_refused",
    ):
        assert value(found, "things", measure) == 100
    assert value(found, "things", "false_entries") == 0
    assert value(found, "things", "entries_a_thing") == 1
    assert value(found, "things", "unchanged_silent", "kind light") == 100


def test_entries_are_counted_by_the_thing_that_they_lie_on(tmp_path: Path) -> None:
    """Of four things two are found, one of them twice with two words, beside four false entries."""
    found = scored(
        tmp_path,
        {
            "t0": {
                "entries": [
                    entry(8, 10, "gone"),
                    entry(12, 11, "new"),  # of the same thing
                    entry(40, 6, "moved"),  # 2 px above its outline
                    entry(40, 22),  # 5.1 px above the next: further than it reaches
                    entry(70, 10),  # beyond the frame
                ]
            },
            "t1": {"entries": [entry(1, 1), entry(2, 2, "darker")]},
            "t2": {"refused": True},
        },
    )
    # Of t0 to t3; t4 is mirrored, and whoever says nothing of it has refused it.
    assert value(found, "things", "answered") == 50
    assert value(found, "things", "things_found") == 50
    assert value(found, "things", "precision") == pytest.approx(100 * 2 / 6)
    assert value(found, "things", "false_entries") == 2
    assert value(found, "things", "entries_a_thing") == 1.5
    assert value(found, "things", "told_rightly") == 50
    # t1 has entries, and t3 no answer.
    assert value(found, "things", "unchanged_silent") == 0
    assert value(found, "things", "mirrored_refused") == 100


def test_a_list_of_a_mirror_image_is_no_refusal_and_counts_in_nothing_else(tmp_path: Path) -> None:
    found = scored(tmp_path, {"t4": {"entries": [entry(5, 5)]}, "t1": {"entries": []}})
    assert value(found, "things", "mirrored_refused") == 0
    assert value(found, "things", "false_entries") == 0
    assert value(found, "things", "answered") == 25
    assert value(found, "things", "unchanged_silent") == 50


@settings(max_examples=40)
@given(
    middle=st.tuples(st.integers(8, 51), st.integers(8, 31)),
    place=st.tuples(st.floats(-10, 80), st.floats(-10, 60)),
)
def test_a_place_belongs_to_a_thing_within_reach_of_its_outline(
    middle: tuple[int, int], place: tuple[float, float]
) -> None:
    labels = np.zeros((40, 60), np.int64)
    x, y = middle
    labels[y - 2 : y + 3, x - 2 : x + 3] = 1
    at_x, at_y = round(place[0]), round(place[1])
    away = np.hypot(max(abs(at_x - x) - 2, 0), max(abs(at_y - y) - 2, 0))
    is_in_frame = 0 <= at_x < 60 and 0 <= at_y < 40
    expected = int(is_in_frame and away <= REACH_PX)
    assert _owners(labels, np.array([place])) == [expected]


@pytest.mark.parametrize(
    ("answers", "said"),
    [
        ({"t9": {"refused": True}}, "no task 't9'"),
        ({"t0": {}}, "give one of"),
        ({"t0": {"refused": True, "entries": []}}, "give one of"),
        ({"t0": {"entries": [{"x_px": 1.0}]}}, "y_px"),
        ({"t0": {"entries": [{"x_px": 1.0, "y_px": 2.0, "what": "lost"}]}}, "what"),
    ],
)
def test_an_answer_that_is_none_is_named(
    tmp_path: Path, answers: dict[str, Any], said: str
) -> None:
    with pytest.raises(ResultsFileError, match=said) as error:
        scored(tmp_path, answers)
    assert "things.json" in str(error.value)
