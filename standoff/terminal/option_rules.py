"""What a command line is refused for: options that do not go together, results that overwrite."""

from collections.abc import Collection, Sequence
from dataclasses import dataclass
from os.path import lexists, realpath
from pathlib import Path
from typing import Literal

from typer import BadParameter, Context

from acquisition.files import PAGES, require_place, require_reachable
from acquisition.remote_files import is_url, url_of
from standoff.errors import ApplicationError


@dataclass(frozen=True, slots=True)
class Given:
    """An option or argument of a command, named by its parameter.

    It is given if its value is one of ``values``; without any, if it is not the default.
    """

    name: str
    values: tuple[object, ...] = ()

    def is_given(self, context: Context) -> bool:
        """Whether the command line gives it."""
        value = context.params[self.name]
        if self.values:
            return value in self.values
        defaults = {one.name: one.default for one in context.command.params}
        return value not in (None, False, (), defaults[self.name])

    def text(self, context: Context) -> str:
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
    options: tuple[Given, ...]
    because: str = ""

    def fault(self, context: Context) -> str | None:
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


def needs(option: str | Given, *others: str | Given, because: str = "") -> OptionRule:
    """Refuse an option unless at least one of ``others`` is given."""
    return OptionRule(kind="needs", options=_options(option, *others), because=because)


def excludes(option: str | Given, *others: str | Given, because: str = "") -> OptionRule:
    """Refuse an option together with any of ``others``."""
    return OptionRule(kind="excludes", options=_options(option, *others), because=because)


def exactly_one(*options: str | Given) -> OptionRule:
    """Refuse a command line that does not give exactly one of ``options``."""
    return OptionRule(kind="exactly one", options=_options(*options))


def check_options(context: Context, rules: Sequence[OptionRule]) -> None:
    """Refuse a command line that breaks a rule; report the first that it breaks."""
    for rule in rules:
        fault = rule.fault(context)
        if fault is not None:
            raise BadParameter(fault)


def _options(*options: str | Given) -> tuple[Given, ...]:
    return tuple(Given(one) if isinstance(one, str) else one for one in options)


def _listed(options: Sequence[Given], context: Context, word: str) -> str:
    *first, last = [option.text(context) for option in options]
    return f"{', '.join(first)} {word} {last}" if first else last


def refuse_overwriting(
    outputs: Sequence[Path | None], inputs: Sequence[Path | None] = (), *, force: bool
) -> None:
    """Refuse, before any work, a result that would overwrite something.

    Parameters
    ----------
    outputs
        Every file that the command will write; None for what is not asked for.
    inputs
        The files that it reads.
    force
        Whether results that are already there may be replaced. Inputs never may.

    Raises
    ------
    BadParameter
        If a result is an input or another result.
    ApplicationError
        If there is a file at its place already, or none can be put there; the message names it.
    """
    # Path.resolve raises where symbolic links form a loop; the reader names that better.
    taken = {realpath(path) for path in inputs if path is not None}
    results = [path for path in outputs if path is not None]
    for path in results:
        if realpath(path) in taken:
            raise BadParameter(f"{path} is already an input or output; name another file")
        taken.add(realpath(path))
    for path in results:
        require_reachable(path)
        if is_url(path):
            from acquisition.files import is_there

            if not force and is_there(path):
                raise ApplicationError(
                    f"{url_of(path)} exists already; --force replaces it, or name another"
                )
            continue
        from acquisition.session import refuse_capture  # with what reads sessions

        try:
            refuse_capture(path)
        except OSError as error:
            raise ApplicationError(f"cannot write {path}: {error.strerror}") from error
        if path.is_dir():
            raise ApplicationError(f"cannot write {path}: it is a folder")
        if path.exists() and not path.is_file():
            raise ApplicationError(f"cannot write {path}: it is not a regular file")
        if lexists(path) and not force:
            raise ApplicationError(
                f"{path} exists already; --force replaces it, or name another file"
            )
        require_place(path)


REPORTS = PAGES
"""What the name of a report ends in."""


def refuse_suffix(path: Path | None, option: str, suffixes: Collection[str]) -> None:
    """Refuse a file name whose suffix does not match the format that is written."""
    if path is not None and path.suffix.lower() not in suffixes:
        names = " or ".join(sorted(suffixes))
        raise BadParameter(f"{path} must end in {names}", param_hint=option)
