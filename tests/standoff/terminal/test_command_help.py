"""The help of every command: what it takes, and examples that its options accept."""

import shlex
from collections.abc import Iterator
from typing import Any

import pytest
import typer

from standoff.terminal._app import COMMANDS, application
from standoff.terminal._words import EXAMPLES

ROOT: Any = typer.main.get_command(application([]))


def each_command(command: Any, name: str) -> Iterator[tuple[str, Any]]:
    yield name, command
    for inner, other in getattr(command, "commands", {}).items():
        yield from each_command(other, f"{name} {inner}")


@pytest.mark.parametrize(("name", "command"), [*each_command(ROOT, "standoff")])
def test_no_help_shows_a_type_of_the_language(
    name: str,
    command: Any,
    capsys: pytest.CaptureFixture[str],
) -> None:
    # The help is printed as it is made.
    shown = command.get_help(typer.Context(command, info_name=name)) + capsys.readouterr().out
    assert name.split()[-1] in shown
    assert "list[" not in shown
    assert "PosixPath" not in shown


def test_every_command_has_an_example_and_the_help_shows_it(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert set(EXAMPLES) == set(COMMANDS)
    for name in ("simulate", "stage"):
        command = ROOT.commands[name]
        shown = command.get_help(typer.Context(command, info_name=name)) + capsys.readouterr().out
        words = " ".join(shown.split())
        assert "Examples:" in words
        assert all(line in words for line in EXAMPLES[name])


@pytest.mark.parametrize("line", [line for lines in EXAMPLES.values() for line in lines])
def test_an_example_is_a_command_line_that_is_accepted(line: str) -> None:
    program, *words = shlex.split(line)
    assert program == "standoff"
    command = ROOT
    while hasattr(command, "commands"):
        command = command.commands[words.pop(0)]
    context = command.make_context("standoff", words)  # a wrong option or value is raised here
    assert context.params.keys() >= {one.name for one in command.params if one.required}


def test_the_options_of_simulate_are_in_groups() -> None:
    panels = {
        one.name: getattr(one, "rich_help_panel", None) for one in ROOT.commands["simulate"].params
    }
    assert panels["zoom"] == panels["homography"] != panels["psf"] == panels["model"]
    assert panels["noise"] == panels["exposure"] != panels["steps"] == panels["sampler"]
    assert panels["out"] is None
