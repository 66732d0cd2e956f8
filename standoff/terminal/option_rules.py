"""Which options of a command go together: rules as data, and the function that checks them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import typer


@dataclass(frozen=True, slots=True)
class Option:
    """An option or argument of a command, named by its parameter.

    It is given if its value is one of ``values``; without any, if it is not the default.
    """

    name: str
    values: tuple[object, ...] = ()

    def is_given(self, context: typer.Context) -> bool:
        """Whether the command line gives it."""
        value = context.params[self.name]
        if self.values:
            return value in self.values
        defaults = {one.name: one.default for one in context.command.params}
        return value not in (None, False, (), defaults[self.name])

    def text(self, context: typer.Context) -> str:
        """Its name as in the help, with ``values``."""
        words = {one.name: one.opts[0] for one in context.command.params}
        word = words[self.name]
        if word == self.name:  # an argument, which the help writes in capitals
            return word.upper()
        values = " or ".join(str(value) for value in self.values)
        return f"{word} {values}".rstrip()


@dataclass(frozen=True, slots=True, kw_only=True)
class OptionRule:
    """A rule for a command line; ``because`` is added to the message about a fault."""

    kind: Literal["needs", "excludes", "exactly one"]
    options: tuple[Option, ...]
    because: str = ""

    def fault(self, context: typer.Context) -> str | None:
        """Say in a sentence how a command line breaks the rule; None if it does not."""
        first, *others = self.options
        given = [option for option in self.options if option.is_given(context)]
        if self.kind == "exactly one":
            if len(given) == 1:
                return None
            said = f"give exactly one of {_listed(self.options, context, 'and')}"
        elif self.kind == "needs":
            if first not in given or len(given) > 1:
                return None
            said = f"{first.text(context)} needs {_listed(others, context, 'or')}"
        else:
            if first not in given or len(given) == 1:
                return None
            said = f"{first.text(context)} cannot be used with {_listed(given[1:], context, 'or')}"
        return f"{said}: {self.because}" if self.because else said


def needs(option: str | Option, *others: str | Option, because: str = "") -> OptionRule:
    """Refuse an option unless at least one of ``others`` is given."""
    return OptionRule(kind="needs", options=_options(option, *others), because=because)


def excludes(option: str | Option, *others: str | Option, because: str = "") -> OptionRule:
    """Refuse an option together with any of ``others``."""
    return OptionRule(kind="excludes", options=_options(option, *others), because=because)


def exactly_one(*options: str | Option) -> OptionRule:
    """Refuse a command line that does not give exactly one of ``options``."""
    return OptionRule(kind="exactly one", options=_options(*options))


def check_options(context: typer.Context, rules: Sequence[OptionRule]) -> None:
    """Refuse a command line that breaks a rule; report the first that it breaks."""
    for rule in rules:
        fault = rule.fault(context)
        if fault is not None:
            raise typer.BadParameter(fault)


def _options(*options: str | Option) -> tuple[Option, ...]:
    return tuple(Option(one) if isinstance(one, str) else one for one in options)


def _listed(options: Sequence[Option], context: typer.Context, word: str) -> str:
    *first, last = [option.text(context) for option in options]
    return f"{', '.join(first)} {word} {last}" if first else last
