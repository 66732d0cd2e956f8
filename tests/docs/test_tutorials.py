"""The tutorials: everything on them runs as it stands, and prints what they show."""

import shutil
from pathlib import Path

import pytest

from tests.docs.blocks import CHECKOUT, Block, blocks, terminal
from tests.docs.shown import agrees, first_difference, with_its_numbers

TUTORIALS = sorted((CHECKOUT / "docs").glob("tutorial-*.md"))
READ = ("configs", "tests/data", "standoff/example_photographs")
"""Folders of the checkout that tutorials read from."""


def fresh_checkout(folder: Path) -> Path:
    """A folder with the files of the checkout that the tutorials read."""
    for name in READ:
        shutil.copytree(CHECKOUT / name, folder / name)
    return folder


@pytest.mark.slow(minutes=0.5)
@pytest.mark.parametrize("page", TUTORIALS, ids=lambda page: page.stem)
def test_a_tutorial_runs_as_it_stands(page: Path, tmp_path: Path) -> None:
    with terminal(fresh_checkout(tmp_path / "standoff")) as typed:
        for block in blocks(page.read_text("utf-8")):
            printed = typed.run(block)
            if block.shown:
                place = f"{page.name}, line {block.line}"
                assert first_difference(block.shown, printed) is None, f"{place}:\n{printed}"


def test_there_are_four_tutorials_and_each_shows_what_its_commands_print() -> None:
    assert len(TUTORIALS) == 4
    for page in TUTORIALS:
        found = blocks(page.read_text("utf-8"))
        assert sum(bool(block.shown) for block in found) > 4, page.name


@pytest.mark.parametrize(
    ("shown", "printed"),
    [
        ("sigma  0.62 px", "sigma 0.64 px"),  # two of the last digit
        ("sigma 6.20 px", "sigma 6.50 px"),  # 5 %
        ("│ 12 of 12 │ used │", "│   12 of 12 │   used │"),
        ("81.2 GB free in ...", "81.3 GB free in /tmp/x"),
        ("1,234 px", "1,250 px"),
        ("p = 1e-05", "p = 1.2e-05"),
    ],
)
def test_a_line_agrees_within_the_tolerance_that_is_stated(shown: str, printed: str) -> None:
    assert agrees(" ".join(shown.split()), " ".join(printed.split())) or (
        first_difference(shown, printed) is None
    )


@pytest.mark.parametrize(
    ("shown", "printed"),
    [
        ("sigma 0.62 px", "sigma 0.66 px"),
        ("12 of 12 used", "11 of 12 used"),
        ("go: d' 3.1", "no go: d' 3.1"),
        ("+0.30 px", "-0.30 px"),
        ("first\nthird", "first\nsecond\nthird"),
        ("first", "first\nsecond"),
        ("second\n...\nfirst", "first\nsecond"),
    ],
)
def test_another_word_number_or_line_is_a_difference(shown: str, printed: str) -> None:
    assert first_difference(shown, printed) is not None


def test_dots_stand_for_lines_and_for_parts_of_lines() -> None:
    assert first_difference("a\n...\nd ... f", "a\nb\nc\nd e f") is None
    assert first_difference("...\nc", "a\nb\nc") is None


def test_lines_of_the_machine_are_left_out() -> None:
    printed = "note: compiling the numerical code, once: up to a minute\nwrote x\n"
    assert first_difference("wrote x", printed) is None


def test_blocks_are_found_with_what_is_said_of_them() -> None:
    page = "Words.\n\n<!-- run: ends with status 1 -->\n```sh\nfalse\n```\n```text\nout\n```\n"
    assert blocks(page) == [
        Block(language="sh", code="false\n", how="ends with status 1", shown="out\n", line=4)
    ]
    assert blocks("```toml\na = 1\n```\n") == []


def test_numbers_are_renewed_where_the_words_are_the_same_and_nothing_else_is() -> None:
    shown = "one 1.20 px\n...\n│ two │  7 of 9 │ ... MB\nthree 3\n"
    printed = "one 1.50 px\nmore\n┃ two ┃ 8 of 9 ┃ 12 MB\nfour 3\n".replace("┃", "│")
    assert with_its_numbers(shown, printed) == (
        "one 1.50 px\n...\n│ two │  8 of 9 │ ... MB\nthree 3\n"
    )
