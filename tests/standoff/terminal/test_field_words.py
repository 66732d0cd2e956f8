"""Whoever types another word of the field than the command's name is told the command."""

from collections import Counter

import pytest

from standoff.terminal._app import COMMANDS
from standoff.terminal._words import _OF_GROUPS, _WORDS, meant_command
from tests.standoff.conftest import Command


@pytest.mark.parametrize(
    ("word", "meant"),
    [
        ("mtf", "calibrate"),
        ("MTF50", "calibrate"),
        ("sfr", "calibrate"),
        ("psf", "calibrate"),
        ("sharpness", "calibrate"),
        ("lens", "lens"),
        ("lens report", "lens"),
        ("lens_report", "lens"),
        ("lateral chromatic aberrations", "calibrate"),
        ("diff", "changes"),
        ("difference", "changes"),
        ("align", "pose"),
        ("registration", "pose"),
        ("how-far", "limits"),
        ("darks", "noise"),
        ("autofocus", "focus"),
        ("gui", "console"),
        ("sharpnes", "calibrate"),
        ("registratoin", "pose"),
        ("calibrat", "calibrate"),
        ("change", "changes"),
        ("limit", "limits"),
        ("help", "--help"),
        ("xyzzy", None),
        ("q", None),
        ("", None),
    ],
)
def test_a_word_of_the_field_means_a_command(word: str, meant: str | None) -> None:
    assert meant_command(word, "standoff", COMMANDS) == meant


def test_every_word_means_one_command_that_there_is() -> None:
    for words, commands in ((_WORDS, COMMANDS), *((each, each) for each in _OF_GROUPS.values())):
        counted = Counter(word for text in words.values() for word in text.split())
        assert [word for word, count in counted.items() if count > 1] == []
        assert [word for word in counted if word in COMMANDS and words is _WORDS] == []
        for meant in words:
            assert meant.split()[0] in commands or meant.startswith("--")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["mtf", "edge.tif"], "No such command 'mtf'. Did you mean 'calibrate'? Measure the"),
        (["session", "ls"], "No such command 'ls'. Did you mean 'list'? List the sessions"),
        (["frobnicate"], "No such command 'frobnicate'; standoff --help lists the commands."),
        (["session", "frob"], "standoff session --help lists the commands."),
        (["limits", "--min-dprime", "2"], "Missing option '--curves'. curves.json from standoff "),
        (["sr-pairs"], "Missing argument 'images'. Photographs, or folders of them"),
    ],
)
def test_what_is_not_there_or_missing_is_answered_with_what_to_write(
    command: Command, arguments: list[str], said: str
) -> None:
    done = command(*arguments)
    assert (done.status, done.out) == (2, "")
    assert said in done.err
    assert len(done.err.splitlines()) == 1


def test_the_help_has_the_words_by_which_people_look(command: Command) -> None:
    shown = " ".join(command("--help").out.split())
    for word in ("MTF", "SFR", "PSF", "sharpness", "lens", "lign", "difference"):
        assert word in shown
