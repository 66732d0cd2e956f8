"""Every option of every command with values that make no sense, in this process.

The files of the command lines are not there: what no option refuses ends at them.
"""

from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import pytest
import typer

from tests.fuzz.commands.path_options import each_command, line_of
from tests.fuzz.commands.test_hostile_paths import faults_of, status_of

pytestmark = pytest.mark.slow

WRONG = (
    *("", "mesured", "-1", "0", "nan", "inf", "-inf", "1e400", "0.00345", "99999999999999999999"),
    *("1,2,3", "3,2", "-5,5", "a=b", "½"),
)
NEED_NO_FILE = {"demo", "paper", "mock", "console", "doctor", "cameras", "benchmark make"}
"""They would do their work, or serve until they are ended."""

DATA, USAGE = 1, 2


def valued_options(command: Any) -> Iterator[str]:
    """The options of a command that take a value."""
    for one in command.params:
        if one.opts[0].startswith("-") and not getattr(one, "is_flag", False):
            yield one.opts[0]


def words_with(line: list[str], option: str, value: str) -> list[str]:
    """A command line with another value of an option, one that begins with a dash as well."""
    words = list(line)
    if option in words:
        at = words.index(option)
        del words[at : at + 2]
    return [*words, f"{option}={value}"]


@pytest.fixture(autouse=True)
def made_once() -> Iterator[None]:
    """Make each command from its function once."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(typer.main, "get_command", cache(typer.main.get_command))
        yield


@pytest.mark.parametrize("name", [name for name, _ in each_command() if name not in NEED_NO_FILE])
def test_a_wrong_value_of_any_option_is_refused_in_one_line(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    command = dict(each_command())[name]
    line = ["gone" if word[:1] == "@" else word for word in line_of(name)]
    wrong = {}
    for option in valued_options(command):
        for value in WRONG:
            words = words_with(line, option, value)
            status = status_of(words)
            said = capsys.readouterr()
            last = said.err.splitlines()[-1:]
            if faults := faults_of((status, said.out, "\n".join(last)), (DATA, USAGE)):
                wrong[option, value] = faults
    assert not wrong


@pytest.mark.parametrize(
    ("words", "option"),
    [
        (["limits", "--curves", "gone", "--min-dprime", "-1"], "--min-dprime"),
        (["simulate", "a.png", "--zoom", "2", "--psf", "gone", "--out", "b.tif", "--seed", "-1"]
         , "--seed"),
        (["calibrate", "a.png", "--out", "p.json", "--pixel-pitch-um", "-1"], "--pixel-pitch-um"),
    ],
)  # fmt: skip
def test_an_option_is_named_as_the_command_line_spells_it(
    words: list[str], option: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert status_of(words) in (DATA, USAGE)
    said = capsys.readouterr().err
    assert option in said
    assert "_" not in said.partition("gone")[0].replace("standoff: ", "").split(":")[0]
