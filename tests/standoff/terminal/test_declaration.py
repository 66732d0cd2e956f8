"""Rules on options, on a small command; and whether every option of every command has an effect."""

import ast
import inspect
import textwrap
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Any

import pytest
import typer

from standoff import library, terminal
from standoff.terminal import Given, exactly_one, excludes, needs
from standoff.terminal._app import COMMANDS, _imported
from standoff.terminal._declaration import OptionRule


def said(rule: OptionRule, *arguments: str) -> str | None:
    """What a command with a few options says about these arguments; None where it takes them."""
    app = typer.Typer()

    @app.command()
    @terminal.command(rule)
    def command(
        images: list[Path] | None = None,
        *,
        session: Path | None = None,
        mode: str = "plain",
        count: int = 1,
        is_quick: Annotated[bool, typer.Option("--quick")] = False,
        keys: Annotated[list[str] | None, typer.Option("--set")] = None,
    ) -> None:
        """Do nothing."""

    try:
        app(list(arguments), standalone_mode=False)
    except typer.BadParameter as refused:
        return refused.message
    return None


def test_one_of_the_options_that_are_needed_is_enough() -> None:
    rule = needs("is_quick", "session", Given("mode", ("fast", "rough")))
    assert said(rule) is None
    assert said(rule, "--session", "s") is None
    assert said(rule, "--quick", "--session", "s") is None
    assert said(rule, "--quick", "--mode", "rough") is None
    asked = "--quick needs --session or --mode fast or rough"
    assert said(rule, "--quick") == said(rule, "--quick", "--mode", "other") == asked


def test_options_that_exclude_each_other_are_named_with_the_reason() -> None:
    rule = excludes("images", "keys", "is_quick", because="they are slow")
    assert said(rule, "a.tif") is None
    assert said(rule, "--set", "a=1", "--quick") is None
    assert said(rule, "a.tif", "--quick") == "IMAGES cannot be used with --quick: they are slow"
    assert (
        said(rule, "a.tif", "--set", "a=1", "--quick")
        == "IMAGES cannot be used with --set or --quick: they are slow"
    )


def test_neither_none_nor_two_of_the_options_will_do() -> None:
    rule = exactly_one("images", "session")
    assert said(rule, "a.tif") is None
    assert said(rule, "--session", "s") is None
    assert said(rule) == said(rule, "a.tif", "--session", "s")
    assert said(rule) == "give exactly one of IMAGES and --session"


@pytest.mark.parametrize("arguments", [("--count", "1"), ("--mode", "plain"), ()])
def test_an_option_with_its_default_is_not_given(arguments: tuple[str, ...]) -> None:
    for name in ("count", "mode", "keys", "images"):
        assert said(needs(name, "session"), *arguments) is None


def test_a_rule_names_parameters_that_there_are() -> None:
    with pytest.raises(AssertionError, match="speed"):
        said(needs("count", "speed"))


def declared() -> Iterator[Any]:
    """The function of each command, as it is written."""
    for path in COMMANDS.values():
        found = _imported(path)
        functions = [one.callback for one in getattr(found, "registered_commands", ())] or [found]
        yield from (inspect.unwrap(function) for function in functions)


@pytest.mark.parametrize("function", list(declared()), ids=lambda function: function.__name__)
def test_every_option_is_used_or_is_a_keyword_of_the_library(function: Any) -> None:
    body = ast.parse(textwrap.dedent(inspect.getsource(function))).body[0]
    assert isinstance(body, ast.FunctionDef)
    nodes = [node for statement in body.body for node in ast.walk(statement)]
    used = {node.id for node in nodes if isinstance(node, ast.Name)}
    for node in nodes:
        if isinstance(node, ast.Call) and ast.unparse(node.func) == "terminal.keywords_of":
            name = ast.unparse(node.args[0]).removeprefix("library.")
            used |= inspect.signature(getattr(library, name)).parameters.keys()
    assert inspect.signature(function).parameters.keys() - used <= BY_THE_FRAME


BY_THE_FRAME = {"force"}
"""What every command does by itself with an option that it declares."""
