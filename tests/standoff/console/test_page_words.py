"""Remedies of a command line are said in a page's words, and faults stay as they are."""

import re
from pathlib import Path

import pytest

from standoff.console.page_words import page_words

ROOT = Path(__file__).parents[3]
REPLACE = "to replace it, tick “replace” or press “Compute again”"


@pytest.mark.parametrize(
    ("said", "shown"),
    [
        (
            "a.json exists already; --force replaces it, or name another file",
            f"a.json exists already; {REPLACE}",
        ),
        (
            "folder x exists already; --force replaces it, or name another",
            f"folder x exists already; {REPLACE}",
        ),
        (
            "the shard was damaged; run the same command again",
            "the shard was damaged; start it again",
        ),
        (
            "session s cannot be written: full; check the disk and run the same command again",
            "session s cannot be written: full; check the disk and start it again",
        ),
        (
            "it is full; free some space and run again",
            "it is full; free some space and start it again",
        ),
        ("the noise is unknown; give --noise", "the noise is unknown; in a terminal: give --noise"),
        (
            "a line is missing; see what `standoff verify --repair` can bring back",
            "a line is missing; in a terminal: see what `standoff verify --repair` can bring back",
        ),
        ("Invalid value for '--curves': no such curve", "no such curve"),
        ("Invalid value for --curves: no such curve", "no such curve"),
        # Nothing of these is a terminal's.
        (
            "the stage does not answer; check its cable",
            "the stage does not answer; check its cable",
        ),
        ("Needs it; start the console with --curves", "Needs it; start the console with --curves"),
        (
            "levels taken as srgb (--encoding); the rest",
            "levels taken as srgb (--encoding); the rest",
        ),
        ("-- no edge -- found", "-- no edge -- found"),
        ("", ""),
    ],
)
def test_a_remedy_of_a_terminal_is_said_in_words_of_a_page(said: str, shown: str) -> None:
    assert page_words(said) == shown
    assert page_words(shown) == shown  # what passes twice is said once


def test_no_remedy_of_the_library_is_left_in_words_that_a_page_has_other_ones_for() -> None:
    found = 0
    for folder in (
        "acquisition",
        "analysis",
        "calibration",
        "standoff/library",
        "standoff/terminal",
    ):
        for path in Path(ROOT, folder).rglob("*.py"):
            for text in re.findall(
                r'; [^"]*(?:--force|same command)[^"]*"', path.read_text("utf-8")
            ):
                found += 1
                shown = page_words(f"x{text[:-1]}")
                assert "--force" not in shown, path
                assert "same command" not in shown, path
    assert found > 5
