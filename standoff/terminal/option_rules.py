"""Which options of a command go together: rules as data, and the one function that checks them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import typer


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


@dataclass(frozen=True, slots=True, kw_only=True)
class OptionRule:
    """What a command line has to keep; ``because`` is added where it is broken."""

    kind: Literal["needs", "excludes", "exactly one"]
    options: tuple[Option, ...]
    because: str = ""

    def fault(self, context: typer.Context) -> str | None:
        """Say in a sentence how a command line breaks the rule; None where it keeps it."""
        first, *others = self.options
        given = [option for option in self.options if option.is_given(context)]
        if self.kind == "exactly one":
            if len(given) == 1:
                return None
            said = f"give one of {_listed(self.options, context, 'and')}, and only one"
        elif self.kind == "needs":
            if first not in given or len(given) > 1:
                return None
            said = f"{first.text(context)} needs {_listed(others, context, 'or')}"
        else:
            if first not in given or len(given) == 1:
                return None
            said = f"{first.text(context)} does not go with {_listed(given[1:], context, 'or')}"
        return f"{said}: {self.because}" if self.because else said


def needs(option: str | Option, *others: str | Option, because: str = "") -> OptionRule:
    """Refuse an option unless at least one of ``others`` is given."""
    return OptionRule(kind="needs", options=_options(option, *others), because=because)


def excludes(option: str | Option, *others: str | Option, because: str = "") -> OptionRule:
    """Refuse an option beside any of ``others``."""
    return OptionRule(kind="excludes", options=_options(option, *others), because=because)


def exactly_one(*options: str | Option) -> OptionRule:
    """Refuse none of ``options``, and more than one."""
    return OptionRule(kind="exactly one", options=_options(*options))


def check_options(context: typer.Context, rules: Sequence[OptionRule]) -> None:
    """Refuse a command line that breaks a rule, the first one first."""
    for rule in rules:
        fault = rule.fault(context)
        if fault is not None:
            raise typer.BadParameter(fault)


def _options(*options: str | Option) -> tuple[Option, ...]:
    return tuple(Option(one) if isinstance(one, str) else one for one in options)


def _listed(options: Sequence[Option], context: typer.Context, word: str) -> str:
    *first, last = [option.text(context) for option in options]
    return f"{', '.join(first)} {word} {last}" if first else last
