"""Which options of a command go together: rules as data, and the one function that checks them."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import typer

__all__ = ["Option", "OptionRule", "check_options", "exactly_one", "excludes", "needs"]


@dataclass(frozen=True, slots=True)
class Option:
    """An option or argument of a command, named by its parameter, as given on the command line.

    It is given where its value is one of ``values``; without any, where it is not the default.
    """

    name: str
    values: tuple[object, ...] = ()

    def is_given(self, context: typer.Context) -> bool:
        """Whether this command line gives it."""
        value = context.params[self.name]
        if self.values:
            return value in self.values
        defaults = {one.name: one.default for one in context.command.params}
        return value not in (None, False, (), defaults[self.name])

    def text(self, context: typer.Context) -> str:
        """Name it as the help does, with the values that are meant."""
        words = {one.name: one.opts[0] for one in context.command.params}
        word = words[self.name]
        if word == self.name:  # an argument, which the help writes in capitals
            return word.upper()
        values = " or ".join(str(value) for value in self.values)
        return f"{word} {values}".rstrip()


OptionRule = Callable[[typer.Context], str | None]
"""Says in a sentence how a command line breaks the rule; None where it keeps it."""


def needs(option: str | Option, *others: str | Option, because: str = "") -> OptionRule:
    """Refuse an option unless at least one of ``others`` is given."""

    def fault(context: typer.Context) -> str | None:
        if not _option(option).is_given(context):
            return None
        if any(_option(other).is_given(context) for other in others):
            return None
        asked = f"{_option(option).text(context)} needs {_listed(others, context, 'or')}"
        return _explained(asked, because)

    return fault


def excludes(option: str | Option, *others: str | Option, because: str = "") -> OptionRule:
    """Refuse an option beside any of ``others``."""

    def fault(context: typer.Context) -> str | None:
        if not _option(option).is_given(context):
            return None
        beside = [other for other in others if _option(other).is_given(context)]
        if not beside:
            return None
        asked = f"{_option(option).text(context)} does not go with {_listed(beside, context, 'or')}"
        return _explained(asked, because)

    return fault


def exactly_one(*options: str | Option) -> OptionRule:
    """Refuse none of ``options``, and more than one."""

    def fault(context: typer.Context) -> str | None:
        if sum(_option(option).is_given(context) for option in options) == 1:
            return None
        return f"give one of {_listed(options, context, 'and')}, and only one"

    return fault


def check_options(context: typer.Context, rules: Sequence[OptionRule]) -> None:
    """Refuse a command line that breaks a rule, the first one first."""
    for rule in rules:
        fault = rule(context)
        if fault is not None:
            raise typer.BadParameter(fault)


def _explained(fault: str, because: str) -> str:
    return f"{fault}: {because}" if because else fault


def _option(option: str | Option) -> Option:
    return Option(option) if isinstance(option, str) else option


def _listed(options: Sequence[str | Option], context: typer.Context, word: str) -> str:
    *first, last = [_option(option).text(context) for option in options]
    return f"{', '.join(first)} {word} {last}" if first else last
